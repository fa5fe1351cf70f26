"""The n-th vehicle at an entry has the same traits, whatever dispatchers and drivers do."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.policies.rules import BASELINES
from medjax.traffic.arrivals import draw_round, draw_traits, new_seed, redraw
from medjax.traffic.demand import entries
from medjax.world.kinds import MED

pytestmark = pytest.mark.usefixtures("quick_compiles")


# MEDs differ, too.
UNLIKE = {"desired_speed_std": [2.0, 2.0, 1.0, 2.0, 0.7]}


def _played(scenario, rules, decisions):
    """By rule: traits of the vehicles at each entry in turn, and desired speeds of MEDs that were sent."""
    env, params = medjax.make(scenario, **UNLIKE)
    config, where = env.config, entries(params.road, env.config.num_lanes)
    policies = [BASELINES[rule](env) for rule in rules]

    def seen(state):
        energy = config.by_slot(jnp.zeros(config.num_meds), state.evs.energy_j, 0.0)
        complies = config.by_slot(False, state.evs.complies, False)
        vehicles = state.vehicles
        here = (vehicles.x == where.x[:, None]) & (vehicles.lane == where.lane[:, None])
        here &= vehicles.active & (vehicles.kind != MED)
        traits = vehicles.kind, vehicles.desired_speed, vehicles.destination, energy, complies
        return jnp.stack(traits)[:, jnp.argmax(here, axis=1)].T, state.entered_here

    probed = env.with_probe(seen)

    @jax.jit
    def play(rule, key):
        _, state = env.reset(jax.random.key(4), params)

        def decide(state, key):
            actions = [policy(key, None, state, params).action for policy in policies]
            _, state, *_, info = probed.step_env(key, state, jnp.stack(actions)[rule], params)
            return state, info["begun"]

        state, begun = jax.lax.scan(decide, state, jax.random.split(key, decisions))
        sent = state.vehicles.desired_speed[config.med_slots]
        return begun, jnp.where(state.vehicles.active[config.med_slots], sent, 0.0)

    for rule in range(len(rules)):
        (rows, count), sent = jax.tree.map(np.asarray, play(rule, jax.random.key(rule)))
        rows, count = rows.reshape(-1, *rows.shape[2:]), count.reshape(-1, count.shape[2])
        new = np.diff(count, axis=0, prepend=0) == 1
        yield [rows[new[:, entry], entry] for entry in range(config.num_entries)], sent


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("scenario", "rules", "decisions"),
    [("paper", ("none", "greedy", "paced", "random"), 200), ("corridor", ("none", "greedy"), 30)],
)
def test_all_dispatchers_meet_the_same_traffic(scenario, rules, decisions):
    """Kind, desired speed, destination, charge and compliance, by entry and number; and each MED has one driver."""
    (calm, _), *others = _played(scenario, rules, decisions)
    assert sum(map(len, calm)) > 100
    for busy, sent in others:
        assert sent.any()
        for first, second in zip(calm, busy, strict=True):
            both = min(len(first), len(second))
            np.testing.assert_array_equal(first[:both], second[:both])
    for (_, sent), (_, again) in itertools.pairwise(others):
        both = (sent > 0.0) & (again > 0.0)
        assert len(np.unique(sent[both])) > 1
        np.testing.assert_array_equal(sent[both], again[both])


def test_streams_are_independent():
    """Vehicles of an entry, of another, MEDs and rounds draw from streams of their own."""
    seed = new_seed(jax.random.key(0))
    numbers = jnp.arange(500)
    charges = [draw_traits(seed, jnp.full((500,), entry), numbers).charge for entry in range(4)]
    rounds = jax.vmap(lambda number: draw_round(seed, 3, number))(numbers).ravel()
    drawn = np.concatenate([*charges, rounds])
    assert len(np.unique(drawn)) > 0.999 * drawn.size
    assert drawn.mean() == pytest.approx(0.5, abs=4 * (drawn.size * 12) ** -0.5)


def test_redraw_leaves_the_road_as_it_is():
    """Also under a wrapper."""
    env, params = medjax.make("paper")
    state = jax.jit(env.reset)(jax.random.key(0), params)[1]
    wrapped = {"inner": state, "of a wrapper": jnp.ones(3)}
    other = redraw(jax.random.key(1), wrapped, env.config, params)
    assert (other["inner"].arrivals != state.arrivals).any()
    back = other["inner"].replace(arrivals=state.arrivals)
    jax.tree.map(np.testing.assert_array_equal, back, state)

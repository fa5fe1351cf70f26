"""Entries: queues take what arrives, and a class short of slots keeps its share."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.traffic.arrivals import draw_traits, redraw
from medjax.traffic.demand import entries
from medjax.traffic.entry import admit
from medjax.world.kinds import by_class
from medjax.world.state import MERGING, QUEUED
from tests.traffic.roads import put

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.mark.thorough
def test_queues_take_what_arrives(asked, blank):
    """Entered plus waiting grows by Poisson arrivals, of the right mean at each entry; two are blocked."""
    env, params = asked
    rounds = 6000
    waiting = put(blank, [80, 81], [3.0, 110.0], [1, 4], [10.0, 10.0], [30.0, 30.0])
    waiting = waiting.replace(queue=jnp.array([0, 3, 0, 0, 1, 0, 0, 0], jnp.int32))

    @jax.jit
    @jax.vmap
    def one(key):
        anew = redraw(key, waiting, env.config, params)
        after, _, stats = admit(anew, jnp.int32(0), env.config, params)
        new = after.vehicles.active & ~waiting.vehicles.active
        where = entries(params.road, env.config.num_lanes)
        here = (after.vehicles.x == where.x[:, None]) & (after.vehicles.lane == where.lane[:, None])
        came = jnp.sum(new & here, axis=1)
        return after.queue, came, stats.entered, new.sum(), after.entered_here

    queue, came, stats, new, counted = jax.tree.map(
        np.asarray, one(jax.random.split(jax.random.key(2), rounds))
    )
    arrived = queue + came - np.asarray(waiting.queue)
    assert (arrived >= 0).all()
    assert came.max() == 1
    assert not came[:, [1, 4]].any()  # a rear bumper over the entry, and one 5 m ahead of it
    np.testing.assert_array_equal(came.sum(axis=1), new)
    np.testing.assert_array_equal(stats.sum(axis=1), new)
    rate = np.array([700.0] * 4 + [300.0] * 4) / 3600
    assert (np.abs(arrived.mean(axis=0) - rate) < 4 * np.sqrt(rate / rounds)).all()
    np.testing.assert_array_equal(counted, came)
    evs = by_class(stats)[:, 1].sum() / came.sum()
    assert evs == pytest.approx(0.3, abs=4 * np.sqrt(0.21 / came.sum()))


def test_a_med_enters_before_who_waits(quiet, blank):
    """On an empty road: a MED and a car wait at the second ramp. The MED enters, and the car still waits."""
    env, params = quiet
    slot, ramp = 3, 1
    entry = env.config.num_lanes + ramp
    empty = put(blank, jnp.zeros(0, jnp.int32), [], [], [], [])
    queue = jnp.zeros_like(empty.queue).at[entry].set(1)
    meds = empty.meds.replace(
        status=empty.meds.status.at[slot].set(QUEUED), ramp=empty.meds.ramp.at[slot].set(ramp)
    )
    enter = jax.jit(lambda state: admit(state, jnp.int32(0), env.config, params)[0])
    after = enter(empty.replace(queue=queue, meds=meds))
    np.testing.assert_array_equal(np.flatnonzero(after.vehicles.active), [slot])
    assert after.vehicles.x[slot] == params.road.ramp_x_m[ramp]
    assert after.meds.status[slot] == MERGING
    np.testing.assert_array_equal(after.queue, queue)
    # Without the MED the car would have entered.
    alone = enter(empty.replace(queue=queue))
    assert alone.vehicles.active.sum() == 1
    assert not alone.vehicles.active[env.config.med_slots].any()
    assert alone.queue.sum() == 0


@pytest.mark.thorough
@pytest.mark.parametrize("scarce", [{"num_evs": 6}, {"num_gas": 20}])
def test_a_class_short_of_slots_keeps_its_share(scarce):
    """Of all vehicles that come to an entry's front, those still waiting there included."""
    env, params = medjax.make("paper", ev_share=0.3, **scarce)

    @jax.jit
    @jax.vmap
    def play(key):
        _, state = env.reset(key, params)
        begun = state.stats.entered

        def decide(state, step_key):
            return env.step_env(step_key, state, 0, params)[1], None

        state, _ = jax.lax.scan(decide, state, jax.random.split(key, 600))
        entry = jnp.arange(env.config.num_entries)
        is_ev = draw_traits(state.arrivals, entry, state.entered_here).is_ev < 0.3
        at_front = jnp.stack([is_ev, ~is_ev]) & (state.queue > 0)
        came = by_class(state.stats.entered - begun)[1:] + at_front.sum(axis=1)
        return came, state.queue.sum()

    came, waiting = jax.tree.map(np.asarray, play(jax.random.split(jax.random.key(5), 24)))
    assert (waiting > 20).all()  # slots are short indeed
    evs, everyone = float(came[:, 0].sum()), float(came.sum())
    assert evs / everyone == pytest.approx(0.3, abs=4 * (0.21 / everyone) ** 0.5)

"""Agents on the highway: effects of their decisions, rewards and metrics."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.env.agents.environment import AgentsEnv
from medjax.traffic.exits import next_exit
from medjax.world.state import AT_DEPOT, IN_SERVICE, RETIRED, EpisodeStats
from tests.env.agents.conftest import World

pytestmark = pytest.mark.usefixtures("quick_compiles")


def in_service(trips, state, **parts):
    """Folded actions: these choices of all agents in service, the rule's of the others."""
    rule = trips.by_rule(state, trips.params)
    chosen = rule._replace(**{name: jnp.full(4, value) for name, value in parts.items()})
    serves = state.meds.status == IN_SERVICE
    return jnp.where(serves, trips.actions.fold(chosen, serves), 0)


def play(trips, state, decisions, **parts):
    """The state after some decisions of the same parts."""
    for number in range(decisions):
        actions = in_service(trips, state, **parts)
        _, state, *_ = trips.step(jax.random.key(number), state, actions, trips.params)
    return state


@pytest.mark.thorough
def test_a_slower_med_is_slower(trips, busy):
    """After half a minute, no MED in service drives faster than its order."""
    slow = trips.actions.speeds.index(14.0)
    state = play(trips, busy, 8, speed=slow)
    serves = np.asarray((busy.meds.status == IN_SERVICE) & (state.meds.status == IN_SERVICE))
    assert serves.any()
    np.testing.assert_array_equal(state.meds.service_speed[serves], 14.0)
    assert np.asarray(state.vehicles.speed[:4])[serves].max() < 14.5
    usual = play(trips, busy, 8)
    assert np.asarray(usual.vehicles.speed[:4])[serves].max() > 20.0


def test_a_med_changes_its_lane(trips):
    """On a road without EVs, it comes to the lane that it is told, stays in service, and goes back."""
    params = trips.params.replace(demand=trips.params.demand.replace(ev_share=jnp.float32(0.0)))
    _, state = trips.reset(0, params)

    def go_on(state, decisions, **parts):
        for number in range(decisions):
            actions = in_service(trips, state, **parts)
            head = trips.mask(state, params)[:, 1]
            actions = jnp.where(head, 1, actions)
            _, state, *_ = trips.step(jax.random.key(number), state, actions, params)
        return state

    state = go_on(state, 7)
    serves = np.asarray(state.meds.status == IN_SERVICE)
    assert serves.any()
    np.testing.assert_array_equal(state.vehicles.lane[:4][serves], 2)
    state = go_on(state, 3, lane=trips.actions.lanes.index(1))
    still = serves & np.asarray(state.meds.status == IN_SERVICE)
    assert (np.asarray(state.vehicles.lane[:4])[still] == 1).any()
    state = go_on(state, 3)
    still &= np.asarray(state.meds.status == IN_SERVICE)
    assert (np.asarray(state.vehicles.lane[:4])[still] == 2).all()
    assert float(state.stats.collisions) == 0.0


def test_a_med_that_refuses_gets_no_booking(trips, busy):
    """The rule books some EVs in the same time."""

    def booked_anew(**parts):
        state, found = busy, 0
        for number in range(20):
            before = np.asarray(state.evs.med)
            actions = in_service(trips, state, **parts)
            _, state, *_ = trips.step(jax.random.key(number), state, actions, trips.params)
            after = np.asarray(state.evs.med)
            serves = np.asarray(state.meds.status == IN_SERVICE)
            found += int(((after != before) & (after >= 0) & serves[after]).sum())
        return found

    assert booked_anew(accept=0) == 0
    assert booked_anew() > 0


def test_who_leaves_takes_the_next_exit(trips, busy):
    """Each makes for the first exit that it is told of in time, and is gone there."""
    serves = np.asarray(busy.meds.status == IN_SERVICE)
    x = busy.vehicles.x[:4]
    notice = trips.params.road.exit_notice_m
    exits = np.asarray(next_exit(x + notice, trips.params.road))
    soon = serves & (exits < float(trips.params.road.length_m))
    assert soon.any()
    state = play(trips, busy, 1, leave=1)
    np.testing.assert_array_equal(np.asarray(state.vehicles.destination[:4])[soon], exits[soon])
    long = int(np.ceil(1500.0 / 20.0 / 4.0))
    state = play(trips, state, long, leave=1)
    gone = np.isin(np.asarray(state.meds.status), (RETIRED, AT_DEPOT))
    assert gone[soon].any()


@pytest.mark.thorough
def test_what_is_not_allowed_counts_as_the_rule(trips, busy):
    """And is counted, by agent, folded or part by part."""
    mask = np.asarray(trips.mask(busy, trips.params))
    wrong = np.where(mask.all(axis=1), 0, np.argmin(mask, axis=1))
    wrong[0] = trips.env.num_actions + 7
    key, params = jax.random.key(5), trips.params
    _, state, *_, info = trips.step(key, busy, jnp.asarray(wrong), params)
    _, usual, *_ = trips.step(key, busy, jnp.zeros(4, jnp.int32), params)
    # What a step counts, agents' own numbers included, adds up to the episode's.
    jax.tree.map(
        lambda part, before, after: np.testing.assert_allclose(before + part, after, rtol=1e-6),
        *(info["step_stats"], busy.stats, state.stats),
    )
    count = float(state.stats.invalid_actions - usual.stats.invalid_actions)
    assert count == (wrong != 0).sum() > 1
    np.testing.assert_array_equal(state.vehicles.x, usual.vehicles.x)

    rule = trips.by_rule(busy, params)
    absurd = rule._replace(speed=rule.speed.at[0].set(99), accept=rule.accept.at[1].set(-1))
    parts = jax.jit(trips.env.step_parts)
    _, state, *_ = parts(key, busy, absurd, params)
    assert float(state.stats.invalid_actions - usual.stats.invalid_actions) == 2.0
    np.testing.assert_array_equal(state.vehicles.x, usual.vehicles.x)


@pytest.mark.thorough
def test_own_reward_by_hand(trips, busy):
    """Packs that a MED's EVs gained in the decision, by a loop over EVs."""
    env = AgentsEnv(trips.env.env, trips.actions, credit="own")
    key, params = jax.random.key(2), trips.params
    _, after, *_, info = jax.jit(env.step_env)(key, busy, jnp.zeros(4, jnp.int32), params)
    expected = np.zeros(4)
    for ev in range(trips.config.num_evs):
        slot = trips.config.num_meds + ev
        if not (busy.vehicles.active[slot] and after.vehicles.active[slot]):
            continue
        change = float(after.evs.energy_j[ev]) - float(busy.evs.energy_j[ev])
        for med in {int(busy.evs.med[ev]), int(after.evs.med[ev])} - {-1}:
            expected[med] += change / float(params.ev_capacity_j)
    np.testing.assert_allclose(info["rewards"], expected, atol=1e-6)
    assert np.abs(expected).max() > 1e-5


def test_own_reward_leaves_out_who_took_the_slot_of_another(trips, busy):
    """A newcomer is behind, or has another desired speed."""
    env = AgentsEnv(trips.env.env, trips.actions, credit="own")
    ev = int(np.flatnonzero(np.asarray(busy.evs.med >= 0))[0])
    slot, pack = trips.config.num_meds + ev, float(trips.params.ev_capacity_j)
    fuller = busy.replace(evs=busy.evs.replace(energy_j=busy.evs.energy_j.at[ev].add(0.5 * pack)))
    gained = np.zeros(4)
    gained[int(busy.evs.med[ev])] = 0.5
    np.testing.assert_allclose(env._own_rewards(busy, fuller, trips.params), gained, atol=1e-6)
    for name, change in (("x", -1.0), ("desired_speed", 1.0)):
        moved = getattr(busy.vehicles, name).at[slot].add(change)
        other = fuller.replace(vehicles=busy.vehicles.replace(**{name: moved}))
        assert not np.any(env._own_rewards(busy, other, trips.params))


def test_metrics_of_what_agents_were_told_by_hand(trips, busy):
    """Two decisions at other speeds, refusing in the second: means over MEDs in service, as a loop counts them."""
    seconds = metres = refusing = 0.0
    state = busy.replace(stats=EpisodeStats.zeros())
    speeds = np.asarray(trips.actions.speeds)
    for number, (speed, accept) in enumerate([(0, 1), (2, 0)]):
        serves = int((state.meds.status == IN_SERVICE).sum())
        seconds += 4.0 * serves
        metres += 4.0 * serves * speeds[speed]
        refusing += 4.0 * serves * (1 - accept)
        actions = in_service(trips, state, speed=speed, accept=accept)
        _, state, *_, info = trips.step(jax.random.key(number), state, actions, trips.params)
    metrics = {name: float(value) for name, value in info["metrics"].items()}
    assert metrics["told_speed"] == pytest.approx(metres / seconds, rel=1e-6)
    assert metrics["refusing_share"] == pytest.approx(refusing / seconds, rel=1e-6)
    assert metrics["left_early"] == 0.0
    # Who is bound for the end makes for an exit before it, once.
    bound = busy.vehicles.destination.at[:4].set(trips.params.road.length_m)
    bound = busy.replace(
        stats=EpisodeStats.zeros(), vehicles=busy.vehicles.replace(destination=bound)
    )
    leaving = play(trips, bound, 2, leave=1)
    changed = np.asarray(leaving.vehicles.destination != bound.vehicles.destination)[:4]
    stays = np.asarray(leaving.meds.status == IN_SERVICE)
    assert float(leaving.stats.left_early) == (changed & stays).sum() > 0


@pytest.mark.parametrize("seed", [0, 1])
def test_random_agents_leave_the_world_sound(trips, seed):
    """An episode of random allowed actions: nobody collides, nothing is lost, all is finite, and they act."""
    _, state = trips.reset(seed)
    rng = np.random.default_rng(seed)
    for number in range(60):
        mask = np.asarray(trips.mask(state, trips.params))
        actions = [rng.choice(np.flatnonzero(row)) for row in mask]
        key = jax.random.key(1000 * seed + number)
        obs, state, _, terminated, truncated, info = trips.step(
            key, state, jnp.asarray(actions), trips.params
        )
        assert np.isfinite(obs).all()
        assert np.isfinite(info["rewards"]).all()
        assert not terminated
        assert bool(truncated) == (number == 59)
    metrics = {name: float(value) for name, value in info["metrics"].items()}
    assert metrics["collisions"] == 0.0
    assert metrics["invalid_actions"] == 0.0
    assert metrics["meds_dispatched"] > 4.0


@pytest.mark.thorough
def test_one_alone_is_one_of_many(trips, busy):
    """A batch gives what each gives by itself."""
    keys = jax.random.split(jax.random.key(8), 3)
    states = jax.tree.map(lambda leaf: jnp.stack([leaf] * 3), busy)
    actions = jnp.stack([in_service(trips, busy, speed=n) for n in range(3)])
    batch = jax.jit(jax.vmap(trips.env.step_env, (0, 0, 0, None)))
    obs, many, *_, info = batch(keys, states, actions, trips.params)
    for n in range(3):
        own_obs, one, *_, own = trips.step(keys[n], busy, actions[n], trips.params)
        np.testing.assert_array_equal(many.vehicles.x[n], one.vehicles.x)
        np.testing.assert_array_equal(many.meds.service_speed[n], one.meds.service_speed)
        np.testing.assert_allclose(obs[n], own_obs, atol=1e-5)
        np.testing.assert_allclose(info["rewards"][n], own["rewards"], rtol=1e-6)


def test_agents_on_a_road_without_exits():
    """They decide every 4 s."""
    world = World(medjax.make_agents("paper", num_evs=8, num_gas=12, mainline_per_h=600.0))
    assert world.env.num_agents == 15
    assert not world.actions.exits
    assert world.actions.lanes == (1, 2)
    assert world.config.decision_s == 4.0
    assert int(world.params.episode_decisions) == 150

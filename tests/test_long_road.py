"""The preset `long`: 100 km, about two thousand vehicles, true packs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.verification.invariants import (
    INVARIANTS,
    check_instant,
    count,
    not_finite,
)
from medjax.traffic import find_neighbours, sort_by_road
from medjax.traffic.demand import expected_vehicles
from medjax.traffic.road import NO_LANE
from medjax.world.kinds import MED, by_class
from medjax.world.state import IN_SERVICE, count_kinds
from tests.traffic.reference import brute_force

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.fixture(scope="module")
def long():
    return medjax.make("long")


def moved_to_the_end(state, config, params, x):
    """The state with a MED in service at x, EVs low on energy near its slots, and nobody else there."""
    vehicles, first = state.vehicles, config.num_meds
    clear = vehicles.active & (np.abs(vehicles.x - x) > 600.0)
    places = np.array([x, x - 30.0, x - 40.0, x - 60.0, x + 40.0])
    slots = np.array([0, first, first + 1, first + 2, first + 3])

    def put(column, values):
        return jnp.asarray(column).at[slots].set(jnp.asarray(values, column.dtype))

    vehicles = vehicles.replace(
        active=put(clear, True),
        x=put(vehicles.x, places),
        lane=put(vehicles.lane, [2, 1, 3, 2, 2]),
        speed=put(vehicles.speed, 18.0),
        desired_speed=put(vehicles.desired_speed, [18.0, 30.0, 30.0, 30.0, 30.0]),
        destination=put(vehicles.destination, float(params.road.length_m)),
    )
    low = state.evs.energy_j.at[:4].set(0.2 * params.ev_capacity_j)
    status = state.meds.status.at[0].set(IN_SERVICE)
    return state.replace(
        vehicles=vehicles,
        evs=state.evs.replace(energy_j=low),
        meds=state.meds.replace(status=status),
    )


def play(env, params, policy, decisions):
    """(key, state) -> (last state, per decision: counts that must be 0, where EVs charge, vehicles per class)."""
    config = env.config
    slices = (config.med_slots, config.ev_slots, config.gas_slots)

    def step(state, key):
        act_key, step_key = jax.random.split(key)
        action = policy(act_key, None, state, params).action
        obs, state, reward, _, _, info = env.step_env(step_key, state, action, params)
        v, stats = state.vehicles, state.stats
        on_road = jnp.stack([v.active[s].sum() for s in slices])
        # An EV that runs out is counted at once, and stays on the road until it is on the shoulder.
        rolling = jnp.sum(v.active[config.ev_slots] & state.evs.is_depleted)
        lost = by_class(stats.entered - stats.left) - on_road
        lost -= jnp.array([0.0, 1.0, 0.0]) * (stats.depleted - rolling)
        results = {"finite": not_finite((obs, reward))}
        found = count(check_instant(state, config, params), results)
        wrong = dict(zip(INVARIANTS, found, strict=True))
        wrong |= {"collisions": info["step_stats"].collisions, "lost": jnp.abs(lost).sum()}
        charging_x = jnp.where(state.evs.is_charging, v.x[config.ev_slots], -1.0)
        return state, (wrong, charging_x, on_road)

    return jax.jit(lambda key, state: jax.lax.scan(step, state, jax.random.split(key, decisions)))


def test_holds_two_thousand_vehicles_on_100_km(long):
    """As many as the demand brings, with room for more."""
    env, params = long
    config = env.config
    assert float(params.road.length_m) == 100_000.0
    assert float(params.battery_scale) == 1.0
    assert config.num_ramps == len(params.road.ramp_x_m) == 8
    at_cruise = float(expected_vehicles(params.demand, params.road, 30.0))
    slowed = float(expected_vehicles(params.demand, params.road, 26.0))
    assert at_cruise < 2000 < slowed < config.num_vehicles
    # An episode is long enough to cross the road.
    assert float(params.episode_decisions) * config.decision_s > 100_000.0 / 30.0


def test_random_play_from_end_to_end_of_the_road(long):
    """Two minutes without a violation; EVs charge at 95 km, too, and the order of the road is that of float64."""
    env, params = long
    config = env.config
    key = jax.random.key(0)
    obs, state = jax.jit(env.reset)(key, params)
    assert obs.shape == (env.observation.size(config),)
    started = int(state.vehicles.active.sum())
    state = moved_to_the_end(state, config, params, 95_000.0)
    counts = count_kinds(state.vehicles.active, state.vehicles.kind, config)
    state = state.replace(stats=state.stats.replace(entered=counts))  # what was put there, too
    run = play(env, params, medjax.BASELINES["random"](env), 120)
    state, (wrong, charging_x, on_road) = run(key, state)
    assert {name: float(count.sum()) for name, count in wrong.items()} == dict.fromkeys(wrong, 0.0)
    assert started > 1500
    assert np.asarray(on_road).sum(axis=1).min() > 1500
    at_end = np.asarray(charging_x[-1]) > 95_000.0
    assert at_end.sum() >= 2
    assert float(state.stats.energy_received_j) > 0.0

    v = state.vehicles
    active = np.asarray(v.active)
    everyone = np.flatnonzero(active)
    x, lane = np.asarray(v.x, np.float64)[active], np.asarray(v.lane)[active]
    ahead, behind = brute_force(x, lane, lane)
    order = sort_by_road(v.x, v.active, params.road.length_m, v.road_order)
    nowhere = jnp.full_like(v.lane, NO_LANE)
    got = find_neighbours(order, v.lane, nowhere, v.lane + 1, v.active, config.num_lanes + 1)
    for seen, exact in ((got.leader, ahead), (got.follower, behind)):
        expected = np.where(exact >= 0, everyone[exact], -1)
        np.testing.assert_array_equal(np.asarray(seen)[active], expected)


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["random", "forecast"])
def test_a_whole_hour(long, policy):
    """3600 decisions without a violation; EVs charge all along the road, and fewer run out than without MEDs."""
    env, params = long
    key = jax.random.key(1)
    _, state = jax.jit(env.reset)(key, params)
    run = play(env, params, medjax.BASELINES[policy](env), int(params.episode_decisions))
    state, (wrong, charging_x, on_road) = run(key, state)
    assert {name: float(count.sum()) for name, count in wrong.items()} == dict.fromkeys(wrong, 0.0)
    total = np.asarray(on_road).sum(axis=1)
    assert 1500 < total.min() < 2000 < total.max() < env.config.num_vehicles
    places = np.histogram(np.asarray(charging_x), bins=np.linspace(0.0, 1e5, 11))[0]
    assert (places > 0).all()  # somebody charges in every stretch of 10 km
    assert float(state.stats.left[MED]) > 0.0

    idle = play(env, params, medjax.BASELINES["none"](env), int(params.episode_decisions))
    unserved, _ = idle(key, jax.jit(env.reset)(key, params)[1])
    assert float(state.stats.depleted) < 0.8 * float(unserved.stats.depleted)

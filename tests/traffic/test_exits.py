"""Exits: destinations against brute force; no vehicle is lost, and hardly any misses its exit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.traffic.demand import expected_vehicles
from medjax.traffic.exits import (
    draw_destinations,
    draw_destinations_on_road,
    draw_origins,
    exit_desire,
    is_preparing_exit,
    last_exit,
    next_exit,
)

pytestmark = pytest.mark.usefixtures("quick_compiles")

EXITS, SHARES = [1000.0, 2900.0], [0.3, 0.2]


@pytest.fixture(scope="module")
def road():
    """Two exits on the paper's road, lorries, no MED."""
    return medjax.make(
        "paper", exit_x_m=EXITS, exit_share=SHARES, lorry_share=0.15, size=0, num_gas=220
    )


def test_next_and_last_exit(road):
    """The first one beyond, else the end; the last one behind or here, else none."""
    x = jnp.array([0.0, 999.0, 1000.0, 2899.0, 2900.0, 3999.0])
    following = [1000.0, 1000.0, 2900.0, 2900.0, 4000.0, 4000.0]
    np.testing.assert_array_equal(next_exit(x, road[1].road), following)
    before = [-np.inf, -np.inf, 1000.0, 1000.0, 2900.0, 2900.0]
    np.testing.assert_array_equal(last_exit(x, road[1].road), before)


def test_destinations_are_shares_of_passing_vehicles(road):
    """30 % leave at the first exit, 20 % of the rest at the second; none that enters too near."""
    _, params = road
    uniform = (np.arange(100_000) + 0.5) / 100_000
    for x, expected in ((0.0, (0.3, 0.14)), (500.0, (0.0, 0.2)), (2000.0, (0.0, 0.0))):
        places = jnp.full(100_000, x)
        drawn = draw_destinations(jnp.asarray(uniform), places, params.demand, params.road)
        drawn = np.asarray(drawn)
        shares = [(drawn == place).mean() for place in EXITS]
        np.testing.assert_allclose(shares, expected, atol=2e-5)
        assert set(drawn) <= {*EXITS, 4000.0}
        # Those bound for an exit drive to the start of its deceleration lane.
        ways = np.where(drawn < 4000.0, drawn - 250.0, drawn) - x
        none = jnp.zeros_like(params.demand.ramp_per_h)
        only = params.demand.replace(mainline_per_h=none[0], ramp_per_h=none.at[0].set(360.0))
        there = params.road.replace(ramp_x_m=params.road.ramp_x_m.at[0].set(x))
        on_road = float(expected_vehicles(only, there, 20.0))
        assert on_road == pytest.approx(0.1 * ways.mean() / 20.0, rel=1e-4)


def test_entries_are_shares_of_passing_vehicles(road):
    """Of 2600 an hour at the start and 250 at each ramp, those that have not left before 1000 and 2900 m."""
    _, params = road
    uniform = (np.arange(100_000) + 0.5) / 100_000
    ramps = [100.0, 1200.0, 2100.0]
    for x, flows in (
        (50.0, (2600.0, 0.0, 0.0, 0.0)),
        (740.0, (2600.0, 250.0, 0.0, 0.0)),
        # The first exit is too near to the first ramp.
        (2640.0, (0.7 * 2600.0, 250.0, 250.0, 250.0)),
        (2660.0, (0.7 * 0.8 * 2600.0, 0.8 * 250.0, 0.8 * 250.0, 250.0)),
    ):
        drawn = draw_origins(jnp.asarray(uniform), jnp.full(100_000, x), params.demand, params.road)
        shares = [(np.asarray(drawn) == place).mean() for place in (0.0, *ramps)]
        np.testing.assert_allclose(shares, np.array(flows) / sum(flows), atol=2e-5)


def test_destinations_of_who_is_on_the_road_at_reset(road):
    """As many as of those that enter leave at each exit, of all lanes; near it, in the lanes nearest to it alone."""
    env, params = road
    size, lanes, view = 100_000, env.config.num_lanes, float(params.lane_change.exit_view_m)
    uniform = jnp.asarray((np.arange(size) + 0.5) / size, jnp.float32)
    begins = 1000.0 - float(params.road.exit_lane_m)  # of the first exit's deceleration lane

    def shares(x, origin, to_go, params=params):
        on_road = jnp.full(size, x), jnp.full(size, origin), jnp.full(size, to_go)
        drawn = draw_destinations_on_road(uniform, *on_road, env.config, params)
        return [(np.asarray(drawn) == place).mean() for place in EXITS]

    for to_go in range(lanes):
        np.testing.assert_allclose(shares(1500.0, 0.0, to_go), (0.0, 0.2), atol=2e-5)
    # One more lane change needs another 295 m. Three of ten leave here, more than one lane of four holds.
    for to_lane, in_lanes in ((1.0, 2), (view - 1.0, 2), (2.0 * view + 1.0, 3)):
        every = [shares(begins - to_lane, 0.0, to_go)[0] for to_go in range(lanes)]
        expected = [0.3 * lanes / in_lanes] * in_lanes + [0.0] * (lanes - in_lanes)
        np.testing.assert_allclose(every, expected, atol=2e-5)
    few = params.replace(demand=params.demand.replace(exit_share=jnp.array([0.1, 0.2])))
    every = [shares(begins - 1.0, 0.0, to_go, few)[0] for to_go in range(lanes)]
    np.testing.assert_allclose(every, [0.1 * lanes] + [0.0] * (lanes - 1), atol=2e-5)
    # Who entered within the notice of the exit passes it, and so does who is beside its deceleration lane.
    np.testing.assert_allclose(shares(begins - 1.0, 500.0, 0), (0.0, 0.2), atol=2e-5)
    np.testing.assert_allclose(shares(begins + 1.0, 0.0, 0), (0.0, 0.2), atol=2e-5)


def test_desire_grows_as_in_lmrs(road):
    """1 - x / (n 295 m), n lanes to go and x to the deceleration lane; 0 for all others."""
    env, params = road
    state = jax.jit(env.reset)(jax.random.key(0), params)[1]
    rng = np.random.default_rng(0)
    size = env.config.num_vehicles
    x, lane = rng.uniform(0.0, 4000.0, size), rng.integers(0, 5, size)
    destination = rng.choice([*EXITS, 4000.0], size)
    vehicles = state.vehicles.replace(
        x=jnp.asarray(x, jnp.float32),
        lane=jnp.asarray(lane, jnp.int32),
        destination=jnp.asarray(destination, jnp.float32),
    )
    desire = np.asarray(exit_desire(vehicles, env.config, params))
    near = np.asarray(is_preparing_exit(vehicles, env.config, params))
    lanes, to_go = 3 - lane, destination - 250.0 - x
    goes = (destination < 4000.0) & (lanes > 0)
    expected = np.where(goes, np.clip(1.0 - to_go / (295.0 * np.maximum(lanes, 1)), 0, 1), 0)
    np.testing.assert_allclose(desire, expected, atol=1e-4)
    crosses = 295.0 * (np.maximum(lanes, 0) + 1)
    np.testing.assert_array_equal(near, (destination < 4000.0) & (to_go < crosses))


@pytest.fixture(scope="module")
def played(road):
    """Six episodes of 200 s: vehicles after every tick, and the tallies."""
    env, params = road
    probed = env.with_probe(lambda state: state.vehicles)

    @jax.jit
    @jax.vmap
    def play(key):
        start = env.reset(key, params)[1]

        def decide(state, key):
            _, state, *_, info = probed.step_env(key, state, 0, params)
            return state, (jax.tree.map(jnp.ravel, info["begun"]), info["ticks"])  # of one round

        state, seen = jax.lax.scan(decide, start, jax.random.split(key, 200))
        return state.stats, seen

    return jax.device_get(play(jax.random.split(jax.random.key(1), 6)))


@pytest.mark.thorough
def test_vehicles_leave_where_they_are_bound_for(road, played):
    """A vehicle vanishes in the rightmost lane beside its own deceleration lane, past the end, or out of charge."""
    _, (begun, ticks) = played
    active = np.concatenate([begun.active[:, :, None], ticks.active], axis=2)
    gone = active[:, :, :-1] & ~active[:, :, 1:]
    x, lane, to = ticks.x[gone], ticks.lane[gone], ticks.destination[gone]
    is_ev = np.zeros(gone.shape, bool)
    is_ev[..., road[0].config.ev_slots] = True
    at_exit = (to < 4000.0) & (lane == 3) & (x <= to) & (x >= to - 250.0)
    assert (at_exit | (x > 4000.0) | is_ev[gone]).all()
    assert at_exit.sum() > 300
    assert np.abs(ticks.lateral_offset[gone][at_exit]).max() < 1.0
    assert (at_exit & (to == 1000.0)).any()
    assert (at_exit & (to == 2900.0)).any()


@pytest.mark.thorough
def test_exits_are_not_missed_and_nobody_collides(played):
    """Under 1 % at 650 vehicles an hour and lane; all that entered are on the road, have left, or ran out."""
    stats, (_, ticks) = played
    exits = (stats.left.sum(), stats.missed_exits.sum())
    assert exits[1] < 0.01 * exits[0]
    assert stats.collisions.sum() == 0
    there = ticks.active[:, -1, -1].sum(axis=1)
    np.testing.assert_array_equal(stats.entered.sum(1) - stats.left.sum(1) - stats.depleted, there)


@pytest.mark.thorough
def test_entering_vehicles_are_bound_as_the_demand_says(road, played):
    """30 % of cars and lorries that enter at x = 0 for the first exit, 14 % for the second; none nearer to them."""
    _, (begun, ticks) = played
    others = slice(road[0].config.ev_slots.stop, None)  # EVs may think of a charger at once
    new = begun.active[:, 1:] & ~ticks.active[:, :-1, -1]
    x, to = (values[:, 1:, others][new[..., others]] for values in (begun.x, begun.destination))
    for place, expected in ((0.0, [0.3, 0.14]), (100.0, [0.0, 0.2]), (2100.0, [0.0, 0.0])):
        here = to[x == place]
        assert len(here) > 30
        error = np.sqrt(0.25 / len(here))
        shares = [(here == exit_x).mean() for exit_x in EXITS]
        np.testing.assert_allclose(shares, expected, atol=3.5 * error)
    assert not np.isin(to[x == 2100.0], EXITS).any()
    assert not (to[x == 100.0] == 1000.0).any()

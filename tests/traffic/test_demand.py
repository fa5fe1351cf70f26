"""Demand: arrivals against SciPy, slots for entering vehicles, and a road filled as asked."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import poisson

import medjax
from medjax.traffic.demand import (
    MOST_ARRIVALS,
    assign_slots,
    desired_speeds,
    drawn_kinds,
    entries,
    entry_rates,
    expected_vehicles,
    fill_road,
    poisson_arrivals,
)
from medjax.world.kinds import GAS, LORRY

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.mark.parametrize("expected", [0.0, 0.02, 0.2, 1.0, 2.0])
def test_poisson_arrivals(expected):
    """Evenly spread uniforms fall into counts as often as SciPy's pmf says, to 1e-5."""
    draws = 1_000_000
    uniform = (np.arange(draws) + 0.5) / draws
    counts = poisson_arrivals(uniform.astype(np.float32), jnp.full(draws, expected))
    shares = np.bincount(counts, minlength=MOST_ARRIVALS + 1) / draws
    pmf = poisson.pmf(np.arange(MOST_ARRIVALS), expected)
    np.testing.assert_allclose(shares[:-1], pmf, atol=1e-5)
    assert shares[-1] == pytest.approx(poisson.sf(MOST_ARRIVALS - 1, expected), abs=1e-5)


def test_the_cap_on_arrivals_is_rare():
    """With 2 expected it cuts less than once in 4000 rounds; with 0 expected nobody arrives."""
    assert poisson.sf(MOST_ARRIVALS, 2.0) < 1 / 4000
    assert int(poisson_arrivals(jnp.float32(1 - 2**-24), jnp.float32(0.0))) == 0


def test_entries_and_their_rates(asked):
    """Four lanes at x = 0 share 2800 vehicles an hour, ramps, on lane index 4, have 300 each."""
    _, params = asked
    where = entries(params.road, 4)
    np.testing.assert_allclose(where.x, [0, 0, 0, 0, 100, 1200, 2100, 3200])
    np.testing.assert_array_equal(where.lane, [0, 1, 2, 3, 4, 4, 4, 4])
    rates = entry_rates(params.demand, 4, 0.0)
    np.testing.assert_allclose(3600 * rates, [700.0] * 4 + [300.0] * 4, rtol=1e-6)


def test_desired_speeds(asked):
    """Mean and spread of each kind; no draw is further than 2.5 standard deviations."""
    normal = jax.random.normal(jax.random.key(0), (40_000,))
    for kind, (mean, std) in enumerate([(25.0, 0.0), (30.0, 2.0), (30.0, 1.0), (30.0, 2.0)]):
        speed = np.asarray(desired_speeds(normal, jnp.full(40_000, kind), asked[1].drivers))
        assert speed.mean() == pytest.approx(mean, abs=4 * max(std, 1e-3) / 200)
        assert speed.std() == pytest.approx(std, rel=0.05, abs=1e-4)  # the cut takes 3 %
        assert np.abs(speed - mean).max() <= 2.5 * std + 1e-4


@settings(max_examples=200)
@given(st.lists(st.booleans(), min_size=8, max_size=8), st.integers(0, 2**20 - 1))
def test_place_is_one_to_one(admitted, bits):
    """The first entry gets the first free slot, and so on until either runs out."""
    free = np.array([bits >> slot & 1 for slot in range(20)], bool)
    for slots in (20, 3):
        free = free[:slots]
        entry, placed = assign_slots(jnp.array(admitted), jnp.array(free))
        pairs = list(zip(np.flatnonzero(free), np.flatnonzero(admitted), strict=False))
        expected = np.full(slots, -1)
        for slot, source in pairs:
            expected[slot] = source
        np.testing.assert_array_equal(entry, expected)
        np.testing.assert_array_equal(np.flatnonzero(placed), [source for _, source in pairs])


def test_fewer_slots_than_entries():
    """Entries without a free slot are not placed."""
    entry, placed = assign_slots(jnp.ones(8, bool), jnp.array([True, False, True]))
    np.testing.assert_array_equal(entry, [0, -1, 1])
    assert placed.sum() == 2
    entry, placed = assign_slots(jnp.ones(8, bool), jnp.zeros(3, bool))
    assert (entry == -1).all()
    assert not placed.any()


NUM_LANES = 4


@pytest.fixture(scope="module")
def fill(asked):
    """fill_road of `keys` roads with `slots` slots, half of them for EVs; and the kinds of the slots."""
    _, params = asked

    def run(slots, keys, drivers=params.drivers, **demand):
        demand = params.demand.replace(**{k: jnp.float32(v) for k, v in demand.items()})
        asked_for = params.replace(demand=demand, drivers=drivers)
        is_ev = jnp.arange(slots) < slots // 2
        kind = jnp.where(is_ev, 1, 3)

        def one(key):
            desired = desired_speeds(jax.random.normal(key, (slots,)), kind, drivers)
            return fill_road(key, kind, desired, NUM_LANES, asked_for)

        filled = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(1), keys))
        return jax.tree.map(np.asarray, filled), np.asarray(kind)

    return run


def bumper_gaps(filled, length):
    """Gap to the next vehicle of the lane and the follower's speed, over all roads and lanes."""
    gaps, speeds = [], []
    for x, lane, speed, active in zip(*filled, strict=True):
        for one in range(NUM_LANES):
            here = np.flatnonzero(active & (lane == one))
            here = here[np.argsort(x[here])]
            gaps.append(x[here[1:]] - length[here[1:]] - x[here[:-1]])
            speeds.append(speed[here[:-1]])
    return np.concatenate(gaps), np.concatenate(speeds)


@pytest.mark.parametrize("per_h", [500.0, 2800.0, 20_000.0])
@pytest.mark.parametrize("ramp_per_h", [300.0, 3000.0])  # nearly even, and far denser at the end
def test_filled_road_has_no_overlap(fill, asked, per_h, ramp_per_h):
    """Every headway is safe at the speed driven, from a sparse to a full road."""
    filled, kind = fill(800, 40, mainline_per_h=per_h, ramp_per_h=np.full(4, ramp_per_h))
    gap, speed = bumper_gaps(filled, np.asarray(asked[1].drivers.vehicle_length)[kind])
    assert (gap >= 2.0 + 1.5 * speed - 1e-2).all()
    assert filled.x[filled.active].min() >= 0
    assert filled.x[filled.active].max() <= 4000.0
    assert (filled.speed >= 0).all()
    assert filled.active.any(axis=1).all()


@pytest.mark.parametrize("per_h", [1500.0, 5000.0, 20_000.0])
def test_nobody_starts_with_hard_braking(fill, asked, per_h):
    """IDM asks for comfortable braking at most, in float64, where half of the vehicles are slow and long."""
    drivers = asked[1].drivers
    values = {
        "desired_speed": jnp.array([22.0, 22.0, 22.0, 32.0, 22.0]),
        "time_headway": jnp.array([1.5, 2.0, 2.0, 1.2, 2.0]),
        "vehicle_length": jnp.array([5.0, 16.0, 16.0, 5.0, 16.0]),
    }
    drivers = drivers.replace(desired_speed_std=jnp.zeros(5), **values)
    filled, kind = fill(800, 40, drivers, mainline_per_h=per_h)
    of_kind = {name: np.asarray(value, np.float64)[kind] for name, value in values.items()}
    a, b, s0 = (
        np.asarray(getattr(drivers, name), np.float64)[kind]
        for name in ("max_acceleration", "comfortable_deceleration", "min_gap")
    )
    hardest = 0.0
    for x, lane, speed, active in zip(*filled, strict=True):
        for one in range(NUM_LANES):
            here = np.flatnonzero(active & (lane == one))
            here = here[np.argsort(x[here])]
            own, ahead = here[:-1], here[1:]
            v = speed.astype(np.float64)[own]
            gap = x[ahead].astype(np.float64) - of_kind["vehicle_length"][ahead] - x[own]
            closing = v * (v - speed[ahead]) / (2.0 * np.sqrt(a * b)[own])
            wanted = s0[own] + np.maximum(v * of_kind["time_headway"][own] + closing, 0.0)
            braking = (wanted / gap) ** 2 - 1.0 + (v / of_kind["desired_speed"][own]) ** 4
            hardest = max(hardest, (a[own] * braking / b[own]).max(initial=0.0))
    assert 0.9 < hardest < 1.01


def test_long_vehicles_do_not_overlap(fill, asked):
    """Even if every EV is as long as a bus and the demand is beyond the road's room."""
    drivers = asked[1].drivers
    length = drivers.vehicle_length.at[1:3].set(12.0)
    filled, kind = fill(1600, 8, drivers.replace(vehicle_length=length), mainline_per_h=60_000.0)
    gap, _ = bumper_gaps(filled, np.asarray(length)[kind])
    assert gap.min() > 0.0


def test_a_dense_end_of_the_road_limits_the_count(fill, asked):
    """Far more enter at the ramps than there is room for: where it is densest, standing gaps are left."""
    filled, kind = fill(3200, 8, mainline_per_h=500.0, ramp_per_h=np.full(4, 30_000.0))
    gap, _ = bumper_gaps(filled, np.asarray(asked[1].drivers.vehicle_length)[kind])
    assert gap.min() >= np.asarray(asked[1].drivers.min_gap)[kind].max()


def test_filled_road_matches_the_demand(fill, asked):
    """Counts, their spread and class shares over 1500 roads, within four standard errors."""
    demand, road = asked[1].demand, asked[1].road
    # Each entry's flow times the seconds from there to the end at 30 m/s.
    flow = np.array([2800.0, 300.0, 300.0, 300.0, 300.0]) / 3600
    expected = np.sum(flow * (4000.0 - np.array([0.0, 100.0, 1200.0, 2100.0, 3200.0])) / 30.0)
    assert float(expected_vehicles(demand, road, 30.0)) == pytest.approx(expected, rel=1e-5)
    roads = 1500
    filled, kind = fill(400, roads)
    counts = filled.active.sum(axis=1)
    assert counts.mean() == pytest.approx(expected, abs=4 * np.sqrt(expected / roads))
    # Poisson: the variance is the mean; its relative error over n roads is sqrt(2 / n).
    assert counts.var(ddof=1) == pytest.approx(expected, rel=4 * np.sqrt(2 / roads))
    evs = (filled.active & (kind == 1)).sum(axis=1)
    share = 0.3 * expected
    assert evs.mean() == pytest.approx(share, abs=4 * np.sqrt(share / roads))
    assert evs.var(ddof=1) == pytest.approx(share, rel=4 * np.sqrt(2 / roads))
    # Lanes and places do not depend on the class.
    lanes = np.bincount(filled.lane[filled.active], minlength=NUM_LANES)
    np.testing.assert_allclose(lanes / lanes.sum(), 0.25, rtol=0.0, atol=0.01)
    ev_x, entry = (
        filled.x[filled.active & (kind == 1)],
        np.array([0.0, 100.0, 1200.0, 2100.0, 3200.0]),
    )
    middle = np.average(0.5 * (entry + 4000.0), weights=flow * (4000.0 - entry))
    assert ev_x.mean() == pytest.approx(middle, abs=4 * 4000 / np.sqrt(12 * ev_x.size))


def test_lorries_are_a_share_of_fuelled_vehicles():
    """Exactly that share, and no EV is one; a lorry is slower and longer than a car."""
    uniform = jnp.linspace(0.0, 1.0, 10_001)[:-1]
    is_ev = jnp.arange(10_000) % 4 == 0
    for share in (0.0, 0.16, 1.0):
        _, params = medjax.make("paper", lorry_share=share)
        kind = np.asarray(drawn_kinds(uniform, is_ev, params.demand.class_shares))
        assert (kind[~is_ev] == LORRY).mean() == pytest.approx(share, abs=1e-3)
        assert set(kind[~is_ev]) <= {GAS, LORRY}
        assert not (kind[is_ev] == LORRY).any()
    drivers = params.drivers
    assert float(drivers.desired_speed[LORRY]) == pytest.approx(85 / 3.6, abs=0.1)  # the limiter
    assert float(drivers.vehicle_length[LORRY]) == 16.5  # Directive 96/53/EC


def test_the_filled_road_holds_more_slow_vehicles():
    """Of each kind its flow times its travel time: more lorries than cars, if as many arrive."""
    speed, shares = np.array([30.0, 20.0, 30.0, 23.6]), np.array([0.1, 0.1, 0.4, 0.4])
    env, params = medjax.make(
        "paper",
        lorry_share=0.5,
        ev_share=0.2,
        desired_speed=[22.0, *speed],
        **{"num_evs": 120, "num_gas": 400, "battery_scale": 1.0},
        **{"arrival_soc_low": 1.0, "arrival_soc_high": 1.0},
    )
    flow_m = 2600.0 * 4000.0 + 250.0 * (3900.0 + 2800.0 + 1900.0 + 800.0)
    expected = flow_m / 3600.0 * shares / speed
    keys = jax.random.split(jax.random.key(2), 256)
    state = jax.jit(jax.vmap(lambda key: env.reset(key, params)[1]))(keys)
    kinds = np.asarray(state.vehicles.kind)[np.asarray(state.vehicles.active)]
    counts = np.bincount(kinds, minlength=5)[1:]
    np.testing.assert_allclose(counts / 256, expected, rtol=0.06)


def test_a_filled_road_is_as_dense_as_the_flow_past_each_place(fill):
    """Between two ramps vehicles are uniform, as many as flow times way over 30 m/s, by four standard errors."""
    roads, flow = 1500, {"mainline_per_h": 1200.0, "ramp_per_h": [900.0, 0.0, 600.0, 300.0]}
    filled, _ = fill(400, roads, **flow)
    ends = np.array([0.0, 100.0, 1200.0, 2100.0, 3200.0, 4000.0])
    passing = np.array([1200.0, 2100.0, 2100.0, 2700.0, 3000.0]) / 3600.0
    x = filled.x[filled.active]
    counts, _ = np.histogram(x, ends)
    expected = passing * np.diff(ends) / 30.0
    error = np.sqrt(expected / roads)
    assert (np.abs(counts / roads - expected) < 4.0 * error).all()
    for start, end in itertools.pairwise(ends):
        within = (x[(x > start) & (x < end)] - start) / (end - start)
        assert within.mean() == pytest.approx(0.5, abs=4.0 / (12.0 * within.size) ** 0.5)


def test_a_road_is_empty_where_nobody_passes(fill):
    """Without a main line up to the first ramp that has traffic; without demand everywhere."""
    filled, _ = fill(400, 50, mainline_per_h=0.0, ramp_per_h=[0.0, 0.0, 900.0, 0.0])
    assert filled.active.any(axis=1).all()
    assert filled.x[filled.active].min() >= 2100.0
    assert filled.x[filled.active].max() <= 4000.0
    nobody, _ = fill(400, 5, mainline_per_h=0.0, ramp_per_h=np.zeros(4))
    assert not nobody.active.any()

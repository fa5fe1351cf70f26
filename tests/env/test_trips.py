"""Trips: EVs leave for a charger, MEDs leave at an exit, and depots recharge them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.charging.energy import cruising
from medjax.env.trips import needs_charger, plan_trips
from medjax.world.state import AT_DEPOT, IN_SERVICE, LEAVING, NOT_BOOKED, RETIRED
from tests.charging.scene import put

pytestmark = pytest.mark.usefixtures("quick_compiles")

KWH = 3.6e6
POWER_W, DEPOT_W = 20e3, 400e3


@pytest.fixture(scope="module")
def road():
    """Twenty kilometres, exits at 5, 10 and 15 km, true packs, no demand."""
    size = {"num_evs": 8, "num_gas": 2, "length_m": 20_000, "exit_x_m": [5000, 10_000, 15_000]}
    size |= {"exit_share": 0.0, "battery_scale": 1.0, "mainline_per_h": 0, "ramp_per_h": 0}
    size |= {"turnaround_s": 60.0, "depot_power_w": DEPOT_W, "trip_m": 4000.0}
    env, params = medjax.make("paper", **size, arrival_soc_low=0.5)
    return env, params, jax.jit(env.reset)(jax.random.key(0), params)[1]


@pytest.fixture(scope="module")
def step(road):
    env, params, _ = road
    program = jax.jit(env.step_env)
    return lambda number, state, action: program(jax.random.key(number), state, action, params)[1]


def with_evs(state, config, x, energy_kwh, destination=20_000.0, med=NOT_BOOKED):
    """The state with EVs at these places, in the rightmost lane."""
    vehicles = {"x": x, "destination": destination, "speed": 30.0, "lateral_offset": 0.0}
    vehicles |= {"lane": config.num_lanes - 1, "active": True}
    evs = {"energy_j": jnp.asarray(energy_kwh) * KWH, "med": med, "charging_slot": med}
    return put(
        state,
        vehicles={name: (config.ev_slots, value) for name, value in vehicles.items()},
        evs={name: (slice(None), value) for name, value in evs.items()},
    )


def test_evs_that_cannot_reach_the_next_charger_leave_for_one(road):
    """671 J/m at 30 m/s: from 4500 m to the second exit 1.03 kWh, and a tenth of 30 kWh as a reserve."""
    env, params, state = road
    config = env.config
    speed, power_w = cruising(params)
    limit = float(5500.0 * power_w / speed / KWH + 3.0)
    assert limit == pytest.approx(4.03, abs=0.05)
    energy = limit + np.array([-1.0, -0.01, 0.01, 1.0, -1.0, -1.0, -1.0, -1.0])
    x = np.array([4500.0, 4500.0, 4500.0, 4500.0, 3900.0, 4900.0, 5100.0, 16_000.0])
    stops = needs_charger(with_evs(state, config, x, energy), config, params)
    # The last ones: before the first sign, beside the deceleration lane, past it, past the last exit.
    assert stops.tolist() == [True, True, False, False, False, False, False, False]
    own = with_evs(state, config, 4500.0, limit - 0.5, destination=10_000.0)
    assert needs_charger(own, config, params).all()
    own = with_evs(state, config, 4500.0, limit - 0.5, destination=5000.0)
    assert not needs_charger(own, config, params).any()
    assert not needs_charger(with_evs(state, config, 4500.0, 1.0, med=0), config, params).any()


def test_a_depleted_ev_goes_to_no_charger_and_keeps_its_tow_timer(road):
    """Even if it was on its way to one."""
    env, params, state = road
    config = env.config
    for stops in (False, True):
        now = with_evs(state, config, 4500.0, 0.0, destination=5000.0 if stops else 20_000.0)
        assert needs_charger(now, config, params).all() == (not stops)
        waits = {"is_depleted": True, "stops": stops, "standing_s": 100.0}
        now = put(now, evs={name: (slice(None), value) for name, value in waits.items()})
        after, _ = plan_trips(now, config, params)
        assert not needs_charger(now, config, params).any()
        np.testing.assert_array_equal(after.vehicles.destination, now.vehicles.destination)
        np.testing.assert_array_equal(after.evs.standing_s, 100.0)


def test_a_stop_is_made_and_counted(road, step):
    """Eight EVs that are low leave at the exit ahead, as charging stops, none of them depleted."""
    env, _, state = road
    x = 4200.0 - 60.0 * np.arange(8.0)
    state = with_evs(state, env.config, x, 2.0)
    for number in range(60):
        state = step(number, state, 0)
    assert float(state.stats.charging_stops) == 8.0
    assert float(state.stats.left.sum()) == 8.0
    assert float(state.stats.depleted) == 0.0


def test_a_missed_exit_is_counted_once_and_the_next_one_taken(road):
    """After the last exit, the destination is the road's end."""
    env, params, state = road
    for x, at, then in ((5001.0, 5000.0, 10_000.0), (15_001.0, 15_000.0, 20_000.0)):
        before = with_evs(state, env.config, x, 20.0, destination=at)
        after, stats = plan_trips(before, env.config, params)
        assert float(stats.missed_exits) == 8.0
        assert (after.vehicles.destination[env.config.ev_slots] == then).all()
        assert float(plan_trips(after, env.config, params)[1].missed_exits) == 0.0


def test_an_empty_med_leaves_at_the_next_exit_and_releases_its_evs(road):
    """At the first exit whose sign is still ahead: from 4500 m, the second."""
    env, params, state = road
    config = env.config
    state = with_evs(state, config, 8000.0, 20.0, med=0)
    reserve = float(params.fleet.reserve_soc * params.med_capacity_j)
    full, end = float(params.med_capacity_j), 20_000.0
    for x, energy, destination, bound, status in (
        (4500.0, reserve + 1e3, end, end, IN_SERVICE),
        (4500.0, reserve, end, 10_000.0, IN_SERVICE),
        (9500.0, reserve, end, 15_000.0, IN_SERVICE),
        (9400.0, full, 10_000.0, 10_000.0, LEAVING),
    ):
        vehicles = {"active": True, "lane": 2, "x": x, "destination": destination}
        now = put(
            state,
            vehicles={name: (0, value) for name, value in vehicles.items()},
            meds={"status": (0, IN_SERVICE), "energy_j": (0, energy)},
        )
        after, _ = plan_trips(now, config, params)
        assert float(after.vehicles.destination[0]) == bound
        assert int(after.meds.status[0]) == status
    assert (after.evs.med == NOT_BOOKED).all()
    assert not after.evs.is_charging.any()


def test_depots_give_back_what_meds_spent(road, step):
    """A MED leaves after its trip, charges at the depot's power, and then waits there, full; energies balance."""
    _, params, state = road
    full = float(params.med_capacity_j)
    left_at, back_at, spent = None, None, None
    for number in range(900):
        state = step(number, state, int(number == 0))
        status = int(state.meds.status[0])
        if left_at is None and status == RETIRED:
            left_at, spent = number, full - float(state.meds.energy_j[0])
            x = float(state.vehicles.x[0])
            assert 4750.0 <= x <= 5000.0  # the first exit after 100 m and 4 km
        if left_at is not None and status == AT_DEPOT:
            back_at = number
            break
    # It left within the second of `left_at`, and is seen again after the one in which its time is over.
    assert -1.0 <= back_at - left_at - (60.0 + spent / DEPOT_W) - 1.0 <= 1.0
    assert float(state.meds.energy_j[0]) == full
    assert float(state.stats.depot_energy_j) == pytest.approx(spent, rel=1e-5)

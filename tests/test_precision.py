"""Rounding in float32: each bound of docs/precision.md, where it is reached, against float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.charging.docking import approach_pace, docking_acceleration
from medjax.charging.energy import drive_energy
from medjax.charging.link import couple, misalignment
from medjax.env.dispatch import advance_clocks
from medjax.traffic.motion import ballistic_step
from medjax.world.params import FRONT, LEFT
from medjax.world.state import EpisodeStats
from tests.float64_ticks import platoon, played

pytestmark = pytest.mark.usefixtures("quick_compiles")

LENGTH_M, TICK_S = 100_000.0, 0.25
ULP_M = float(np.spacing(np.float32(LENGTH_M)))  # 7.8 mm
ROUNDING = 2.0**-24  # of float32, relative


@pytest.fixture(scope="module")
def long():
    return medjax.make("long")


# Positions.


def test_a_step_is_off_by_half_a_unit_in_the_last_place():
    """Of x; the rounding of the distance itself is negligible."""
    rng = np.random.default_rng(0)
    x = rng.uniform(0.5 * LENGTH_M, LENGTH_M, 20_000).astype(np.float32)
    speed = rng.uniform(10.0, 40.0, x.size).astype(np.float32)
    acceleration = rng.uniform(-3.0, 3.0, x.size).astype(np.float32)
    got, _ = ballistic_step(x, speed, acceleration, TICK_S)
    v, a = speed.astype(np.float64), acceleration.astype(np.float64)
    error = np.abs(np.asarray(got, np.float64) - (x + v * TICK_S + 0.5 * a * TICK_S**2))
    assert error.max() <= 0.5 * ULP_M + 4 * ROUNDING * 10.0
    assert error.max() > 0.49 * ULP_M  # the bound is reached


def test_drift_over_the_whole_road():
    """A vehicle is off by at most half a unit a tick."""
    speed = jnp.asarray(np.random.default_rng(1).uniform(15.0, 40.0, 100), jnp.float32)
    ticks = int(LENGTH_M / 15.0 / TICK_S)

    def tick(x, _):
        return ballistic_step(x, speed, jnp.zeros_like(x), TICK_S)[0], x

    _, x = jax.lax.scan(tick, jnp.zeros_like(speed), length=ticks)
    x, v = np.asarray(x), np.asarray(speed, np.float64)
    exact = np.arange(ticks)[:, None] * v * TICK_S
    half_units = 0.5 * np.spacing(x).astype(np.float64)
    bound = np.cumsum(half_units + 2 * ROUNDING * v * TICK_S, axis=0)
    on_road = x < LENGTH_M
    assert (np.abs(x - exact) <= bound)[on_road].all()
    # Over 100 km at 15 m/s that is a thousandth at most.
    assert bound[on_road].max() < LENGTH_M * 0.5 * ULP_M / (15.0 * TICK_S) < 1.1e-3 * LENGTH_M


def place_in_slot(start_m, speed, params, x_type):
    """Offset of an EV from its slot after a minute behind a MED at constant speed, m."""
    charging = params.charging

    def tick(carry, _):
        med_x, x, v = carry
        pace = approach_pace(med_x - x, speed, charging.approach_speed, 0.0, charging)
        command = docking_acceleration(v, pace, jnp.full_like(v, 2.0), charging)
        x, v = ballistic_step(x, v, command, TICK_S)
        return (ballistic_step(med_x, speed, jnp.zeros_like(v), TICK_S)[0], x, v), None

    start = jnp.full(speed.shape, start_m, x_type)
    (med_x, x, _), _ = jax.lax.scan(tick, (start, start - 0.2, speed), length=240)
    return np.asarray(x - med_x)


def test_an_ev_stands_in_its_slot_at_the_far_end(long):
    """Rounding by up to half a unit a tick is like a speed; docking stands off by that speed over its rate, well within
    the tolerance."""
    _, params = long
    speed = jnp.linspace(14.0, 25.0, 4001)
    rate = float(params.charging.approach_rate)
    bound = ULP_M / (TICK_S * rate) + 2 * ULP_M
    assert bound < 0.5 * float(params.charging.dock_tolerance_m)
    offset = np.abs(place_in_slot(0.9 * LENGTH_M, speed, params, jnp.float32))
    assert 0.3 * bound < offset.max() <= bound
    assert np.abs(place_in_slot(1000.0, speed, params, jnp.float32)).max() < 0.01 * bound + 1e-3


def test_the_offset_at_the_far_end_hardly_changes_the_link(long):
    """An EV that stands off by docking's bound keeps 95 % of the efficiency."""
    _, params = long
    off = ULP_M / (TICK_S * float(params.charging.approach_rate))
    along = jnp.array([0.0, off, -off])
    for charging_slot in (LEFT, FRONT):
        seen = misalignment(jnp.full(3, charging_slot), along, 0.0, 0.0, params.link.panel_gap_m)
        efficiency = np.asarray(couple(seen, params.link).efficiency)
        assert efficiency.min() > 0.95 * efficiency[0]


# Sums and clocks.


def summed(step_stats, decisions):
    """The tally of so many equal decisions."""
    add = lambda stats, _: (stats + step_stats, None)  # noqa: E731
    return jax.lax.scan(add, EpisodeStats.zeros(), length=decisions)[0]


@pytest.mark.parametrize("decisions", [3600, 86_400, 604_800])
def test_sums_of_an_episode(decisions):
    """An hour, a day, a week: off by at most half a unit a decision; counts are exact."""
    step_stats = EpisodeStats.zeros().replace(
        ev_distance_m=jnp.float32(5872.3),
        soc_seconds=jnp.float32(81.37),
        energy_sent_j=jnp.float32(3.9e6),
        depleted=jnp.float32(1.0),
        vehicle_ticks=jnp.float32(8001.0),
    )
    stats = summed(step_stats, decisions)
    for name in ("ev_distance_m", "soc_seconds", "energy_sent_j", "vehicle_ticks"):
        exact = decisions * np.float64(getattr(step_stats, name))
        assert abs(float(getattr(stats, name)) / exact - 1.0) <= decisions * ROUNDING, name
    assert float(stats.depleted) == decisions


def test_sums_stop_growing_after_2_to_the_24_decisions():
    """After half a year of seconds, one more decision is lost in rounding."""
    one = EpisodeStats.zeros().replace(ev_distance_m=jnp.float32(450.0))
    before = one.replace(ev_distance_m=jnp.float32(450.0 * 2**25))
    assert float((before + one).ev_distance_m) == float(before.ev_distance_m)
    before = one.replace(ev_distance_m=jnp.float32(450.0 * 2**23))
    assert float((before + one).ev_distance_m) > float(before.ev_distance_m)


@pytest.mark.parametrize(("tick_s", "ticks"), [(0.25, 4), (0.1, 10), (0.1, 4), (0.02, 3), (0.3, 1)])
def test_a_clock_runs_down_in_time(tick_s, ticks):
    """A clock of n decisions is off by n^2 of a decision's rounding errors; a hundredth becomes 0. It ends on time for
    up to 400 decisions, at most one late for up to 4000, and always on time if float32 holds a decision's seconds.
    """
    env, params = medjax.make("paper", tick_s=tick_s, ticks_per_round=ticks)
    state = jax.tree.map(
        lambda leaf: jnp.zeros(leaf.shape, leaf.dtype),
        jax.eval_shape(env.reset, jax.random.key(0), params)[1],
    )
    dt = env.config.decision_s
    assert 400**2 * ROUNDING < 0.01
    assert 4000**2 * ROUNDING < 1.0
    whole = np.array([1, 5, 20, 50, 120, 399, 600, 3600])
    clocks = jnp.asarray(whole * dt, jnp.float32)

    def decision(carry, _):
        clock, count = carry
        after = advance_clocks(state.replace(cooldown_s=clock), env.config, params)[0]
        return (after.cooldown_s, count + (clock > 0.0)), None

    start = clocks, jnp.zeros(clocks.shape, jnp.int32)
    (left, counts), _ = jax.lax.scan(decision, start, length=3700)
    assert (left == 0.0).all()
    late = np.asarray(counts) - whole
    assert ((late == 0) | (late == 1)).all()
    assert (late[whole < 400] == 0).all()
    if float(np.float32(dt)) == dt:
        assert (late == 0).all()


# All of it.


@pytest.mark.thorough
def test_ten_minutes_of_charging_at_the_far_end_against_float64():
    """The whole tick at 80 to 90 km: in both types the same EVs charge throughout, stand within docking's bound, and
    batteries and tallies agree."""
    env, params = medjax.make("long", num_meds=1, num_evs=4, num_gas=0, service_speed=17.987)
    ticks = 2400
    state = platoon(env, params, 80_000.0)
    (narrow, books), (wide, true) = (
        played(env, params, state, ticks, kind) for kind in (np.float32, np.float64)
    )
    assert narrow.vehicles.x.dtype == np.float32
    assert wide.vehicles.x.dtype == wide.evs.energy_j.dtype == np.float64
    assert narrow.evs.is_charging.all()
    assert wide.evs.is_charging.all()
    x, exact = narrow.vehicles.x.astype(np.float64), wide.vehicles.x
    assert np.abs(x - exact).max() <= ticks * 0.5 * ULP_M
    stand_off = (x - x[:, :1]) - (exact - exact[:, :1])
    assert np.abs(stand_off).max() <= ULP_M / (TICK_S * 0.35) + 2 * ULP_M
    for one, other, slots in (
        (narrow.evs, wide.evs, slice(0, 4)),
        (narrow.meds, wide.meds, slice(0, 1)),
    ):
        flowed = np.abs(other.energy_j[-1] - other.energy_j[0])
        assert (np.abs(one.energy_j[-1] - other.energy_j[-1]) < 5e-3 * flowed)[slots].all()

    # In float32 alone, summed in float64: what driving takes and what is sent leaves the pack.
    speed = narrow.vehicles.speed[:, 0].astype(np.float64)
    med = jax.tree.map(float, params.med)
    with jax.enable_x64(True):
        driven = np.asarray(drive_energy(speed[:-1], speed[1:], med, params.road, TICK_S)).sum()
    sent = books.energy_sent_j[1:].astype(np.float64).sum()
    spent = float(narrow.meds.energy_j[0, 0]) - float(narrow.meds.energy_j[-1, 0])
    assert spent == pytest.approx(driven + sent, rel=5e-6)
    # On the way into the slot the power depends on where exactly the EV is.
    assert sent == pytest.approx(true.energy_sent_j[1:].sum(), rel=5e-4)

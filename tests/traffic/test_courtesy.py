"""Vehicles that must change lanes fall in, others yield, and nobody brakes beyond comfort for it."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from medjax.traffic.idm import IDM_PLUS
from medjax.traffic.lane_change import LaneChangeIntent
from medjax.world.params import LaneChangeParams
from tests.traffic.cars import EGO, LENGTH, NEW_LEADER, OLD_LEADER, decided, drivers
from tests.traffic.reference import CAR, idm_plus
from tests.traffic.roads import Record, put

pytestmark = pytest.mark.usefixtures("quick_compiles")

SHORTEST, COMFORT, SIGHT = 0.56, 2.0, 360.0
COURTEOUS, CRAWL = 0.3, 2.0  # least urgency that asks others, least speed of those asked, m/s
PARAMS = LaneChangeParams(
    accepted_headway=SHORTEST,
    courtesy_braking=COMFORT,
    safe_braking=4.0,
    politeness=0.2,
    view_m=SIGHT,
)


@functools.cache
def five():
    """Five cars."""
    return drivers([CAR] * 5)


def courtesy(gap, speed, ahead, *, must=0.0, comes=0.0, between=None):
    """Limit, m/s^2, of an ego that cannot change yet, for a car on the right; `between`: gap to one in its own lane."""
    desire = jnp.zeros(5).at[EGO].set(must).at[NEW_LEADER].set(-comes)  # to the right
    x = jnp.zeros(5).at[NEW_LEADER].set(gap + LENGTH).at[OLD_LEADER].set((between or 0.0) + LENGTH)
    speeds = jnp.full(5, jnp.float32(speed)).at[NEW_LEADER].set(ahead)
    there = (EGO, NEW_LEADER) if between is None else (EGO, NEW_LEADER, OLD_LEADER)
    waits = LaneChangeIntent(desire, stay=jnp.full(5, False), may_change=jnp.full(5, False))
    return float(decided(five(), x, speeds, waits, PARAMS, there, IDM_PLUS))


@settings(max_examples=200)
@given(
    st.floats(-3.0, 500.0),
    st.floats(0.0, 33.0),
    st.floats(0.0, 33.0),
    st.floats(0.0, 1.0),
    st.booleans(),
)
def test_within_comfort_or_not_at_all(gap, speed, ahead, urgency, yields):
    """Against car following in float64 at the accepted headway, from -2 m/s^2 up; a yielding ego brakes by v^2 / 2 s at
    least. There is no limit where that would be harder, the leader out of sight, the change not urgent or the ego slow.
    """
    gap, speed, ahead = map(np.float32, (gap, speed, ahead))
    got = courtesy(gap, speed, ahead, **{"comes" if yields else "must": urgency})
    closing, room = max(speed - ahead, 0.0), gap - 0.5 * CAR["min_gap"]
    margin = closing**2 - 2 * COMFORT * room
    if min(abs(margin), abs(closing - 1.0), abs(gap - SIGHT)) < 0.01:
        return
    if abs(urgency - COURTEOUS) < 1e-6:
        return
    asked = urgency > COURTEOUS and speed > CRAWL
    if not (asked and gap < SIGHT and (closing < 1.0 or (room > 0.0 and margin < 0.0))):
        assert got == np.inf
        return
    headway = CAR["time_headway"] + (SHORTEST - CAR["time_headway"]) * urgency
    behind = idm_plus(CAR | {"time_headway": headway}, max(gap, 0.1), speed, ahead)
    steady = -(closing**2) / (2 * max(room, 0.1)) if yields else np.inf
    assert got == pytest.approx(max(min(behind, steady), -COMFORT), rel=1e-3, abs=1e-3)
    assert got >= -COMFORT


def test_only_the_nearest_behind_makes_room():
    """A vehicle with somebody ahead in its own lane before the gap does not brake for one that comes into the gap."""
    assert courtesy(12.0, 20.0, 20.0, comes=0.8, between=40.0) < 0.0
    assert courtesy(12.0, 20.0, 20.0, comes=0.8, between=10.0) == np.inf
    # Unless that one stands: then the first that can stop for it lets it in, 20^2 / 2 / 150 m.
    assert courtesy(151.0, 20.0, 0.0, comes=1.0, between=10.0) == pytest.approx(-1.34, abs=0.02)
    assert courtesy(90.0, 20.0, 0.0, comes=1.0, between=10.0) == np.inf
    # If it must change itself, it falls in behind all the same.
    assert courtesy(12.0, 20.0, 20.0, must=0.8, between=10.0) < 0.0


# The third ramp; its lane; slots of an EV and of the first gas vehicle.
RAMP, RIGHT, MERGER, FIRST = 2100.0, 3, 15, 55


def beside(quiet, blank, play, speed, x, merger, params=None):
    """A car on the ramp at (x, speed) beside a column in the right lane, all at `speed`; nobody else."""
    env, usual = quiet
    params, count = params or usual, len(x)
    slots, lanes = [MERGER, *range(FIRST, FIRST + count)], [4] + [RIGHT] * count
    speeds, desired = [merger[1]] + [speed] * count, [30.0] + [speed] * count
    state = put(blank, slots, [merger[0], *x], lanes, speeds, desired)
    return Record(play(state, params), env.config, params)


def when_merged(road):
    """The tick in which the ramp vehicle changes, None if it never does while it is on the road."""
    ticks = [tick for tick, who in road.changes() if who == MERGER and road.lane[tick, who] == 4]
    return ticks[0] if ticks else None


def test_a_gap_is_opened_and_taken(quiet, blank, play):
    """Beside a column at equilibrium, 17 m apart at 10 m/s, where no gap can be taken: the one behind makes one within
    comfort, and the merger takes it long before the lane ends, without having stopped."""
    _, params = quiet
    v, steady = 10.0, CAR["min_gap"] + 10.0 * CAR["time_headway"]
    x = RAMP + 150.0 - (steady + LENGTH) * np.arange(60)
    roads = {}
    for braking in (COMFORT, 0.0):
        change = params.lane_change.replace(courtesy_braking=braking, accepted_headway=1.2)
        stubborn = params.replace(lane_change=change)
        roads[braking] = beside(quiet, blank, play, v, x, (RAMP + 5.0, v), stubborn)
    road, merged = roads[COMFORT], when_merged(roads[COMFORT])
    never = when_merged(roads[0.0])
    assert roads[0.0].speed[never, MERGER] == 0.0  # it waits until the column has passed
    assert road.x[merged, MERGER] < RAMP + 200.0
    assert road.speed[: merged + 1, MERGER].min() > 0.5 * v
    _, follower = road.next_to(merged, MERGER)
    gaps = road.x[: merged + 1, follower - 1] - LENGTH - road.x[: merged + 1, follower]
    assert gaps[0] == pytest.approx(steady, abs=0.1)
    assert gaps[-1] > 1.2 * steady
    before = np.diff(road.speed[: merged + 1], axis=0) / 0.25
    assert before[:, FIRST:].min() > -COMFORT - 1e-3
    assert road.gaps().min() > 0.0


def test_nobody_yields_to_a_vehicle_that_is_too_slow(quiet, blank, play):
    """From 28 m/s to 8 within 45 m takes more than 4 m/s^2: the car on the main road passes at its speed."""
    road = beside(quiet, blank, play, 28.0, [RAMP - 50.0], (RAMP, 8.0))
    assert when_merged(road) is not None
    passed = np.argmax(road.x[:, FIRST] - LENGTH > road.x[:, MERGER])
    assert 0 < passed <= when_merged(road)
    assert road.speed[: passed + 1, FIRST].min() > 27.9


def test_a_standing_vehicle_is_let_in(quiet, blank, play):
    """A column of 34 cars, 60 m apart at 25 m/s, takes 80 s to pass, but one stops for it in comfort."""
    end = RAMP + 250.0 - CAR["min_gap"]
    road = beside(quiet, blank, play, 25.0, end - 50.0 - 60.0 * np.arange(34), (end, 0.0))
    merged = when_merged(road)
    assert merged * 0.25 < 30.0
    _, follower = road.next_to(merged, MERGER)
    assert follower is not None  # with more of the column behind it
    column = slice(FIRST, FIRST + 34)
    braking = np.diff(road.speed[:, column], axis=0)[road.active[1:, column]] / 0.25
    assert braking.min() > -PARAMS.safe_braking
    assert road.gaps().min() > 0.0


def test_a_merging_vehicle_falls_back_to_the_gap(quiet, blank, play):
    """Beside a car of equal speed it falls back within comfort and merges behind it."""
    v = 22.0
    road = beside(quiet, blank, play, v, [RAMP + 8.0], (RAMP + 5.0, v))
    merged = when_merged(road)
    assert merged is not None
    assert road.next_to(merged, MERGER) == (FIRST, None)
    braking = np.diff(road.speed[: merged + 40, MERGER]) / 0.25
    assert braking.min() > -COMFORT - 1e-3
    assert road.speed[: merged + 1, MERGER].min() > 0.75 * v
    assert road.x[merged, MERGER] < RAMP + 240.0

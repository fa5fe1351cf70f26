"""Measures of trajectories made by hand, whose figures are known."""

import dataclasses

import numpy as np
import pytest
import scipy.stats

from benchmarks.verification.validation import measures
from benchmarks.verification.validation.measures import find, half_widths, lane_changes, summarise
from benchmarks.verification.validation.merging import merges
from benchmarks.verification.validation.sections import (
    FundamentalDiagram,
    breakdown,
    detectors,
    fundamental_diagram,
)
from benchmarks.verification.validation.trajectories import neighbours
from tests.benchmarks.verification.validation.made import ROAD, TICK_S, drive, random_traffic, seen

RAMP = ROAD.num_lanes  # the lane beside a ramp


def test_detectors_keep_off_acceleration_lanes_and_ends():
    """The last one behind the last ramp; 50 m on either side are of the same lanes."""
    places = detectors(ROAD)
    assert places == [250.0, 450.0, 1625.0, 2450.0, 3375.0]
    for x in ROAD.ramp_x_m:
        assert all(place + 50.0 <= x or place - 50.0 >= x + 250.0 for place in places)


def stream(speed, headway_s, lane, minutes):
    """A vehicle per headway in one lane at one speed; the road is full of them from the first tick on."""
    last, spacing = round(minutes * 60.0 / TICK_S), speed * headway_s
    drives = []
    for start in np.arange(spacing - 60.0 * minutes * speed, ROAD.length_m, spacing):
        begin = round(max(-start, 0.0) / speed / TICK_S)
        x = max(start, 0.0)
        count = min(last - begin, int((ROAD.length_m - x) / speed / TICK_S) + 1)
        drives.append(drive([lane] * count, speed, x, begin))
    return seen(*drives, num_ticks=last)


def test_a_uniform_stream_has_its_flow_density_and_speed():
    """2.5 s of headway are 1440 vehicles/h; at 20 m/s 50 m apart: 20 vehicles/km."""
    diagram = fundamental_diagram(stream(20.0, 2.5, lane=1, minutes=2))
    assert diagram.flow.shape == (2, 5, 3)
    assert diagram.flow[:, :, 1] == pytest.approx(1440.0, rel=0.01)
    assert diagram.density[:, :, 1] == pytest.approx(20.0, rel=0.01)
    assert not diagram.flow[:, :, [0, 2]].any()
    assert diagram.speed() == pytest.approx(20.0)
    assert diagram.flow_per_lane() == pytest.approx(480.0, rel=0.01)


def test_standing_vehicles_have_density_but_no_flow():
    """Two in 100 m of one of three lanes; a section without vehicles has no speed."""
    diagram = fundamental_diagram(seen(*(drive([0] * 480, 0.0, x=x) for x in (230.0, 270.0))))
    assert diagram.density[:, 0, 0] == pytest.approx(20.0)
    assert diagram.speed()[:, 0] == pytest.approx(0.0)
    assert np.isnan(diagram.speed()[:, 1:]).all()


# Five minutes of 2000 on average, the highest; after five more 1800 in the queue, and then it is gone.
FLOWS = [1500] * 3 + [1900, 1950, 2000, 2050, 2100] + [1900] * 5 + [1750, 1850, 1800] + [900] * 2
QUEUE = [30] * 8 + [15] * 8 + [30] * 2
NONE = np.nan


@pytest.mark.parametrize(
    ("flows", "before", "behind", "minute", "expected"),
    [
        (FLOWS, QUEUE, 25, 8, (1100.0, 2000.0, 1800.0, 1900.0)),
        # In the first of three minutes the next detector is in a queue, too: its flow is no discharge.
        (FLOWS, QUEUE, [25] * 13 + [10] + [25] * 4, 8, (1100.0, 2000.0, 1825.0, 1900.0)),
        # Of two queues at once the one downstream is the bottleneck.
        (FLOWS, [30] * 8 + [15] * 10, [25] * 8 + [10] * 10, 8, (1775.0, 2100.0, 1540.0, 1540.0)),
        # Four slow minutes are no breakdown.
        ([1500] * 20, [30] * 8 + [15] * 4 + [30] * 8, 25, None, (NONE,) * 4),
    ],
)
def test_breakdowns(flows, before, behind, minute, expected):
    """Three detectors on one lane and speeds at two of them; 100 vehicles/h more behind the last ramp."""
    flow = np.array([[700.0, each, each + 100.0] for each in flows])
    speeds = np.stack([np.broadcast_to(each, len(flows)) for each in (before, behind, 25.0)], 1)
    diagram = FundamentalDiagram(
        np.array([1100.0, 1775.0, 3375.0]), *np.array([flow, flow / speeds / 3.6])[..., None]
    )
    found = breakdown(diagram, 30.0)
    assert found.minute == minute
    x_m, highest, after, discharge = expected
    drop = 1.0 - after / highest
    figures = [found.x_m, found.highest_before, found.after, found.discharge, found.capacity_drop]
    assert figures == pytest.approx([x_m, highest, after, discharge, drop], nan_ok=True)


def measured_merges(rows):
    return merges(rows, neighbours(rows))


def test_a_merge_between_two():
    """The follower brakes by 3 m/s2 at most; the gap is (50 - 5) m, at its 25 m/s."""
    merging = drive([RAMP] * 20 + [2] * 40, 20.0, x=500.0)
    leader = drive([2] * 60, 25.0, x=505.0)
    slowing = np.r_[np.full(24, 25.0), 25.0 - 0.75 * np.arange(1, 9), np.full(28, 19.0)]
    follower = drive([2] * 60, slowing, x=455.0)
    found = measured_merges(seen(merging, leader, follower))
    assert found.speed.tolist() == [20.0]
    assert found.share_used == pytest.approx([100.0 / 250.0])
    assert found.accepted_gap_s == pytest.approx([45.0 / 25.0])
    assert found.follower_acceleration == pytest.approx([-3.0])
    assert found.standing_s.tolist() == [0.0]
    # Vehicles beside the acceleration lane, from its start to its end, without merged ones.
    x, speed = np.r_[leader[2], follower[2]], np.r_[leader[3], slowing]
    passing = speed[(x >= 500.0) & (x <= 750.0)]
    assert found.relative_speed == pytest.approx([20.0 / passing.mean()])


def test_only_a_near_followers_braking_within_five_seconds_counts():
    speeds = np.r_[np.full(50, 25.0), np.full(10, 10.0)]
    rows = seen(drive([RAMP] * 20 + [2] * 40, 20.0, x=500.0), drive([2] * 60, speeds, x=430.0))
    assert measured_merges(rows).follower_acceleration.tolist() == [0.0]
    far = seen(drive([RAMP] * 20 + [2] * 40, 20.0, x=600.0), drive([2] * 60, speeds, x=300.0))
    assert np.isnan(measured_merges(far).follower_acceleration).all()


def test_standing_on_an_acceleration_lane():
    """3 s, and not at all; standing on the main road does not count."""
    stops = np.r_[np.full(8, 10.0), np.zeros(12), np.full(10, 10.0)]
    ramps = drive([RAMP] * 30, stops, x=500.0), drive([RAMP] * 10, 20.0, x=2500.0)
    found = measured_merges(seen(*ramps, drive([1] * 30, 0.0, x=100.0)))
    assert found.standing_s.tolist() == [3.0, 0.0]
    assert len(found.speed) == 0


def test_lane_changes_and_undone_ones_are_counted():
    """0 1 0 within 6 s is undone, within 6.25 s is not, 0 1 2 never; a merge is none."""
    rows = seen(
        drive([0] * 4 + [1] * 24 + [0] * 10, 20.0),
        drive([0] * 4 + [1] * 25 + [0] * 10, 20.0),
        drive([0] * 4 + [1] * 4 + [2] * 4, 20.0),
        drive([RAMP] * 4 + [2] * 4, 20.0, x=500.0),
    )
    found = lane_changes(rows)
    assert found.changes == 6
    assert found.undone == 1
    assert found.vehicle_km == pytest.approx((37 + 38 + 11 + 3) * 5.0 / 1e3)


def test_lateral_acceleration_comes_from_lateral_positions():
    """One vehicle drives a parabola of 1.5 m/s2, one straight on; without positions it is unknown."""
    time = np.arange(12) * TICK_S
    rows = seen(drive([0] * 12, 20.0), drive([0] * 12, 20.0))
    assert len(lane_changes(rows).lateral_acceleration) == 0
    known = dataclasses.replace(rows, lateral=np.r_[0.75 * time**2, np.full(12, 1.0)])
    assert lane_changes(known).lateral_acceleration == pytest.approx([1.5, 0.0])


def test_an_episode_of_a_few_vehicles():
    """One drives all the way, one stands idly, one stands behind it, one is on a ramp, two overlap."""
    through = drive([0] * 640, 25.0, x=0.0, first_tick=4)
    stands = drive([1] * 100, 0.0, x=1000.0)
    behind = drive([1] * 100, 0.0, x=1000.0 - 5.0 - 59.0)
    ramp = drive([RAMP] * 8, 10.0, x=500.0, first_tick=8)
    crash = drive([2] * 10, 20.0, x=1500.0), drive([2] * 10, 20.0, x=1503.0)
    found = find(seen(through, stands, behind, ramp, *crash, num_ticks=700), 30.0)
    assert (found.entered_main, found.entered_ramps, found.left) == (1, 1, 6)
    assert found.travel_s == pytest.approx([160.0])
    assert found.standing_s == 50.0
    assert found.idle_s == 25.0
    assert found.collisions == 10
    assert found.in_one_place == 3  # at ticks 0, 4 and 8
    assert found.vehicles_max == 6


def test_figures_pool_episodes():
    """Shares are of all vehicles, flows by all hours; what nobody did has no figure."""
    calm = find(seen(drive([RAMP] * 8 + [2] * 8, 20.0, x=500.0, first_tick=1), num_ticks=240), 30.0)
    stops = drive([RAMP] * 8, 0.0, x=500.0, first_tick=1)
    slow = find(seen(stops, stops, stops, num_ticks=240), 30.0)
    figures = summarise([calm, slow])
    assert figures["ramp_vehicles"] == 4
    assert figures["ramp_stop_share"] == 0.75
    assert figures["ramp_standing_mean_s"] == 1.5
    assert figures["entered_ramps_per_h"] == 4 * 30
    assert figures["merge_speed_median"] == 20.0
    assert np.isnan(figures["discharge"])
    assert np.isnan(figures["undone_share"])
    assert {type(value) for value in figures.values()} <= {int, float}


def test_an_empty_road_and_random_rows_are_measured():
    empty = seen(drive([], 20.0), num_ticks=480)
    assert find(empty, 30.0).left == 0
    assert find(random_traffic(0), 30.0).changed.changes > 0


def test_percentiles_leave_out_nan():
    assert measures.percentile(np.array([np.nan, 1.0, 3.0]), 50) == 2.0
    assert np.isnan(measures.percentile(np.array([np.nan]), 50))


def test_overlapping_bodies_are_counted_in_any_lanes():
    """Half-way through a lane change a car still covers its old lane, where it is nobody's leader."""
    rows = seen(drive([1] * 8, 20.0, x=1000.0), drive([2] * 8, 20.0, x=1002.0))
    assert find(rows, 30.0).in_one_place == 0  # unknown positions count as centred
    changing = dataclasses.replace(rows, lateral=np.repeat([4.0, 5.5], 8))
    found = find(changing, 30.0)
    assert (found.collisions, found.in_one_place) == (0, 2)


def test_intervals_use_students_t_over_episodes():
    """Travel times of 160, 200 and 250 s, against SciPy; a single episode has no interval."""
    counts = {speed: round(4000 / speed * 4 + 1) for speed in (25.0, 20.0, 16.0)}
    found = [find(seen(drive([0] * n, speed, first_tick=4)), 30.0) for speed, n in counts.items()]
    _, high = scipy.stats.t.interval(0.95, 2, 0.0, scipy.stats.sem([160.0, 200.0, 250.0]))
    assert half_widths(found)["travel_mean_s"] == pytest.approx(high, rel=1e-3)
    assert np.isnan(half_widths(found[:1])["travel_mean_s"])
    quantiles = scipy.stats.t.ppf(0.975, np.arange(1, len(measures.STUDENT_T) + 1))
    assert pytest.approx(quantiles, rel=1e-3) == measures.STUDENT_T

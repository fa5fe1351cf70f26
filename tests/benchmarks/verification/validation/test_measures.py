"""Measures of trajectories made by hand, whose figures are known."""

import dataclasses

import numpy as np
import pytest
import scipy.stats

from benchmarks.verification.validation.lanes import lane_changes
from benchmarks.verification.validation.measures import (
    STUDENT_T,
    find,
    half_widths,
    percentile,
    summarise,
)
from benchmarks.verification.validation.merging import merges
from benchmarks.verification.validation.sections import (
    Diagram,
    breakdown,
    detectors,
    diagram,
)
from benchmarks.verification.validation.trajectories import neighbours
from tests.benchmarks.verification.validation.made import (
    ROAD,
    TICK_S,
    drive,
    random_traffic,
    seen,
)

RAMP = ROAD.num_lanes  # the lane beside a ramp


def test_detectors_keep_off_acceleration_lanes_and_ends():
    """The last one behind the last ramp; 50 m on either side are of the same lanes."""
    places = detectors(ROAD)
    assert places == [250.0, 450.0, 1625.0, 2450.0, 3375.0]
    for x in ROAD.ramp_x_m:
        assert all(place + 50.0 <= x or place - 50.0 >= x + 250.0 for place in places)


def stream(speed, headway_s, lane, minutes):
    """A vehicle each headway in one lane at one speed, and the road full of them from the first tick on."""
    every = round(headway_s / TICK_S)
    last = round(minutes * 60.0 / TICK_S)
    drives = []
    for enters in range(-round(ROAD.length_m / speed / TICK_S), last, every):
        begin = max(enters, 0)
        x = (begin - enters) * speed * TICK_S
        count = min(last - begin, int((ROAD.length_m - x) / speed / TICK_S) + 1)
        drives.append(drive([lane] * count, speed, x, begin))
    return seen(*drives, num_ticks=last)


def test_a_uniform_stream_has_its_flow_density_and_speed():
    """2.5 s of headway are 1440 vehicles/h; at 20 m/s 50 m apart: 20 vehicles/km."""
    counted = diagram(stream(20.0, 2.5, lane=1, minutes=2))
    assert counted.flow.shape == (2, 5, 3)
    assert counted.flow[:, :, 1] == pytest.approx(1440.0, rel=0.01)
    assert counted.density[:, :, 1] == pytest.approx(20.0, rel=0.01)
    assert not counted.flow[:, :, [0, 2]].any()
    assert counted.speed() == pytest.approx(20.0)
    assert counted.flow_a_lane() == pytest.approx(480.0, rel=0.01)


def test_standing_vehicles_have_density_and_no_flow():
    """Two in 100 m of one of three lanes; where nobody is there is no speed."""
    rows = seen(drive([0] * 480, 0.0, x=230.0), drive([0] * 480, 0.0, x=270.0))
    counted = diagram(rows)
    assert counted.density[:, 0, 0] == pytest.approx(20.0)
    assert counted.speed()[:, 0] == pytest.approx(0.0)
    assert np.isnan(counted.speed()[:, 1:]).all()


def history(flows, before, behind=25.0):
    """A diagram of three detectors on one lane, speeds of two of them given: a bottleneck between these."""
    count = len(flows)
    flow = np.array([[700.0, behind, behind + 100.0] for behind in flows])[:, :, None]
    speeds = [np.broadcast_to(each, count) for each in (before, behind, 25.0)]
    return Diagram(
        np.array([1100.0, 1775.0, 3375.0]), flow, flow / np.stack(speeds, 1)[:, :, None] / 3.6
    )


# Five minutes of 2000 on average, the highest; after five more 1800 in the queue, and then it is gone.
FLOWS = [1500] * 3 + [1900, 1950, 2000, 2050, 2100] + [1900] * 5 + [1750, 1850, 1800] + [900] * 2


def test_a_breakdown_costs_what_it_costs():
    """From 2000 to 1800: a tenth, where it breaks down; 100 more behind the last ramp."""
    found = breakdown(history(FLOWS, [30] * 8 + [15] * 8 + [30] * 2), 30.0)
    assert (found.minute, found.x_m) == (8, 1100.0)
    assert found.highest_before == pytest.approx(2000.0)
    assert found.after == pytest.approx(1800.0)
    assert found.capacity_drop == pytest.approx(0.1)
    assert found.discharge == pytest.approx(1900.0)


def test_a_queue_from_further_on_is_no_discharge():
    """In the first of the three minutes the next detector is in a queue, too."""
    found = breakdown(
        history(FLOWS, [30] * 8 + [15] * 8 + [30] * 2, [25] * 13 + [10] + [25] * 4), 30.0
    )
    assert found.after == pytest.approx(1825.0)
    assert found.discharge == pytest.approx(1900.0)


def test_of_two_queues_at_once_the_last_one_is_the_bottleneck():
    found = breakdown(history(FLOWS, [30] * 8 + [15] * 10, [25] * 8 + [10] * 10), 30.0)
    assert found.x_m == 1775.0
    assert found.highest_before == pytest.approx(2100.0)


def test_four_slow_minutes_are_no_breakdown():
    found = breakdown(history([1500] * 20, [30] * 8 + [15] * 4 + [30] * 8), 30.0)
    assert found.minute is None
    assert np.isnan([found.discharge, found.highest_before, found.capacity_drop]).all()


def measured_merges(rows):
    return merges(rows, neighbours(rows))


def test_a_merge_between_two():
    """The follower brakes by 3 m/s2 at most; the gap is (50 - 5) m, at its 25 m/s."""
    lanes = [RAMP] * 20 + [2] * 40
    merging = drive(lanes, 20.0, x=500.0)
    leader = drive([2] * 60, 25.0, x=505.0)
    slowing = np.r_[np.full(24, 25.0), 25.0 - 0.75 * np.arange(1, 9), np.full(28, 19.0)]
    follower = drive([2] * 60, slowing, x=455.0)
    found = measured_merges(seen(merging, leader, follower))
    assert found.speed.tolist() == [20.0]
    assert found.share_used == pytest.approx([100.0 / 250.0])
    assert found.accepted_gap_s == pytest.approx([45.0 / 25.0])
    assert found.follower_acceleration == pytest.approx([-3.0])
    assert found.standing_s.tolist() == [0.0]
    # Of those who pass the acceleration lane in the right lane, from its start to its end, merged ones not.
    passing = [
        v
        for v, x in zip([*leader[3], *slowing], [*leader[2], *follower[2]], strict=True)
        if 500 <= x <= 750
    ]
    assert found.relative_speed == pytest.approx([20.0 / np.mean(passing)])


def test_braking_later_than_five_seconds_is_no_answer():
    speeds = np.r_[np.full(50, 25.0), np.full(10, 10.0)]
    rows = seen(drive([RAMP] * 20 + [2] * 40, 20.0, x=500.0), drive([2] * 60, speeds, x=430.0))
    assert measured_merges(rows).follower_acceleration.tolist() == [0.0]
    far = seen(drive([RAMP] * 20 + [2] * 40, 20.0, x=600.0), drive([2] * 60, speeds, x=300.0))
    assert np.isnan(measured_merges(far).follower_acceleration).all()


def test_who_stands_on_an_acceleration_lane():
    """3 s and not at all; who stands on the main road is not meant."""
    stops = np.r_[np.full(8, 10.0), np.zeros(12), np.full(10, 10.0)]
    rows = seen(
        drive([RAMP] * 30, stops, x=500.0),
        drive([RAMP] * 10, 20.0, x=2500.0),
        drive([1] * 30, 0.0, x=100.0),
    )
    found = measured_merges(rows)
    assert found.standing_s.tolist() == [3.0, 0.0]
    assert len(found.speed) == 0


def test_changes_are_counted_and_those_taken_back():
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


def test_lateral_acceleration_is_of_where_vehicles_are():
    """A parabola of 1.5 m/s2 for one, nothing for another; unknown where there is no lateral position."""
    time = np.arange(12) * TICK_S
    rows = seen(drive([0] * 12, 20.0), drive([0] * 12, 20.0))
    assert len(lane_changes(rows).lateral_acceleration) == 0
    known = dataclasses.replace(rows, lateral=np.r_[0.75 * time**2, np.full(12, 1.0)])
    assert lane_changes(known).lateral_acceleration == pytest.approx([1.5, 0.0])


def test_an_episode_of_a_few_vehicles():
    """Who entered, left, drove all the way, stood idly or behind another, and overlapped."""
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
    """Nothing fails where there is nobody, or nonsense."""
    empty = seen(drive([0], 20.0)).after(1.0)
    assert len(empty.x) == 0
    assert find(dataclasses.replace(empty, num_ticks=480), 30.0).left == 0
    assert find(random_traffic(0), 30.0).changed.changes > 0


def test_percentiles_leave_out_what_is_no_number():
    assert percentile(np.array([np.nan, 1.0, 3.0]), 50) == 2.0
    assert np.isnan(percentile(np.array([np.nan]), 50))


def test_bodies_in_one_place_whatever_their_lanes():
    """Half way through a change a car still covers the lane that it left, where nobody's leader is."""
    beside = drive([1] * 8, 20.0, x=1000.0), drive([2] * 8, 20.0, x=1002.0)
    rows = seen(*beside)
    assert (
        find(rows, 30.0).in_one_place == 0
    )  # in the middle of their lanes, as those whose place is not known
    changing = dataclasses.replace(rows, lateral=np.repeat([4.0, 5.5], 8))
    found = find(changing, 30.0)
    assert (found.collisions, found.in_one_place) == (0, 2)


def test_intervals_are_of_students_t_over_episodes():
    """Travel times of 160, 200 and 250 s, by SciPy; of one episode there is none."""
    found = [
        find(seen(drive([0] * round(4000 / speed * 4 + 1), speed, first_tick=4)), 30.0)
        for speed in (25.0, 20.0, 16.0)
    ]
    low, high = scipy.stats.t.interval(0.95, 2, 0.0, scipy.stats.sem([160.0, 200.0, 250.0]))
    assert half_widths(found)["travel_mean_s"] == pytest.approx(high, rel=1e-3)
    assert low == pytest.approx(-high)
    assert np.isnan(half_widths(found[:1])["travel_mean_s"])
    quantiles = scipy.stats.t.ppf(0.975, np.arange(1, len(STUDENT_T) + 1))
    assert pytest.approx(quantiles, rel=1e-3) == STUDENT_T

"""Lane changes and merging on the whole simulator: nothing unsafe, nothing lost, in any tick."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.traffic.lane_change import lane_change_phase
from medjax.world.kinds import MED, by_class
from medjax.world.params import EnvConfig
from medjax.world.state import MERGING
from tests.traffic.reference import idm_plus, parameters
from tests.traffic.roads import Record, put, records_of, run

pytestmark = pytest.mark.usefixtures("quick_compiles")

MED_SLOT, EV_SLOT, GAS_SLOT = 0, 15, 55
RAMP, END = 2100.0, 2350.0
B_SAFE = 4.0
# Gas vehicles and MEDs as conftest fixes them.
CAR = parameters(108.0, 1.5, 2.0, 1.4, 2.0) | {"length": 5.0}
TRUCK = parameters(79.2, 2.0, 4.0, 1.0, 2.0) | {"length": 12.0}
STOP_M = 0.05  # see test_motion
# float32 resolves x to 0.24 mm at 4 km: two such gaps move IDM's braking by less than this.
ROUNDING = 0.01


def assert_safe(road):
    """No change in the record asked more braking or less room than its urgency allows."""
    braking, room = road.least_to_spare()
    assert braking >= -ROUNDING
    assert room >= -ROUNDING


def merging_scene(quiet, blank, slot, sizes, hole):
    """A vehicle comes down the third ramp at 20 m/s beside a dense lane at 10 m/s: groups of gas vehicles in
    equilibrium, `hole` metres apart, that neither yield nor accept less than the usual headway."""
    _, params = quiet
    stubborn = params.lane_change.replace(courtesy_braking=0.0, accepted_headway=10.0)
    spacing = CAR["length"] + CAR["min_gap"] + CAR["time_headway"] * 10.0
    x, desired, foremost = [RAMP], [22.0 if slot == MED_SLOT else 30.0], 2600.0
    for size in sizes:
        x += [foremost - spacing * i for i in range(size)]
        desired += [10.0] + [30.0] * (size - 1)
        foremost = x[-1] - CAR["length"] - hole
    assert min(x) >= 0
    gas = np.arange(len(x) - 1)
    lanes, speeds = np.append(4, np.full(gas.size, 3)), np.append(20.0, np.full(gas.size, 10.0))
    state = put(blank, np.append(slot, GAS_SLOT + gas), x, lanes, speeds, desired)
    return state, params.replace(lane_change=stubborn)


def standing_gaps(kinds, distances, speed=20.0, dt=0.01):
    """Gaps at which a column comes to rest before a lane's end, by short float64 steps.

    All brake at B_SAFE to their standing gap from the end, and follow the next by IDM+.
    """
    v = np.full(len(kinds), speed)
    x = -np.asarray(distances)
    drivers = {name: np.array([kind[name] for kind in kinds]) for name in CAR}
    for _ in range(round(150 / dt)):
        gaps = np.append(1e6, x[:-1] - drivers["length"][:-1]) - x
        room = np.maximum(-x - drivers["min_gap"], 0.0)
        stop = (np.sqrt(2 * B_SAFE * room) - v) / dt
        a = np.maximum(np.minimum(idm_plus(drivers, gaps, v, np.append(v[0], v[:-1])), stop), -9.0)
        after = np.maximum(v + a * dt, 0.0)
        x, v = x + 0.5 * (v + after) * dt, after
    return np.append(0.0, x[:-1] - drivers["length"][:-1]) - x


@pytest.mark.parametrize("slot", [MED_SLOT, EV_SLOT])
def test_waits_at_the_end_while_no_gap_is_safe(quiet, blank, play, slot):
    """Beside an unbroken dense lane it never merges: it stops before the end and stands there."""
    env, _ = quiet
    state, params = merging_scene(quiet, blank, slot, [115], 0.0)
    road = Record(play(state, params), env.config, params)
    here = slice(0, 520)  # 130 s: the column passes the ramp's end for all of them
    assert (road.lane[here, slot] == 4).all()
    rest = standing_gaps([TRUCK if slot == MED_SLOT else CAR], [END - RAMP])
    assert END - road.x[here, slot].max() == pytest.approx(rest[0], abs=STOP_M)
    assert road.speed[519, slot] < 1e-4
    assert road.gaps().min() > 0.0


@pytest.mark.parametrize("slot", [MED_SLOT, EV_SLOT])
def test_merges_into_the_gap_that_opens(quiet, blank, play, slot):
    """A hole of 120 m in the same lane: it waits for it, and takes it between the two groups."""
    env, _ = quiet
    front = 40
    state, params = merging_scene(quiet, blank, slot, [front, 60], 120.0)
    road = Record(play(state, params), env.config, params)
    merges = [tick for tick, who in road.changes() if who == slot and road.lane[tick, who] == 4]
    assert len(merges) == 1
    leader, follower = road.next_to(merges[0], slot)
    assert (leader, follower) == (GAS_SLOT + front - 1, GAS_SLOT + front)
    assert road.speed[merges[0], slot] < 1.0  # it had to stop first
    assert road.x[merges[0], slot] < END
    assert_safe(road)
    assert road.gaps().min() > 0.0


def test_end_of_acceleration_lane_is_a_standing_obstacle(quiet, blank, play):
    """Beside a standing queue, ramp traffic stops at its standing gaps: to the end, to each other."""
    env, params = quiet
    queue = np.arange(2000.0, 2500.0, 7.5)
    count = len(queue)
    slots = np.concatenate([[EV_SLOT, MED_SLOT, EV_SLOT + 1], GAS_SLOT + np.arange(count)])
    x = np.concatenate([[RAMP + 100.0, RAMP + 60.0, RAMP], queue])
    lane, speed = np.repeat([4, 3], [3, count]), np.repeat([20.0, 0.0], [3, count])
    state = put(blank, slots, x, lane, speed, [30.0, 22.0, 30.0] + [1e-3] * count)
    road = Record(play(state, params), env.config, params)
    assert (road.lane[:, slots[:3]] == 4).all()
    first, truck, last = (road.x[-1, slot] for slot in slots[:3])
    expected = standing_gaps([CAR, TRUCK, CAR], [150.0, 190.0, 250.0])
    rest = [END - first, first - 5.0 - truck, truck - 12.0 - last]
    np.testing.assert_allclose(rest, expected, atol=STOP_M)
    assert rest[0] == pytest.approx(2.0, abs=STOP_M)
    assert road.gaps().min() > 0.0
    assert road.speed.min() >= 0.0


@pytest.mark.parametrize("slots", [(0, 1), (0, 2), (1, 0)])
@pytest.mark.parametrize("first", [0, 1, 2, 3])
def test_two_sides_never_take_one_gap(quiet, blank, play, slots, first):
    """Two MEDs abreast must both enter lane 2, where one has room: one goes, the other later; one is slower."""
    env, params = quiet
    gas = GAS_SLOT + np.arange(2)
    state = put(
        blank,
        [*slots, *gas],
        [500.0, 500.0, 570.0, 430.0],
        [1, 3, 2, 2],
        [22.0] * 4,
        [22.0, 20.0, 22.0, 22.0],
    )
    status = state.meds.status.at[jnp.array(slots)].set(MERGING)
    state = state.replace(meds=state.meds.replace(status=status))
    road = Record(play(state, params, first), env.config, params)
    ticks = {slot: tick for tick, slot in road.changes()}
    assert set(ticks) == set(slots)
    assert min(ticks.values()) < 4  # the gap is good for one at once
    assert abs(ticks[slots[0]] - ticks[slots[1]]) > 4  # and not for the other in the same second
    both = road.active[:, list(slots)].all(axis=1)
    assert (road.lane[both][-1, list(slots)] == 2).all()
    assert road.gaps().min() > 0.0
    assert_safe(road)


@pytest.mark.parametrize("tick_s", [0.25, 0.02, 0.05, 0.1, 0.125, 0.2, 0.3, 0.4, 0.5])
def test_everyone_looks_both_ways_once_a_second(tick_s):
    """Once left and once right in every window of the period, the even number of ticks nearest to a second."""
    config, slots = EnvConfig(tick_s=tick_s), 13
    period = 2 * config.lane_change_groups
    assert abs(period * tick_s - 1.0) <= tick_s + 1e-9
    seen = [lane_change_phase(jnp.asarray(t), config.lane_change_groups) for t in range(3 * period)]
    direction = np.array([phase.direction for phase in seen])
    phase = np.array([np.arange(slots) % phase.groups == phase.group for phase in seen])
    for start in range(2 * period):
        window = slice(start, start + period)
        for side in (-1, 1):
            looks = phase[window] & (direction[window] == side)[:, None]
            np.testing.assert_array_equal(looks.sum(axis=0), 1)


@pytest.fixture(scope="module")
def records(random_play, each_tick):
    """One Record a road."""
    env, params = each_tick
    return records_of(random_play, env.config, params)


@pytest.mark.thorough
def test_play_is_worth_checking(records, random_play):
    """Jams, merges, MEDs, bookings, exits and depletions all happen in what is checked below."""
    stats = jax.tree.map(lambda a: np.asarray(a[:, -1]), random_play.stats)
    assert (stats.left.sum(axis=1) > 50).all()
    assert stats.entered[:, MED].sum() > 40
    assert stats.depleted.sum() > 20
    assert stats.evs_served.sum() > 5
    merges = sum((road.lane[tick, slot] == 4) for road in records for tick, slot in road.changes())
    assert merges > 300
    assert min(road.speed[road.active].min() for road in records) < 5.0


@pytest.mark.thorough
def test_vehicles_are_conserved_in_every_tick(records, random_play, each_tick):
    """By class: entered = on the road + left + depleted, and each agrees with who appears in and vanishes from slots.

    An EV that runs out is counted then, and stays on the road until it is on the shoulder.
    """
    config = each_tick[0].config
    for i, road in enumerate(records):
        stats = jax.tree.map(lambda a, i=i: np.asarray(a[i]), random_play.stats)
        energy = np.asarray(random_play.evs.energy_j[i])
        appeared = ~road.active[:-1] & road.active[1:]
        gone = road.active[:-1] & ~road.active[1:]
        past_end = road.x[1:] > 4000.0
        dry = road.depleted
        entered, left = by_class(stats.entered), by_class(stats.left)
        classes = (config.med_slots, config.ev_slots, config.gas_slots)
        for k, slots in enumerate(classes):
            depleted = stats.depleted if k == 1 else 0.0
            counted = (road.active & ~dry)[:, slots].sum(axis=1)
            np.testing.assert_array_equal(entered[:, k], counted + left[:, k] + depleted)
            np.testing.assert_array_equal(np.diff(entered[:, k]), appeared[:, slots].sum(axis=1))
            np.testing.assert_array_equal(
                np.diff(left[:, k]), (gone & past_end & ~dry[1:])[:, slots].sum(axis=1)
            )
        ran_out = (~dry[:-1] & dry[1:])[:, config.ev_slots]
        np.testing.assert_array_equal(np.diff(stats.depleted), ran_out.sum(axis=1))
        assert (energy[1:][ran_out] == 0.0).all()
        # Off the road before its end, to the rightmost side: those that ran out, and nobody else.
        assert dry[1:][gone & ~past_end].all()
        assert (road.lane[1:][gone & ~past_end] >= 3).all()


@pytest.mark.thorough
def test_no_overlap_and_no_reversing_in_any_tick(records):
    """Gaps from sorted positions are positive, speeds not negative, on every road in every tick."""
    for road in records:
        assert road.gaps().min() > 0.0
        assert road.speed[road.active].min() >= 0.0
        on = road.active[:-1] & road.active[1:]
        step = (road.x[1:] - road.x[:-1])[on]
        assert step.min() >= 0.0
        # Nobody jumps: a tick's way is its mean speed's, or less where it stopped in it.
        mean = 0.5 * (road.speed[1:] + road.speed[:-1])[on] * 0.25
        assert (step <= mean + 1e-3).all()


@pytest.mark.thorough
def test_lanes_change_by_one_and_never_onto_a_ramp(records):
    """No vehicle goes back to an acceleration lane, leaves the road sideways, or skips a lane."""
    for road in records:
        ticks, slots = road.changes().T
        before, after = road.lane[ticks, slots], road.lane[ticks + 1, slots]
        assert (np.abs(after - before) == 1).all()
        assert (after < 4).all()
        assert (after >= 0).all()
        on_ramp = road.active & (road.lane == 4)
        ends = np.array([350.0, 1450.0, 2350.0, 3450.0])
        starts = ends - 250.0
        x = road.x[on_ramp][:, None]
        assert ((x >= starts) & (x <= ends)).any(axis=1).all()


@pytest.fixture(scope="module")
def continued(random_play, each_tick):
    """From four moments of every road, 50 s without entries: (Record, ticks' first number)."""
    env, params = each_tick
    moments = np.array([299, 599, 899, 1199])
    starts = jax.tree.map(lambda a: a[:, moments].reshape(-1, *a.shape[2:]), random_play)
    states = jax.vmap(run(env.config, 200), in_axes=(0, None, 0))(starts, params, starts.time)
    return list(zip(records_of(states, env.config, params), map(int, starts.time), strict=True))


@pytest.mark.thorough
def test_no_change_is_forced_through_an_unsafe_gap(continued):
    """Every change of random play, merges included: nobody has to brake harder than it may ask."""
    changes = sum(len(road.changes()) for road, _ in continued)
    merges = sum((road.lane[t, s] == 4) for road, _ in continued for t, s in road.changes())
    assert changes > 500
    assert merges > 30
    for road, _ in continued:
        assert_safe(road)


@pytest.mark.thorough
def test_all_change_to_the_side_of_the_tick(continued):
    """Even ticks left, odd ticks right; a vehicle changes only in its own turn."""
    for road, first in continued:
        for tick, slot in road.changes():
            number = first + tick
            side = road.lane[tick + 1, slot] - road.lane[tick, slot]
            assert side == (-1 if number % 2 == 0 else 1)
            assert slot // -(-road.lane.shape[1] // 2) == number // 2 % 2

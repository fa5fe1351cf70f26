"""An EV books a slot only if it gets there in time, at the speeds that docking drives."""

import functools

import jax
import jax.numpy as jnp
import pytest

from medjax.charging.booking import WORTHWHILE_S, Offers, Requests, grant
from medjax.charging.docking import gentle_rate
from medjax.world.state import NOT_BOOKED

pytestmark = pytest.mark.usefixtures("quick_compiles")

granted = jax.jit(grant)


def books(params, ahead_m, med_speed, desired, way=(1, 0), leaves_after_s=1e6, patience_s=1e6):
    """Whether an EV books a slot of a MED in lane 2; the way holds the EV's lane and the slot."""
    lane, slot = way
    leaves_x = jnp.array([1000.0 + med_speed * leaves_after_s])
    rate = float(gentle_rate(med_speed, params.drivers))
    med_there = (jnp.array([value]) for value in (1000.0, med_speed, 22.0, rate, 2, 12.0))
    free, nobody = jnp.arange(4)[None] == slot, jnp.zeros((1, 2), bool)
    asks = (jnp.array([value]) for value in (1000.0 + ahead_m, desired, lane, 5.0, True, 1e6, 1e9))
    none = jnp.full((1,), NOT_BOOKED, jnp.int32)
    offers = Offers(*med_there, free, leaves_x, nobody)
    patient = params.charging.replace(patience_s=patience_s)
    got, _ = granted(none, none, Requests(*asks), offers, patient)
    return int(got[0]) == 0


def drives_s(params, ahead_m, med_speed, desired, way):
    """Time that the controller of docking takes on a free road, in steps of 10 ms in float64.

    From 20 m before the front slot on, an EV of the lane beside needs 2 s to get into the MED's lane.
    """
    lane, slot = way
    charging = {name: float(value) for name, value in vars(params.charging).items()}
    to_slot = -3.5 if slot == 0 else charging["dock_gap_m"] + 5.0  # beside the MED, or ahead of it
    slowest = charging["slowest_share"] * 22.0
    accelerates, brakes = (
        float(getattr(params.drivers, name)[0])
        for name in ("max_acceleration", "comfortable_deceleration")
    )
    gentle = 1.5 * (accelerates * brakes) ** 0.5 / med_speed
    to_go, speed, seconds = to_slot - ahead_m, med_speed if ahead_m > 0.0 else desired, 0.0
    enters_at = 0.0 if lane == 2 else 1e9
    while abs(to_go) > charging["dock_tolerance_m"] and seconds < 1000.0:
        back = charging["approach_speed"]
        if slot == 3 and abs(to_go) < 20.0:
            enters_at = min(enters_at, seconds + 2.0)
        if slot == 3 and seconds >= enters_at:
            room = charging["dock_gap_m"] - to_go - charging["platoon_min_gap"]
            back = gentle * max(room - med_speed * charging["platoon_headway"], 0.0)
        pace = med_speed + min(
            max(charging["approach_rate"] * to_go, -back), charging["approach_speed"]
        )
        wanted = charging["speed_rate"] * (max(pace, slowest) - speed)
        speed = min(speed + 0.01 * max(wanted, -2.0), desired)
        to_go += 0.01 * (med_speed - speed)
        seconds += 0.01
    return seconds


@pytest.mark.parametrize("approach_speed", [2.0, 8.0])
@pytest.mark.parametrize(
    ("ahead_m", "med_speed", "desired", "way"),
    [
        (60.0, 22.0, 30.0, (1, 0)),  # falls back to three quarters of the service speed
        (60.0, 20.0, 30.0, (1, 0)),  # which a slow MED does not change
        (-90.0, 22.0, 30.0, (1, 0)),  # closes up at its desired speed
        (-90.0, 20.0, 24.0, (1, 0)),
        (40.0, 22.0, 30.0, (2, 3)),  # in the MED's lane, as gently as the MED takes it
        (90.0, 22.0, 30.0, (2, 3)),
        (40.0, 33.0, 36.0, (2, 3)),  # to the tolerance, where hardly any room is left
        (40.0, 22.0, 30.0, (1, 3)),  # gently in the last metres only
        (90.0, 22.0, 30.0, (1, 3)),
    ],
)
def test_booking_expects_evs_to_drive_as_docking_does(
    paper, ahead_m, med_speed, desired, way, approach_speed
):
    """In time before the MED leaves and the booking lapses, within a tenth and four seconds."""
    params = paper[1]
    params = params.replace(charging=params.charging.replace(approach_speed=approach_speed))
    seconds = drives_s(params, ahead_m, med_speed, desired, way)
    assert seconds < 200.0
    play = functools.partial(books, params, ahead_m, med_speed, desired, way)
    most, least = 1.1 * seconds + 4.0, 0.9 * seconds - 4.0
    assert play(most + WORTHWHILE_S, most)
    assert not play(least + WORTHWHILE_S, most)
    assert not play(most + WORTHWHILE_S, least)


def test_who_is_in_its_slot_already_books_it_in_a_jam(paper):
    """Within the tolerance there is no way to go, however slow the MED."""
    for med_speed in (22.0, 5.0):
        assert books(paper[1], -3.5 + 0.2, med_speed, 30.0)


@pytest.mark.parametrize(
    ("ahead_m", "med_speed", "desired"),
    [(60.0, 16.0, 30.0), (60.0, 16.5, 30.0), (-60.0, 22.0, 22.0), (-60.0, 22.0, 20.0)],
)
def test_who_cannot_get_to_a_slot_does_not_book_it(paper, ahead_m, med_speed, desired):
    """A MED in a jam drives slower than anyone falls back to; no EV drives faster than it desires."""
    usual = {"leaves_after_s": 1000.0, "patience_s": 1000.0}
    assert books(paper[1], ahead_m, 22.0, 30.0, **usual)
    assert not books(paper[1], ahead_m, med_speed, desired, **usual)

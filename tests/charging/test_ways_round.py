"""Which slots an EV can reach where another one is booked beside the MED; traffic does not know the booking rule."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.charging.booking import book
from medjax.charging.docking import Partner, charging_slot_x
from medjax.world.params import CHARGING_SLOTS, FRONT, LEFT, REAR, RIGHT
from medjax.world.state import NOT_BOOKED
from tests.charging.scene import MED_SPEED, MED_X, put, scene

pytestmark = pytest.mark.usefixtures("quick_compiles")

SECONDS, LANE = 60, 2  # played; of the MED
SIDES = {LEFT: (0, 1), RIGHT: (3,)}  # by slot, the lanes on its side
CASES = list(itertools.product(SIDES, range(4), (-100.0, -40.0, 40.0)))


@pytest.fixture(scope="module")
def road():
    """Long and empty."""
    size = {"num_meds": 2, "num_evs": 4, "num_gas": 2, "mainline_per_h": 0.0, "ramp_per_h": 0.0}
    return medjax.make("paper", **size, length_m=20_000.0, battery_scale=1.0, target_soc=0.9)


def placed(road, docked, lane, ahead_m):
    """EV 0 is in the slot `docked`, EV 1 in that lane so far ahead of the MED."""
    env, params = road
    med = Partner(jnp.float32(MED_X), jnp.float32(MED_SPEED), LANE, jnp.float32(12.0))
    slot = charging_slot_x(jnp.int32(docked), med, jnp.float32(5.0), params.charging.dock_gap_m)
    state = scene(
        env, params, charging_slot=docked, ev_x=slot, ev_lane=LANE + (1 if docked else -1)
    )
    first, everyone = env.config.num_meds, slice(None)
    other = {"x": MED_X + ahead_m, "lane": lane, "speed": 25.0, "active": True}
    other |= {"desired_speed": 30.0, "kind": state.vehicles.kind[first]}
    vehicles = {name: (first + 1, value) for name, value in other.items()}
    vehicles["destination"] = (everyone, params.road.length_m)
    evs = {"energy_j": (everyone, 0.35 * params.ev_capacity_j)}
    return put(state, vehicles=vehicles, evs=evs)


@pytest.fixture(scope="module")
def plays(road):
    """By given slot (NOT_BOOKED: EV 1 books one itself) and case: EV 1's slot, whether it docks, and the share of time
    in which EV 0 charges."""
    env, params = road
    starts = [placed(road, *case) for case in CASES]
    state = jax.tree.map(lambda *each: jnp.stack(each), *starts)

    @jax.jit
    @jax.vmap
    def play(state, charging_slot):
        given = state.evs.replace(
            med=state.evs.med.at[1].set(jnp.where(charging_slot == NOT_BOOKED, NOT_BOOKED, 0)),
            charging_slot=state.evs.charging_slot.at[1].set(charging_slot),
        )
        own = book(state, env.config, params)
        evs = jax.tree.map(lambda a, b: jnp.where(charging_slot == NOT_BOOKED, a, b), own, given)

        def decide(state, key):
            state = env.step_env(key, state, 0, params)[1]
            same = state.evs.charging_slot[1] == evs.charging_slot[1]
            return state, state.evs.is_charging[:2] & jnp.array([True, same])

        keys = jax.random.split(jax.random.key(0), SECONDS)
        charging = jax.lax.scan(decide, state.replace(evs=evs), keys)[1]
        return evs.charging_slot[1], charging[:, 1].any(), charging[:, 0].mean()

    slots = (NOT_BOOKED, *range(len(CHARGING_SLOTS)))
    each = [jax.device_get(play(state, jnp.full(len(CASES), slot))) for slot in slots]
    return dict(zip(slots, (list(zip(*columns, strict=True)) for columns in each), strict=True))


@pytest.mark.thorough
def test_no_ev_passes_a_docked_ev_in_its_lane(plays):
    """From behind, it does not reach the front slot; from ahead to the rear, it pushes the docked EV away."""
    for (docked, lane, ahead_m), front, rear in zip(CASES, plays[FRONT], plays[REAR], strict=True):
        if lane in SIDES[docked] and ahead_m < 0.0:
            assert not front[1], (docked, lane, ahead_m)
        if lane in SIDES[docked] and ahead_m > 0.0:
            assert rear[2] < 0.6, (docked, lane, ahead_m)


@pytest.mark.thorough
def test_an_ev_reaches_the_slot_that_it_books(plays):
    """From every place, it docks within a minute and does not push EV 0 out of its slot."""
    for case, (slot, docks, other) in zip(CASES, plays[NOT_BOOKED], strict=True):
        assert slot != NOT_BOOKED, case
        assert docks, case
        assert other > 0.9, case


@pytest.mark.parametrize(("docked", "lane"), [(LEFT, 1), (LEFT, 0), (RIGHT, 3)])
def test_the_front_slot_is_not_granted_from_behind_a_docked_ev(road, docked, lane):
    """Where only that one is free, an EV in the docked one's lane or beyond gets it from ahead, but not from behind."""
    env, params = road
    taken = [
        charging_slot
        for charging_slot in range(len(CHARGING_SLOTS))
        if charging_slot not in (FRONT, docked)
    ]
    booking = jax.jit(lambda state: book(state, env.config, params))

    def granted(lane, ahead_m):
        # EVs that are far away have booked the slots on the other side and behind.
        state, evs = placed(road, docked, lane, ahead_m), np.array([1, 2, 3])
        booked = {"med": (evs, np.array([NOT_BOOKED, 0, 0]))}
        booked["charging_slot"] = (evs, np.array([NOT_BOOKED, *taken]))
        return int(booking(put(state, evs=booked)).charging_slot[1])

    assert granted(lane, -60.0) == NOT_BOOKED
    assert granted(lane, 60.0) == FRONT

"""Bookings are a one-to-one map, made by the stated rule, at every decision."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import medjax
from medjax.charging.booking import (
    Offers,
    Requests,
    book,
    charging_slot_flags,
    grant,
    requests_and_offers,
)
from medjax.env.forecast import expected_need, free_slots
from medjax.world.params import CHARGING_SLOTS, LEFT
from medjax.world.state import IN_SERVICE, LEAVING, MERGING, NOT_BOOKED, QUEUED, RETIRED
from tests.charging.scene import MED_X, put, scene

pytestmark = pytest.mark.usefixtures("quick_compiles")

NUM_MEDS, NUM_EVS = 4, 12
granted, needs = jax.jit(grant), jax.jit(expected_need, static_argnums=1)


@pytest.fixture(scope="module")
def booking(paper):
    """`grant` of the paper's numbers, compiled."""
    return functools.partial(granted, params=paper[1].charging)


def draw(seed):
    """Random MEDs and EVs, some slots taken, some EVs booked."""
    rng = np.random.default_rng(seed)
    free = rng.random((NUM_MEDS, 4)) < 0.6
    # An EV sits on each taken slot as long as there are EVs.
    med, charging_slot = np.full(NUM_EVS, -1), np.full(NUM_EVS, -1)
    for ev, (m, p) in enumerate(np.argwhere(~free)[: NUM_EVS // 2]):
        med[ev], charging_slot[ev] = m, p
    asks = (rng.random(NUM_EVS) < 0.8) & (med < 0)
    x = rng.uniform(0, 1500, NUM_EVS)
    if seed % 3 == 0:  # ties: EVs side by side
        x = np.round(x / 300) * 300
    offers = Offers(
        x=jnp.asarray(rng.uniform(0, 1500, NUM_MEDS), jnp.float32),
        speed=jnp.full(NUM_MEDS, 22.0),
        service_speed=jnp.full(NUM_MEDS, 22.0),
        gentle_rate=jnp.full(NUM_MEDS, 0.07),
        lane=jnp.full(NUM_MEDS, 2, jnp.int32),
        length=jnp.full(NUM_MEDS, 12.0),
        free=jnp.asarray(free),
        leaves_x=jnp.full(NUM_MEDS, 4000.0),
        beside=jnp.asarray(~free[:, :2]),
    )
    requests = Requests(
        x=jnp.asarray(x, jnp.float32),
        desired_speed=jnp.full(NUM_EVS, 30.0),
        lane=jnp.asarray(rng.integers(0, 4, NUM_EVS), jnp.int32),
        length=jnp.full(NUM_EVS, 5.0),
        wants=jnp.asarray(asks),
        endurance_s=jnp.full(NUM_EVS, 500.0),
        leaves_x=jnp.full(NUM_EVS, 4000.0),
    )
    return jnp.asarray(med, jnp.int32), jnp.asarray(charging_slot, jnp.int32), requests, offers


def one_to_one(med, charging_slot):
    """Whether no slot has two EVs and every booked EV has a slot."""
    booked = med >= 0
    slots = list(zip(med[booked], charging_slot[booked], strict=True))
    return len(slots) == len(set(slots)) and np.all((charging_slot >= 0) == booked)


@given(st.integers(0, 2**31))
@settings(max_examples=100, deadline=None)
def test_nearest_ev_wins_its_nearest_med(booking, paper, seed):
    """Old bookings stay. New ones take free slots, one EV a slot: its nearest MED's, which no nearer EV asks."""
    _, params = paper
    med, charging_slot, requests, offers = draw(seed)
    new_med, new_charging_slot = (
        np.asarray(x) for x in booking(med, charging_slot, requests, offers)
    )
    old = np.asarray(med) >= 0
    assert np.array_equal(new_med[old], np.asarray(med)[old])
    assert np.array_equal(new_charging_slot[old], np.asarray(charging_slot)[old])
    assert one_to_one(new_med, new_charging_slot)
    new = np.flatnonzero((new_med >= 0) & ~old)
    assert np.all(np.asarray(requests.wants)[new])
    assert np.all(np.asarray(offers.free)[new_med[new], new_charging_slot[new]])
    ahead = np.asarray(offers.x)[None] - np.asarray(requests.x)[:, None]
    reach = np.asarray(offers.free).any(1) & (ahead <= float(params.charging.reach_ahead_m))
    reach &= ahead >= -float(params.charging.reach_behind_m)
    distance = np.where(reach, np.abs(ahead), np.inf)
    for ev in new:
        m = new_med[ev]
        assert distance[ev, m] == distance[ev].min() < np.inf
    # On a long road with energy to spare nobody is refused but for a nearer EV.
    asking = np.asarray(requests.wants) & np.isfinite(distance.min(1))
    for m in range(NUM_MEDS):
        rivals = np.flatnonzero(asking & (distance.argmin(1) == m))
        winners = [ev for ev in new if new_med[ev] == m]
        assert len(winners) <= 1
        if winners:
            assert distance[winners[0], m] <= min(distance[ev, m] for ev in rivals) or any(
                slot_is_blocked(requests, offers, ev, m) for ev in rivals
            )


def slot_is_blocked(requests, offers, ev, m):
    """Whether an EV can reach none of a MED's free slots: it passes neither the MED nor an EV booked beside it."""
    side = int(requests.lane[ev]) - int(offers.lane[m])
    left, right, rear, front = (bool(f) for f in offers.free[m])
    behind = float(requests.x[ev]) < float(offers.x[m]) - 3.5 * (side != 0)
    if side == 0:
        return not (left or right or (rear if behind else front))
    own, other = (left, right) if side < 0 else (right, left)
    return not (own or ((rear or other) if behind else front))


def test_too_far_or_too_late_is_refused(booking, paper):
    """An EV asks for nothing that it cannot reach: out of reach, out of road, or out of energy."""
    _, params = paper
    med = charging_slot = jnp.full((1,), NOT_BOOKED, jnp.int32)
    free, nobody = jnp.ones((1, 4), bool), jnp.zeros((1, 2), bool)

    def accepted(ev_x, med_x, endurance=500.0, leaves_x=4000.0, ev_leaves_x=4000.0):
        med_there = (jnp.array([value]) for value in (med_x, 22.0, 22.0, 0.07, 2, 12.0))
        offers = Offers(*med_there, free, jnp.array([leaves_x]), nobody)
        asks = (jnp.array([value]) for value in (ev_x, 30.0, 1, 5.0, True, endurance, ev_leaves_x))
        got, _ = booking(med, charging_slot, Requests(*asks), offers)
        return int(got[0]) == 0

    assert accepted(900.0, 1000.0)
    assert not accepted(900.0, 901.0 + float(params.charging.reach_ahead_m))
    assert not accepted(900.0, 899.0 - float(params.charging.reach_behind_m))
    assert not accepted(3800.0, 3950.0)  # the MED leaves in 2.3 s
    assert not accepted(900.0, 1000.0, leaves_x=1050.0)  # by an exit
    assert not accepted(900.0, 1000.0, ev_leaves_x=1050.0)
    assert not accepted(900.0, 1000.0, endurance=3.0)


@pytest.mark.thorough
@pytest.mark.parametrize("exit_x", [2000.0, 4000.0])
def test_requests_and_offers_end_before_the_exit(exit_x):
    """250 m before it (deceleration lane) and 295 m for each lane to cross and one more; or at the road's end."""
    env, params = medjax.make("paper", exit_x_m=[2000.0], exit_share=0.0)
    config, (_, state) = env.config, jax.jit(env.reset)(jax.random.key(0), params)
    vehicles = state.vehicles
    lane = jnp.arange(config.num_vehicles, dtype=jnp.int32) % config.num_lanes
    state = state.replace(
        vehicles=vehicles.replace(lane=lane, destination=jnp.full_like(vehicles.x, exit_x))
    )
    begins = 2000.0 - 250.0 - 295.0 * (config.num_lanes - lane)
    expected = begins if exit_x == 2000.0 else jnp.full_like(begins, 4000.0)
    requests, offers = requests_and_offers(state, config, params)
    np.testing.assert_allclose(requests.leaves_x, expected[config.ev_slots], atol=1e-2)
    np.testing.assert_allclose(offers.leaves_x, expected[config.med_slots], atol=1e-2)


@pytest.mark.thorough
def test_one_to_one_in_play():
    """At every decision of 16 busy episodes no slot has two EVs, and flags agree with the map."""
    env, params = medjax.make("paper", ev_share=0.4, request_soc=0.6, cooldown_s=5.0)
    policy = medjax.BASELINES["greedy"](env)

    def episode(key):
        reset_key, key = jax.random.split(key)
        _, state = env.reset(reset_key, params)

        def step(state, key):
            _, state, *_ = env.step_env(key, state, policy(key, None, state, params).action, params)
            evs = state.evs
            flags = charging_slot_flags(
                evs.med, evs.charging_slot, evs.med >= 0, env.config.num_meds
            )
            return state, (evs.med, evs.charging_slot, evs.is_charging, flags.sum())

        return jax.lax.scan(step, state, jax.random.split(key, 200))[1]

    keys = jax.random.split(jax.random.key(11), 16)
    seen = jax.jit(jax.vmap(episode))(keys)
    med, charging_slot, charging, flagged = (np.asarray(x) for x in seen)
    booked = med >= 0
    assert booked.any(axis=(1, 2)).all()
    slot = np.where(booked, med * 4 + charging_slot, -np.arange(med.shape[-1]) - 1)
    slot.sort(axis=-1)
    assert np.all(np.diff(slot, axis=-1) > 0)
    assert np.array_equal(booked, charging_slot >= 0)
    assert not np.any(charging & ~booked)
    assert np.array_equal(flagged, booked.sum(-1))


@pytest.fixture(scope="module")
def one_ramp():
    return medjax.make("paper", ramp_x_m=[400.0], ramp_per_h=[0.0])


SIDES = {"left": -1, "right": 1, "rear": 0, "front": 0}


@pytest.mark.parametrize("lane", range(4))
def test_a_slot_off_the_road_is_not_free(lane):
    """A MED in an outer lane offers one slot less to EVs, and in the forecast."""
    env, params = medjax.make("paper", service_lane=lane)
    config, state = (
        env.config,
        scene(env, params, charging_slot=LEFT, ev_x=MED_X - 100.0, ev_lane=1),
    )
    state = put(state, evs={"med": (slice(None), NOT_BOOKED)})
    there = np.array([0 <= lane + SIDES[side] < config.num_lanes for side in CHARGING_SLOTS])
    _, offers = requests_and_offers(state, config, params)
    np.testing.assert_array_equal(offers.free[0], there)
    assert not offers.free[1:].any()
    np.testing.assert_array_equal(free_slots(state, config), there.sum())


def test_a_full_med_is_passed_over():
    """An EV near a MED whose last free slot lies off the road asks the next one."""
    env, params = medjax.make("paper", service_lane=3)
    state = scene(env, params, charging_slot=LEFT, ev_x=MED_X - 100.0, ev_lane=1)
    config = env.config
    asking, riders = config.num_meds, np.array([0, 1, 2, 3])  # EV 0, and EVs 1 to 3 on MED 0
    charging_slots = [side for side, name in enumerate(CHARGING_SLOTS) if name != "right"]
    now = put(
        state,
        vehicles={
            "active": (np.array([1, asking]), True),
            "x": (1, MED_X + 100.0),
            "lane": (1, 3),
            "destination": (1, params.road.length_m),
            "speed": (1, 22.0),
        },
        evs={
            "med": (riders, jnp.array([NOT_BOOKED, 0, 0, 0])),
            "charging_slot": (riders, jnp.array([NOT_BOOKED, *charging_slots])),
        },
        meds={"status": (1, IN_SERVICE)},
    )
    after = jax.jit(lambda state: book(state, config, params))(now)
    assert int(after.med[0]) == 1


@pytest.mark.parametrize(
    ("status", "charge", "accepts", "counts"),
    [
        (IN_SERVICE, 1.0, True, True),
        (QUEUED, 1.0, True, True),
        (MERGING, 1.0, True, True),
        (IN_SERVICE, 0.0, True, False),
        (IN_SERVICE, 1.0, False, False),
        (LEAVING, 1.0, True, False),
        (RETIRED, 1.0, True, False),
    ],
)
def test_the_forecast_counts_slots_of_meds_that_serve(one_ramp, status, charge, accepts, counts):
    """Now or soon: not of those that are empty, refuse, or leave."""
    env, params = one_ramp
    state = put(
        scene(env, params, charging_slot=LEFT, ev_x=MED_X - 100.0, ev_lane=1),
        meds={
            "status": (0, status),
            "energy_j": (0, charge * params.med_capacity_j),
            "accepts": (0, accepts),
        },
        evs={"med": (slice(None), NOT_BOOKED)},
    )
    need = needs(state, env.config, params, 60.0)
    assert float(need.free[0]) == (4.0 if counts else 0.0)

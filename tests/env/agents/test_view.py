"""An agent's observation: by hand, in its own frame, independent of the order of slots."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.charging.booking import book
from medjax.env.agents.environment import ROAD
from medjax.env.agents.view import OF_AN_EV, OF_ITSELF, AgentView
from medjax.world.state import IN_SERVICE, QUEUED
from tests.charging.scene import put

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_nearest_evs_by_hand(trips, busy):
    """Ways, speeds and bookings of the eight nearest, by a loop."""
    seen = np.asarray(trips.view(busy, trips.params))
    v, evs, meds = busy.vehicles, busy.evs, trips.config.num_meds
    capacity = float(trips.params.ev_capacity_j)
    for med in np.flatnonzero(np.asarray(busy.meds.status) == IN_SERVICE):
        there = [
            ev
            for ev in range(trips.config.num_evs)
            if v.active[meds + ev] and not evs.is_depleted[ev]
        ]
        way = {ev: float(v.x[meds + ev] - v.x[med]) for ev in there}
        nearest = sorted(there, key=lambda ev: abs(way[ev]))[:8]
        rows = seen[med, OF_ITSELF : OF_ITSELF + 8 * OF_AN_EV].reshape(8, OF_AN_EV)
        for ev, row in zip(nearest, rows, strict=False):
            slot = meds + ev
            assert row[0] == 1.0
            assert row[1] == pytest.approx(np.clip(way[ev] / 500.0, -1, 1), abs=1e-5)
            assert row[2] == pytest.approx(float(v.speed[slot] - v.speed[med]) / 30.0, abs=1e-5)
            assert row[3] == float(v.lane[slot]) - float(v.lane[med])
            assert row[4] == pytest.approx(float(evs.energy_j[ev]) / capacity, abs=1e-5)
            assert row[7] == (int(evs.med[ev]) == med)
            assert row[8] == (int(evs.med[ev]) not in (-1, med))
            assert row[9] == float(evs.is_charging[ev])
        assert (rows[len(nearest) :] == 0.0).all()
        assert nearest


def test_itself_by_hand(trips, busy):
    """Where in its day it is, its charge and its orders."""
    seen = np.asarray(trips.view(busy, trips.params))
    for med in range(4):
        own, status = seen[med, :OF_ITSELF], int(busy.meds.status[med])
        assert own[:6].tolist() == [float(number == status) for number in range(6)]
        if status == IN_SERVICE:
            assert own[6] == pytest.approx(float(busy.vehicles.x[med]) / 3000.0)
            assert own[7] == pytest.approx(float(busy.vehicles.speed[med]) / 30.0)
            assert own[11] == pytest.approx(float(busy.meds.service_speed[med]) / 30.0)
            booked = int((np.asarray(busy.evs.med) == med).sum())
            beside = 3 if int(busy.vehicles.lane[med]) in (0, 2) else 4  # of three lanes
            assert own[13] == pytest.approx((beside - booked) / 4)


def test_the_request_is_what_would_be_granted(trips, busy):
    """A MED sees the EV that booking puts on it in this state, and sees it, too, where it takes none."""
    start = OF_ITSELF + 8 * OF_AN_EV
    state, found = busy, 0
    booked = jax.jit(lambda state: book(state, trips.config, trips.params).med)
    for number in range(12):
        seen = np.asarray(trips.view(state, trips.params))[:, start : start + 6]
        granted = np.asarray(booked(state))
        before, x = np.asarray(state.evs.med), np.asarray(state.vehicles.x)
        for med in range(4):
            new = np.flatnonzero((granted == med) & (before != med))
            assert seen[med, 0] == len(new)
            for ev in new:
                way = np.clip((x[4 + ev] - x[med]) / 500.0, -1.0, 1.0)
                assert seen[med, 1] == pytest.approx(way, abs=1e-5)
                found += 1
        closed = state.replace(meds=state.meds.replace(accepts=jnp.zeros(4, bool)))
        refused = np.asarray(trips.view(closed, trips.params))[:, start : start + 6]
        np.testing.assert_array_equal(refused, seen)
        zero = jnp.zeros(4, jnp.int32)
        _, state, *_ = trips.step(jax.random.key(number), state, zero, trips.params)
    assert found > 0


def test_slots_do_not_matter(trips, busy):
    """EVs in other slots, and the other MEDs in other slots: the same view of the same MED."""
    rng = np.random.default_rng(0)
    evs, meds = rng.permutation(trips.config.num_evs), rng.permutation(4)
    place = np.argsort(meds)
    order = np.concatenate(
        [meds, 4 + evs, np.arange(4 + trips.config.num_evs, trips.config.num_vehicles)]
    )
    booked = np.asarray(busy.evs.med)[evs]
    moved = busy.replace(
        vehicles=jax.tree.map(lambda leaf: leaf[order], busy.vehicles),
        evs=jax.tree.map(lambda leaf: leaf[evs], busy.evs).replace(
            med=jnp.where(booked >= 0, place[booked], -1)
        ),
        meds=jax.tree.map(lambda leaf: leaf[meds], busy.meds),
    )
    before = np.asarray(trips.view(busy, trips.params))
    after = np.asarray(trips.view(moved, trips.params))
    serves = np.asarray(busy.meds.status) == IN_SERVICE
    np.testing.assert_allclose(after[place][serves], before[serves], atol=1e-6)
    assert np.abs(before[serves]).sum() > 1.0


def test_a_last_trip_is_not_seen(trips, busy):
    """Speed and lane that the slot of a waiting MED still holds change nobody's observation."""
    waits = jnp.arange(4) == 3
    status, seen = jnp.where(waits, QUEUED, IN_SERVICE), []
    for speed, lane in ((0.0, 0), (23.0, 2)):
        left = {"active": (slice(4), ~waits), "speed": (3, speed), "lane": (3, lane)}
        state = put(busy, vehicles=left, meds={"status": (slice(4), status)})
        seen.append(np.asarray(trips.view(state, trips.params)))
    np.testing.assert_array_equal(seen[0], seen[1])


def test_a_med_at_the_depot_sees_nobody(trips):
    """It sees the demand, the clock and itself."""
    obs, _ = trips.reset()
    around = np.asarray(obs)[:, OF_ITSELF : OF_ITSELF + 8 * OF_AN_EV + 6 + 10]
    assert (around == 0.0).all()
    assert obs.shape == (4, AgentView().size(trips.config))
    assert list(np.asarray(obs)[:, OF_ITSELF - 1]) == [1.0, 0.0, 0.0, 0.0]


def test_the_global_state_is_the_road_profile(trips, busy):
    """It is one vector for a central critic, and finite."""
    state = np.asarray(trips.global_state(busy, trips.params))
    assert state.shape == (ROAD.size(trips.config),)
    assert np.isfinite(state).all()

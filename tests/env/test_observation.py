"""Observations, recomputed from the state by plain NumPy loops."""

import jax
import numpy as np
import pytest

import medjax
from medjax.env.forecast import expected_need
from medjax.env.observation import FlatObservation, RoadProfile
from medjax.world.kinds import HUMAN_EV
from medjax.world.state import IN_SERVICE, MERGING, QUEUED

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.fixture(scope="module")
def busy():
    """A state with MEDs in service and EVs charging."""
    env, params = medjax.make("paper", request_soc=0.6)

    @jax.jit
    def play(key):
        _, state = env.reset(key, params)

        def step(state, key):
            return env.step_env(key, state, 1, params)[1], None

        return jax.lax.scan(step, state, jax.random.split(key, 150))[0]

    state = play(jax.random.key(2))
    assert bool(state.evs.is_charging.any())
    return env, params, state


def test_rows_by_hand(busy):
    """Every feature of every MED and EV, in the paper's order."""
    env, params, state = busy
    seen = env.observe(state, params)
    v, evs, meds = state.vehicles, state.evs, state.meds
    config = env.config
    for med in range(config.num_meds):
        flags = np.zeros((2, 4))
        for ev in range(config.num_evs):
            if int(evs.med[ev]) == med:
                flags[0, int(evs.charging_slot[ev])] = 1
                flags[1, int(evs.charging_slot[ev])] = float(evs.is_charging[ev])
        row = np.asarray(seen.meds[med])
        np.testing.assert_allclose(row[:4], motion(v, med), atol=1e-6)
        assert row[4] == pytest.approx(float(meds.energy_j[med] / params.med_capacity_j))
        assert row[5] == float(meds.status[med] == IN_SERVICE)
        np.testing.assert_array_equal(row[6:10], flags[0])
        np.testing.assert_array_equal(row[10:14], flags[1])
    for ev in range(config.num_evs):
        row, slot = np.asarray(seen.evs[ev]), config.num_meds + ev
        if not bool(v.active[slot]):
            np.testing.assert_array_equal(row, 0.0)
            continue
        np.testing.assert_allclose(row[:4], motion(v, slot), atol=1e-6)
        assert row[4] == pytest.approx(float(evs.energy_j[ev] / params.ev_capacity_j))
        is_human = int(v.kind[slot]) == HUMAN_EV
        assert list(row[5:7]) == [float(is_human), float(evs.is_charging[ev])]
        assert row[7] == pytest.approx((int(evs.med[ev]) + 1) / config.num_meds)
    np.testing.assert_array_equal(seen.ev_mask, v.active[config.ev_slots])
    np.testing.assert_array_equal(seen.med_mask, v.active[config.med_slots])


def motion(vehicles, slot):
    """x, y, vx, vy in the paper preset's units: 4000 m, 16 m, 30 m/s, 4 m/s."""
    if not bool(vehicles.active[slot]):
        return np.zeros(4)
    x, speed, lane = (float(getattr(vehicles, name)[slot]) for name in ("x", "speed", "lane"))
    y, lateral = lane * 4.0 + float(vehicles.lateral_offset[slot]), vehicles.lateral_speed[slot]
    return np.array([x / 4000.0, y / 16.0, speed / 30.0, float(lateral) / 4.0])


def test_the_flat_observation_concatenates_the_structured_one(busy):
    """MED rows, EV rows, clock; the clock is an option."""
    env, params, state = busy
    seen = env.observe(state, params)
    with_clock = FlatObservation()(state, env.config, params)
    without = FlatObservation(include_clock=False)(state, env.config, params)
    parts = [np.ravel(seen.meds), np.ravel(seen.evs)]
    np.testing.assert_array_equal(without, np.concatenate(parts))
    np.testing.assert_array_equal(with_clock, np.concatenate([*parts, seen.clock]))
    assert np.asarray(seen.clock[0]) == pytest.approx(1 - 150 / 600)


def test_observation_is_scaled(busy):
    """No feature exceeds a few units."""
    env, params, state = busy
    assert np.abs(np.asarray(env.observation(state, env.config, params))).max() <= 2.0


def share(place, node, nodes):
    """Linear interpolation's share of a place in [0, 1] at one of evenly spaced nodes."""
    return max(0.0, 1.0 - abs(place * (nodes - 1) - node))


def in_steps(values):
    """Shares rounded to 128ths, as in the profile."""
    return np.round(np.asarray(values) * 128) / 128


def test_profile_by_hand(busy):
    """Numbers of EVs by charge and of MEDs at 17 nodes of the road, by loops over vehicles."""
    env, params, state = busy
    v, evs, meds, config = state.vehicles, state.evs, state.meds, env.config
    expected_evs, expected_meds = np.zeros((17, 8)), np.zeros((17, 4))
    ahead, behind = np.full(4, 2.0), np.full(4, 2.0)
    for ev in range(config.num_evs):
        slot, booked = config.num_meds + ev, int(evs.med[ev]) >= 0
        if not bool(v.active[slot]):
            continue
        soc = float(evs.energy_j[ev] / params.ev_capacity_j)
        row = [0.0 if booked else share(soc, node, 6) for node in range(6)]
        row += [float(booked), float(evs.is_charging[ev])]
        for node in range(17):
            here = share(float(v.x[slot]) / 4000.0, node, 17)
            expected_evs[node] += in_steps(row) * in_steps(here)
    for med in range(config.num_meds):
        status = int(meds.status[med])
        x = float(params.road.ramp_x_m[int(meds.ramp[med])] if status == QUEUED else v.x[med])
        serves = status == IN_SERVICE
        free = 4 - sum(int(other) == med for other in evs.med)
        soc = float(meds.energy_j[med] / params.med_capacity_j)
        row = [float(status in (QUEUED, MERGING)), float(serves), serves * soc, serves * free]
        for node in range(17):
            expected_meds[node] += in_steps(row) * in_steps(share(x / 4000.0, node, 17))
        if status in (QUEUED, MERGING, IN_SERVICE):
            for ramp, at in enumerate((100.0, 1200.0, 2100.0, 3200.0)):
                nearest = ahead if x >= at else behind
                nearest[ramp] = min(nearest[ramp], abs(x - at) / 1000.0)
    profile = RoadProfile()
    got = np.asarray(jax.jit(lambda state: profile(state, config, params))(state))
    assert got.shape == (profile.size(config),)
    np.testing.assert_allclose(got[: 17 * 8].reshape(17, 8), expected_evs, atol=1e-6)
    np.testing.assert_allclose(got[17 * 8 : 17 * 12].reshape(17, 4), expected_meds, atol=1e-6)
    np.testing.assert_allclose(got[17 * 12 : -32], np.concatenate([ahead, behind]), atol=1e-5)
    needs = jax.jit(lambda state: expected_need(state, config, params, 60.0))
    need = needs(state)  # by hand in tests/policies/test_rules.py
    rows = [need.there / 4, need.shortfall, need.coming / 4, need.free / 4]
    np.testing.assert_allclose(got[-32:-16], np.concatenate(rows), atol=1e-5)
    clock = np.asarray(env.observe(state, params).clock)
    nodes = [[share(clock[index], node, 6) for node in range(6)] for index in (0, 2)]
    np.testing.assert_allclose(got[-16:-4].reshape(2, 6), nodes, atol=1e-6)
    np.testing.assert_array_max_ulp(got[-4:], clock)  # another program: equal bits are a CPU's
    seen, at_depot, time_left = profile.outlook(np.stack([got, got]), config)
    np.testing.assert_allclose(np.stack(seen)[:, 0], np.stack(need), atol=1e-5)
    np.testing.assert_array_max_ulp(np.stack([at_depot[1], time_left[1]]), clock[[2, 0]])
    ramps = np.asarray(profile.of_ramps(np.stack([got, got]), config))
    assert ramps.shape == (2, 4, 12)
    for ramp in range(4):
        own = [ahead[ramp], behind[ramp], *(row[ramp] for row in rows), clock[0], clock[2]]
        np.testing.assert_allclose(ramps[1, ramp], [*own, *np.eye(4)[ramp]], atol=1e-5)
    assert ahead.min() < 2.0
    assert behind.min() < 2.0
    assert expected_evs.sum() > 1.0
    assert expected_meds[:, 1].sum() > 0.5


def test_profile_ignores_the_order_of_slots(busy):
    """Two EVs that change slots leave the profile as it was."""
    env, params, state = busy
    order = np.arange(env.config.num_evs)
    order[[0, 1]] = 1, 0
    slots = np.concatenate([np.arange(15), 15 + order, np.arange(55, 208)])
    swapped = state.replace(
        vehicles=jax.tree.map(lambda values: values[slots], state.vehicles),
        evs=jax.tree.map(lambda values: values[order], state.evs),
    )
    profile = RoadProfile()
    before, after = (profile(s, env.config, params) for s in (state, swapped))
    np.testing.assert_allclose(before, after, atol=1e-4)
    np.testing.assert_array_equal(before[: 17 * 12], after[: 17 * 12])  # its sums are exact


def test_profile_of_a_road_without_ramps():
    """It has no features of ramps, and its size says so."""
    env, params = medjax.make("paper", observation="profile", num_ramps=0)
    obs, _ = jax.jit(env.reset)(jax.random.key(0), params)
    assert obs.shape == (env.observation.size(env.config),) == (17 * 12 + 2 * 6 + 4,)
    assert np.isfinite(obs).all()


@pytest.mark.thorough
def test_shares_are_of_the_fleet_and_not_of_its_slots():
    """With five MEDs in fifteen slots, of which one is sent, 4 of 5 are at the depot."""
    env, params = medjax.make("paper", observation="profile", size=5)
    _, state = jax.jit(env.reset)(jax.random.key(0), params)
    obs, state, *_ = jax.jit(env.step_env)(jax.random.key(1), state, 1, params)
    shares = np.asarray(env.observe(state, params).clock)[2:]
    queued = int((state.meds.status == QUEUED).sum())
    np.testing.assert_allclose(shares, [0.8, queued / 5], atol=1e-6)
    _, at_depot, _ = RoadProfile().outlook(obs, env.config)
    np.testing.assert_allclose(at_depot, 0.8, atol=1e-6)
    # Slots without a MED are zero, unlike a full MED that waits.
    np.testing.assert_array_equal(np.asarray(env.observe(state, params).meds)[5:], 0.0)

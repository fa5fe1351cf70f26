"""The road at reset carries the same traffic as the flow later on."""

import jax
import numpy as np
import pytest

import medjax

pytestmark = pytest.mark.usefixtures("quick_compiles")

ROADS, MINUTES = 128, 7
# 8 km take half of a pack at 30 m/s; who enters with little makes it to the first exit, even the fastest.
WORLD = {"length_m": 8000.0, "exit_x_m": [2000.0, 4000.0, 6000.0], "ramp_x_m": [2400.0, 4400.0]}
WORLD |= {"num_lanes": 2, "service_lane": 1, "num_meds": 1, "num_evs": 110, "num_gas": 110}
WORLD |= {"mainline_per_h": 1500.0, "ramp_per_h": 300.0, "ev_share": 0.5, "exit_share": 0.1}
WORLD |= {"arrival_soc_low": 0.17, "arrival_soc_high": 0.9, "battery_scale": 10.0}
WORLD |= {"size": 0, "rounds_per_decision": 10}


@pytest.fixture(scope="module")
def flow():
    """EVs on the road, those below 10 %, charging stops, depletions, and vehicles that have left at an exit or at the
    end so far: `(roads, minutes + 1)` each.
    """
    env, params = medjax.make("paper", **WORLD)

    def look(state):
        there = state.vehicles.active[env.config.ev_slots] & ~state.evs.is_depleted
        low = there & (state.evs.energy_j < 0.1 * params.ev_capacity_j)
        stats = state.stats
        left = stats.left.sum()
        return there.sum(), low.sum(), stats.charging_stops, stats.depleted, left

    @jax.jit
    @jax.vmap
    def play(key):
        start = env.reset(key, params)[1]

        def decide(state, key):
            state = env.step_env(key, state, 0, params)[1]
            return state, look(state)

        _, seen = jax.lax.scan(decide, start, jax.random.split(key, 6 * MINUTES))
        return look(start), seen

    start, seen = jax.device_get(play(jax.random.split(jax.random.key(0), ROADS)))
    return [
        np.concatenate([first[:, None], later[:, 5::6]], axis=1)
        for first, later in zip(start, seen, strict=True)
    ]


@pytest.mark.thorough
def test_reset_has_as_many_evs_and_low_evs_as_the_flow(flow):
    """EVs with too little charge for the way from an exit to the next one have left there."""
    evs, low, *_ = (values.mean(axis=0) for values in flow)
    later = slice(5, None)  # when hardly anybody who was there at reset still is
    assert evs[0] == pytest.approx(evs[later].mean(), rel=0.1)
    assert low[0] == pytest.approx(low[later].mean(), abs=0.5)  # some 3 standard errors


@pytest.mark.thorough
def test_no_wave_of_stops_follows_a_reset(flow):
    """As many EVs a minute leave for a charger at first as later, and none ever runs out."""
    _, _, stops, depleted, _ = (values.mean(axis=0) for values in flow)
    a_minute = np.diff(stops)
    assert a_minute[:3].mean() == pytest.approx(a_minute[4:].mean(), rel=0.15)
    assert depleted[-1] == 0.0


@pytest.mark.thorough
def test_as_many_leave_a_minute_after_a_reset_as_later(flow):
    """By exits and at the road's end: the road is neither too full upstream nor short of vehicles bound for exits."""
    a_minute = np.diff(flow[4].mean(axis=0))
    later = a_minute[4:].mean()
    assert a_minute[:4] == pytest.approx(
        np.full(4, later), rel=0.04
    )  # nearly three standard errors


@pytest.mark.parametrize(("slope", "arrival"), [(0.0, 1.0), (-0.06, 0.3)])
def test_an_ev_has_paid_for_the_way_from_where_it_entered(slope, arrival):
    """All arrive with the same charge, so their energy tells where each entered: at x = 0 or at a ramp, as often as
    the flows say. Steeply downhill, they have gained on the way.
    """
    ramps, flows = np.array([100.0, 1200.0, 2100.0]), np.array([1500.0, 300.0, 600.0, 200.0])
    demand = {"mainline_per_h": flows[0], "ramp_per_h": flows[1:], "ev_share": 1.0}
    demand |= {"arrival_soc_low": arrival, "arrival_soc_high": arrival}
    env, params = medjax.make("paper", ramp_x_m=ramps, slope=slope, **demand)
    reset = jax.jit(jax.vmap(lambda key: env.reset(key, params)[1]))
    state = jax.device_get(reset(jax.random.split(jax.random.key(0), 1000)))
    there = state.vehicles.active[:, env.config.ev_slots]
    x = state.vehicles.x[:, env.config.ev_slots][there]
    body, speed = params.ev, float(params.drivers.desired_speed[2])
    force = float(body.mass_kg * 9.81 * (body.rolling_resistance + np.sin(slope)))
    force += 0.5 * 1.2 * float(body.drag_coefficient * body.frontal_area_m2) * speed**2
    drivetrain, brakes = float(body.drivetrain_efficiency), float(body.regeneration_efficiency)
    j_per_m = force / drivetrain if force > 0.0 else force * brakes
    j_per_m += float(body.auxiliary_w) / speed
    spent = arrival * float(params.ev_capacity_j) - state.evs.energy_j[there].astype(np.float64)
    entry = x - spent / j_per_m
    places = np.array([0.0, *ramps])
    nearest = np.argmin(np.abs(entry[:, None] - places), axis=1)
    np.testing.assert_allclose(entry, places[nearest], atol=0.05)
    for place, (start, end) in enumerate(zip(places, [*ramps, 4000.0], strict=True)):
        between = (x > start) & (x < end)
        shares = np.bincount(nearest[between], minlength=4) / between.sum()
        expected = flows * (places <= start) / flows[: place + 1].sum()
        np.testing.assert_allclose(shares, expected, atol=0.03)  # of 700 and more EVs


def test_a_state_that_was_made_outside_jit_can_be_donated():
    """Every number has a buffer of its own: XLA refuses to take one buffer twice."""
    env, params = medjax.make("corridor")
    _, state = env.reset(jax.random.key(0), params)
    where = [leaf.unsafe_buffer_pointer() for leaf in jax.tree.leaves(state)]
    assert len({*where}) == len(where) > 50
    later = jax.jit(lambda state: state.replace(time=state.time + 1), donate_argnums=0)(state)
    assert int(later.time) == 1


def test_full_evs_stay_full_downhill():
    """What driving gains beyond a full battery is lost."""
    full = {"arrival_soc_low": 1.0, "arrival_soc_high": 1.0}
    env, params = medjax.make("paper", slope=-0.06, **full)
    _, state = jax.jit(env.reset)(jax.random.key(0), params)
    there = state.vehicles.active[env.config.ev_slots]
    assert there.sum() > 5
    assert (state.evs.energy_j[there] == params.ev_capacity_j).all()

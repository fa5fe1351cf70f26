"""An EV that runs out coasts, leaves by the right shoulder or blocks its lane, and counts once."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.charging.booking import book
from medjax.charging.stranded import SETTLED_M, coasting
from medjax.env.tick import physics_tick
from medjax.traffic.step import drivers_of
from medjax.world.params import LEFT
from medjax.world.state import NOT_BOOKED, EpisodeStats
from tests.charging.scene import put, scene

pytestmark = pytest.mark.usefixtures("quick_compiles")


@functools.cache
def quiet(**overrides):
    """A road that nobody else enters."""
    return medjax.make("paper", mainline_per_h=0.0, ramp_per_h=0.0, **overrides)


@functools.cache
def compiled(config):
    """A decision on roads of these sizes."""
    return jax.jit(medjax.ChargingEnv(config).step_env)


@functools.partial(jax.jit, static_argnums=(0, 3))
def played(config, params, state, ticks):
    """States `(ticks, ...)` after each tick, and the sum of the tallies."""

    def tick(carry, index):
        state, stats = carry
        drivers = drivers_of(state, config, params)
        state, more = physics_tick(state, drivers, index, config, params)
        return (state, stats + more), state

    start = state, EpisodeStats.zeros()
    (_, stats), states = jax.lax.scan(tick, start, jnp.arange(ticks, dtype=jnp.int32))
    return states, stats


def play(env, params, state, ticks=400):
    """`played`, on the host; most tests share one number of ticks and so one program."""
    return jax.device_get(played(env.config, params, state, ticks))


def alone(env, params, lane, speed, energy_j=1.0, x=500.0):
    """EV 0 alone on the road, with hardly any energy and no booking; noise would push it on."""
    state, ev = scene(env, params, charging_slot=LEFT, ev_x=x, ev_lane=lane), env.config.num_meds
    return put(
        state,
        evs={"energy_j": (0, energy_j), "med": (0, NOT_BOOKED), "charging_slot": (0, NOT_BOOKED)},
        vehicles={"active": (0, False), "speed": (ev, speed), "acceleration_noise": (ev, 0.5)},
    )


def test_coasting_is_the_decay_of_rolling_and_drag():
    """60 s agree within 0.05 m/s with the closed form (a tangent) of m dv/dt = -(c0 + c2 v^2)."""
    _, params = quiet()
    body = params.ev
    c0 = float(body.mass_kg * 9.81 * body.rolling_resistance)
    c2 = float(0.6 * body.drag_coefficient * body.frontal_area_m2)
    inertia = float(body.mass_kg * body.rotational_inertia_factor)
    root = np.sqrt(c2 / c0)
    exact = np.tan(np.arctan(30.0 * root) - 60.0 * np.sqrt(c0 * c2) / inertia) / root

    def step(v, _):
        return v + 0.25 * coasting(v, params), None

    assert float(jax.lax.scan(step, jnp.float32(30.0), length=240)[0]) == pytest.approx(
        exact, abs=0.05
    )
    assert float(coasting(jnp.float32(0.0), params)) == pytest.approx(-c0 / inertia, rel=1e-4)


@pytest.mark.parametrize("lane", [0, 3])
def test_makes_for_the_shoulder_and_is_counted_once(lane):
    """From any lane it is off the road within seconds, never faster than before, without regaining energy."""
    env, params = quiet()
    states, stats = play(env, params, alone(env, params, lane, 28.0))
    ev, vehicles, evs = env.config.num_meds, states.vehicles, states.evs
    on_road = vehicles.active[:, ev]
    assert on_road[0]
    assert evs.is_depleted[on_road, 0].all()
    gone = int(np.argmin(on_road))
    assert not on_road[gone:].any()
    assert gone * env.config.tick_s <= 1.0 + 6.0 * (3 - lane)
    assert vehicles.lane[gone, ev] == env.config.num_lanes - 1
    assert abs(vehicles.lateral_offset[gone, ev]) < SETTLED_M
    assert np.all(np.diff(vehicles.speed[:gone, ev]) < 0.0)
    assert np.all(evs.energy_j[:, 0] == 0.0)
    assert float(stats.depleted) == 1.0
    assert float(stats.left.sum()) == 0.0
    assert float(stats.ev_seconds) == pytest.approx((gone + 1) * env.config.tick_s)
    assert float(stats.soc_seconds) == 0.0


def test_blocks_its_lane_until_it_is_towed():
    """It keeps its lane, coasts as far as rolling resistance alone lets it from a walk, stands, and is towed."""
    env, params = quiet(depleted_blocks=1, tow_s=20.0)
    states, stats = play(env, params, alone(env, params, 1, 2.0))
    ev, dt = env.config.num_meds, env.config.tick_s
    x, speed, on_road = (getattr(states.vehicles, name)[:, ev] for name in ("x", "speed", "active"))
    assert np.all(states.vehicles.lane[on_road, ev] == 1)
    rolling = float(9.81 * params.ev.rolling_resistance / params.ev.rotational_inertia_factor)
    assert x[-1] - x[0] == pytest.approx(speed[0] ** 2 / (2.0 * rolling), rel=0.02)
    stood = on_road & (speed < 0.1)
    assert stood.sum() * dt == pytest.approx(20.0, abs=2 * dt)
    assert not on_road[-1]
    assert float(stats.depleted) == 1.0


def test_is_not_towed_while_it_moves():
    env, params = quiet(depleted_blocks=1, tow_s=0.0)
    states, _ = play(env, params, alone(env, params, 1, 2.0))
    ev = env.config.num_meds
    on_road = states.vehicles.active[:, ev]
    assert not on_road[-1]
    assert states.vehicles.speed[on_road, ev][-1] < 0.13  # a tick later it stands, and is gone


@pytest.mark.parametrize("speed", [0.0, 0.5, 1.0, 2.0, 2.5, 3.0, 4.0, 6.0])
def test_no_ev_stops_between_two_lanes(speed):
    """An EV that is too slow to change lanes stays in the middle of its own until it is towed."""
    env, params = quiet(tow_s=30.0)
    states, _ = play(env, params, alone(env, params, 0, speed))
    ev, vehicles = env.config.num_meds, states.vehicles
    stands = vehicles.active[:, ev] & (vehicles.speed[:, ev] < 0.1)
    assert (np.abs(vehicles.lateral_offset[stands, ev]) < SETTLED_M).all()
    assert stands.any() or speed > 2.0  # the faster ones reach the shoulder
    assert not stands.any() or speed < 4.0
    assert not vehicles.active[-1, ev]


@pytest.mark.thorough
@pytest.mark.parametrize(("blocks", "last_lane"), [(0, 3), (1, 0)])
def test_a_depleted_ev_takes_no_exit(blocks, last_lane):
    """Near its exit, it makes for the shoulder at once, or stands in its lane until it is towed."""
    env, params = quiet(exit_x_m=(2000.0,), exit_share=0.0, depleted_blocks=blocks, tow_s=20.0)
    ev, step = env.config.num_meds, compiled(env.config)
    state = alone(env, params, 0, 10.0, x=1250.0)
    state = put(state, vehicles={"destination": (ev, 2000.0)})
    for number in range(150):
        before, (_, state, *_) = state, step(jax.random.key(number), state, 0, params)
        if not state.vehicles.active[ev]:
            break
    assert int(before.vehicles.lane[ev]) == last_lane
    assert not state.vehicles.active[ev]
    assert number < (25 if blocks == 0 else 140)
    assert (float(state.stats.depleted), float(state.stats.left.sum())) == (1.0, 0.0)


@pytest.mark.thorough
def test_a_booked_ev_that_runs_out_gives_its_slot_back():
    """From that tick on it is neither booked nor charged, and does not ask again."""
    env, params = quiet(depleted_blocks=1)
    state = scene(env, params, charging_slot=LEFT, ev_x=440.0, ev_lane=1)
    state = put(state, evs={"energy_j": (0, 1.0)})
    states, stats = play(env, params, state, 40)
    assert states.evs.is_depleted[:, 0].all()
    assert np.all(states.evs.med[:, 0] == NOT_BOOKED)
    assert float(stats.evs_served) == 0.0
    last = jax.tree.map(lambda leaf: jnp.asarray(leaf[-1]), states)
    assert int(book(last, env.config, params).med[0]) == NOT_BOOKED
    _, after, *_ = compiled(env.config)(jax.random.key(0), last, 0, params)
    assert int(after.evs.med[0]) == NOT_BOOKED


def test_a_depleted_ev_does_not_arrive():
    """An EV that coasts past the end counts as depleted, not as one that left."""
    env, params = quiet(depleted_blocks=1)
    states, stats = play(env, params, alone(env, params, 1, 28.0, x=3900.0), 40)
    assert not states.vehicles.active[-1, env.config.num_meds]
    assert (float(stats.depleted), float(stats.left.sum()), float(stats.exit_soc)) == (1, 0, 0)

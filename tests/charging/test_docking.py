"""A booked EV reaches each of the four slots, stays in it, and charges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.charging.docking import docking_acceleration
from medjax.env.tick import physics_tick
from medjax.traffic import ballistic_step, idm_acceleration
from medjax.traffic.step import drivers_of
from medjax.world.params import FRONT, LEFT, REAR, RIGHT
from medjax.world.state import MERGING, NOT_BOOKED
from tests.charging.scene import MED_SPEED, MED_X, put, scene

pytestmark = pytest.mark.usefixtures("quick_compiles")

TICKS = 480
STARTS = [(400.0, 0), (400.0, 3), (440.0, 1), (560.0, 3)]


@pytest.fixture(scope="module")
def quiet():
    """A road that nobody else enters."""
    return medjax.make("paper", mainline_per_h=0.0, ramp_per_h=0.0, service_speed=MED_SPEED)


@pytest.fixture(scope="module")
def play(quiet):
    """Runs a scene for TICKS ticks; returns the states and tallies of all."""
    env, params = quiet

    @jax.jit
    def run(state):
        def tick(state, index):
            state, stats = physics_tick(
                state, drivers_of(state, env.config, params), index, env.config, params
            )
            return state, (state, stats)

        return jax.lax.scan(tick, state, jnp.arange(TICKS))[1]

    return run


def slot_centre_error(charging_slot, ev_x, med_x):
    """Distance of the EV's centre from the slot's, from the two lengths and the dock gap alone."""
    med_length, ev_length, gap = 12.0, 5.0, 12.0
    apart = med_length / 2 + gap + ev_length / 2
    along = {LEFT: 0.0, RIGHT: 0.0, REAR: -apart, FRONT: apart}[charging_slot]
    return (ev_x - ev_length / 2) - (med_x - med_length / 2) - along


@pytest.mark.thorough
@pytest.mark.parametrize("charging_slot", [LEFT, RIGHT, REAR, FRONT])
@pytest.mark.parametrize(("ev_x", "ev_lane"), STARTS)
def test_docks_and_charges_to_target(quiet, play, charging_slot, ev_x, ev_lane):
    """From anywhere around, an EV docks at its slot, charges to its target, and leaves.

    While both are in one lane, they keep a standing gap.
    """
    env, params = quiet
    states, stats = play(
        scene(env, params, charging_slot=charging_slot, ev_x=ev_x, ev_lane=ev_lane)
    )
    ev = env.config.num_meds
    charging = np.asarray(states.evs.is_charging[:, 0])
    assert charging.any()
    x, lane = np.asarray(states.vehicles.x), np.asarray(states.vehicles.lane)
    error = slot_centre_error(charging_slot, x[:, ev], x[:, 0])
    expected_lane = {LEFT: 1, RIGHT: 3, REAR: 2, FRONT: 2}[charging_slot]
    assert np.all(np.abs(error[charging]) <= float(params.charging.hold_tolerance_m) + 1e-3)
    assert np.all(lane[charging, ev] == expected_lane)
    released = np.asarray(states.evs.med[:, 0]) == NOT_BOOKED
    first = np.argmax(released)
    assert released[first]
    soc = np.asarray(states.evs.energy_j[:, 0]) / float(params.ev_capacity_j)
    assert soc[first] == pytest.approx(float(params.charging.target_soc), abs=0.005)
    same = lane[:, 0] == lane[:, ev]
    front, back = np.maximum(x[:, 0], x[:, ev]), np.minimum(x[:, 0], x[:, ev])
    front_length = np.where(x[:, 0] > x[:, ev], 12.0, 5.0)
    assert np.all((front - front_length - back)[same] > float(params.charging.platoon_min_gap))
    assert float(stats.collisions.sum()) == 0.0


def platoon(env, params, ahead_m=0.0):
    """MED 0 with an EV in each slot, all at the service speed; the front EV is `ahead_m` too far ahead."""
    state = scene(env, params, charging_slot=LEFT, ev_x=MED_X, ev_lane=1)
    first, four = env.config.num_meds, slice(4)
    members = jnp.arange(first, first + 4)
    return put(
        state,
        vehicles={
            "active": (members, True),
            "x": (members, MED_X + jnp.array([-3.5, -3.5, -24.0, 17.0 + ahead_m])),
            "lane": (members, int(params.fleet.service_lane) + jnp.array([-1, 1, 0, 0])),
            "speed": (members, params.fleet.service_speed),
            "desired_speed": (members, 30.0),
        },
        evs={
            "med": (four, 0),
            "charging_slot": (four, jnp.arange(4)),
            "energy_j": (four, 0.2 * params.ev_capacity_j),
            "is_charging": (four, ahead_m == 0.0),
        },
    )


@pytest.mark.parametrize("ahead_m", [0.0, 40.0])
def test_a_full_platoon_drives_at_the_service_speed(quiet, play, ahead_m):
    """Docked or still falling back in the MED's lane, EVs do not slow their MED by a tenth of a metre a second."""
    env, params = quiet
    states, _ = play(platoon(env, params, ahead_m))
    speed = np.asarray(states.vehicles.speed)[:120]
    assert np.all(np.abs(speed[:, 0] - float(params.fleet.service_speed)) < 0.1)
    assert np.asarray(states.evs.is_charging)[119, :4].all()


def test_no_ev_waits_for_a_med_that_stands(quiet, play):
    """EVs drive past a MED that cannot move; those behind it leave its lane."""
    env, params = quiet
    first = env.config.num_meds
    state = put(
        platoon(env, params, 10.0),
        vehicles={"desired_speed": (0, 0.1), "speed": (0, 0.0)},
        evs={
            "charging_slot": (jnp.array([3, 0]), jnp.array([LEFT, FRONT]))
        },  # EV 3 is in its MED's way
        meds={"status": (0, MERGING)},
    )
    states, _ = play(state)
    slowest = float(params.charging.slowest_share) * float(params.fleet.service_speed)
    others = np.asarray(states.vehicles.speed)[:, [first, first + 1, first + 3]]
    assert others[:80].min() > slowest - 3.0  # one EV lets another in
    assert np.all(others[40:] > slowest - 0.1)
    # By then the MED has driven around EV 3 and come back.
    assert states.vehicles.lane[60, first + 3] != states.vehicles.lane[60, 0]


def closest(dt, leader_brakes_fully):
    """Smallest bumper gap to an EV that falls back to its slot, over followers drawn from all allowed drivers."""
    rng = np.random.default_rng(1)

    def draw(low, high):
        return jnp.asarray(rng.uniform(low, high, 20_000), jnp.float32)

    own = {
        "desired_speed": draw(8.0, 45.0),
        "time_headway": jnp.maximum(draw(0.25, 3.0), dt),
        "min_gap": draw(1.0, 5.0),
        "max_acceleration": draw(0.5, 3.0),
        "comfortable_deceleration": draw(1.0, 4.0),
    }
    tyres = draw(6.0, 10.0)
    leader_braking = tyres if leader_brakes_fully else draw(1.0, 4.0)
    _, params = medjax.make("paper", speed_rate=20.0, approach_speed=50.0)
    start = own["desired_speed"] * draw(0.3, 0.99)

    def tick(state, _):
        (x, v), (gap, follower_v) = state
        a = docking_acceleration(v, jnp.zeros_like(v), leader_braking, params.charging)
        ahead, v = ballistic_step(x, v, a, dt)
        a = jnp.maximum(idm_acceleration(follower_v, gap, state[0][1], **own), -tyres)
        way, follower_v = ballistic_step(jnp.zeros_like(gap), follower_v, a, dt)
        gap = gap + (ahead - x) - way
        return ((ahead, v), (gap, follower_v)), gap

    equilibrium = own["min_gap"] + start * own["time_headway"]
    states = (jnp.zeros_like(start), start), (equilibrium, start)
    return jax.lax.scan(tick, states, length=int(60.0 / dt))[1].min()


@pytest.mark.parametrize("dt", [0.05, 0.25, 0.5])
def test_followers_of_an_ev_that_falls_back_keep_a_gap(dt):
    """If it brakes comfortably, but not if it brakes as hard as they can."""
    assert closest(dt, leader_brakes_fully=False) > 0.0
    assert closest(dt, leader_brakes_fully=True) < 0.0


@pytest.mark.thorough
def test_human_transfers_less_than_autonomous(quiet):
    """The same car loses more through misalignment when a human holds it in its slot."""
    env, params = quiet
    seeds = 32

    def efficiency(human):
        state = scene(env, params, charging_slot=LEFT, ev_x=496.5, ev_lane=1, human=human)

        def episode(key):
            def step(state, key):
                _, state, *_, info = env.step_env(key, state, 0, params)
                stats = info["step_stats"]
                return state, (stats.energy_sent_j, stats.energy_received_j)

            return jax.lax.scan(step, state, jax.random.split(key, 40))[1]

        sent, received = jax.vmap(episode)(jax.random.split(jax.random.key(3), seeds))
        return received.sum(1), received.sum(1) / sent.sum(1)

    run = jax.jit(efficiency)
    energy_human, link_human = map(np.asarray, run(True))
    energy_machine, link_machine = map(np.asarray, run(False))
    assert np.mean(energy_human) < np.mean(energy_machine)
    standard_error = np.hypot(link_human.std(), link_machine.std()) / np.sqrt(seeds)
    assert np.mean(link_machine) - np.mean(link_human) > 3.0 * standard_error

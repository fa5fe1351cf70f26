"""A gas vehicle breaks down, stands in its lane for its time, and drives on; all else stays as it is."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.verification.cases import Case
from benchmarks.verification.decisions import Decision, check_decision
from benchmarks.verification.invariants import INVARIANTS
from medjax.errors import InputError
from medjax.traffic.arrivals import new_seed
from medjax.traffic.incidents import break_down, comfortable_stop, plan_incidents
from medjax.world.params import EnvConfig
from tests.charging.scene import put

pytestmark = pytest.mark.usefixtures("quick_compiles")

PLACE_M = 2000.0
GIVEN = {"incident_from_s": 20.0, "incident_until_s": 20.0, "incident_s": 30.0}
GIVEN |= {"incident_from_x_m": PLACE_M, "incident_until_x_m": PLACE_M}
ROAD = {"num_gas": 120, "num_evs": 20, "num_meds": 2, "num_ramps": 1, "rounds_per_decision": 10}


@functools.cache
def road(number=2, **overrides):
    """An environment with this number of incidents, which reports its state after every tick, and its numbers."""
    given = GIVEN if number else {}
    env, params = medjax.make("paper", **ROAD | given | overrides, num_incidents=number)
    return env.with_probe(lambda state: state), params


@functools.partial(jax.jit, static_argnums=(0, 3))
def _played(env, params, key, decisions):
    def decide(state, key):
        _, state, *_, info = env.step_env(key, state, 0, params)
        return state, info["ticks"]

    _, state = env.reset(key, params)
    state, ticks = jax.lax.scan(decide, state, jax.random.split(key, decisions))
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), ticks)


def played(env, params, seed=0, decisions=12):
    """States after each tick, on the host."""
    return jax.device_get(_played(env, params, jax.random.key(seed), decisions))


def test_drawn_between_their_bounds_and_equal_bounds_give_them():
    """Over 500 episodes, and each incident has its draws, however many there are."""
    _, params = road(3, incident_from_s=(10.0, 0.0, 50.0), incident_until_s=(10.0, 200.0, 100.0))
    _, fewer = road(2, incident_from_s=(10.0, 0.0), incident_until_s=(10.0, 200.0))
    seeds = jax.vmap(new_seed)(jax.random.split(jax.random.key(0), 500))
    drawn, less = (jax.vmap(plan_incidents, (0, None))(seeds, each) for each in (params, fewer))
    assert (drawn.x == PLACE_M).all()
    assert (drawn.time_s[:, 0] == 10.0).all()
    np.testing.assert_array_equal(drawn.time_s[:, :2], less.time_s)
    for time_s, low, high in ((drawn.time_s[:, 1], 0, 200), (drawn.time_s[:, 2], 50, 100)):
        assert ((time_s >= low) & (time_s < high)).all()
        counts = np.histogram(time_s, 10, (low, high))[0]
        assert (
            (counts - 50.0) ** 2 / 50.0
        ).sum() < 27.9  # chi-squared, 9 degrees of freedom, 0.1 %
    assert abs(np.corrcoef(drawn.time_s[:, 1], drawn.time_s[:, 2])[0, 1]) < 0.15


def test_the_nearest_stands_for_its_time_and_drives_on():
    """One in lane 1 and one in any lane: each brakes comfortably, stands, keeps its lane, and leaves later."""
    env, params = road(incident_lane=(1, -1))
    config, dt = env.config, env.config.tick_s
    states = played(env, params)
    clocks, slots = states.stands_for_s, np.flatnonzero(states.stands_for_s.max(0) > 0.0)
    assert slots.size == 2
    x, speed, lane = (
        getattr(states.vehicles, name)[:, config.gas_slots][:, slots]
        for name in ("x", "speed", "lane")
    )
    assert 1 in lane[80]
    for index, slot in enumerate(slots):
        broken = np.flatnonzero(clocks[:, slot] > 0.0)
        first, last = broken[0], broken[-1] + 1
        assert first == 20.0 / dt  # the first tick of its round
        stands = speed[:, index] == 0.0
        assert stands.sum() * dt == pytest.approx(30.0, abs=2 * dt)
        assert not stands[:first].any()
        assert stands[last - 100 : last].all()
        assert (np.diff(speed[first - 1 : last, index]) >= -2.01 * dt).all()
        assert len({*lane[first - 1 : last, index]}) == 1
        assert x[last, index] <= PLACE_M + 0.1
        assert states.vehicles.x[-1, config.gas_slots][slot] > PLACE_M + 100.0
    assert states.stats.collisions[-1] == 0.0


def test_arrivals_are_those_of_an_episode_without_incidents():
    """Everyone who has asked to enter at each entry by each tick, and the traffic until the first incident."""
    with_incidents, without = (played(*road(number)) for number in (2, 0))
    assert without.stands_for_s is None
    asked = [each.queue + each.entered_here for each in (with_incidents, without)]
    np.testing.assert_array_equal(*asked)
    np.testing.assert_array_equal(*(each.vehicles.x[:80] for each in (with_incidents, without)))
    assert not np.array_equal(with_incidents.vehicles.x, without.vehicles.x)


def test_without_a_gas_vehicle_nothing_happens():
    env, params = road(ev_share=1.0, num_evs=120, num_gas=20)
    states = played(env, params, decisions=4)
    assert states.vehicles.active[:, env.config.ev_slots].any()
    assert not states.vehicles.active[:, env.config.gas_slots].any()
    assert not states.stands_for_s.any()


EXITS = {"exit_x_m": (2600.0,), "exit_share": 0.0}


@functools.cache
def scene():
    """Five gas vehicles at 30 m/s on a road with an exit; each could stop before the place, 225 m ahead."""
    env, params = road(1, incident_from_s=0.0, incident_until_s=0.0, **EXITS)
    _, state = jax.jit(env.reset)(jax.random.key(0), params)
    gas = env.config.gas_slots.start + jnp.arange(5)
    state = put(state, vehicles={"active": (slice(None), False)})
    columns = {
        "active": True,
        "x": PLACE_M - jnp.array([600.0, 500.0, 400.0, 300.0, 200.0]),
        "speed": 30.0,
        "lane": jnp.array([0, 1, 1, 2, 2]),
        "lateral_offset": 0.0,
        "destination": params.road.length_m,
    }
    vehicles = {name: (gas, value) for name, value in columns.items()}
    return env.config, params, put(state, vehicles=vehicles)


def chosen(slot=None, params=None, round_number=0, **columns):
    """The gas vehicle that breaks down in the scene, None for nobody; columns change the one in this slot."""
    config, usual, state = scene()
    if slot is not None:
        changes = {name: (config.gas_slots.start + slot, value) for name, value in columns.items()}
        state = put(state, vehicles=changes)
    clocks = break_down(state, state.stands_for_s, round_number, config, params or usual)
    found = np.flatnonzero(clocks)
    assert found.size <= 1
    assert (clocks[found] == 30.0).all()
    return int(found[0]) if found.size else None


def test_who_breaks_down():
    """The one that can stop nearest before the place, not one on a ramp, between lanes, or about to leave."""
    config, params, state = scene()
    assert float(comfortable_stop(state.vehicles, params)[config.gas_slots][0]) == 225.0
    assert chosen() == 3
    assert chosen(4, speed=23.0) == 4
    assert chosen(3, active=False) == 2
    assert chosen(3, lane=config.num_lanes) == 2
    assert chosen(3, lateral_offset=1.5) == 2
    # It would stop at 1925 m; with a lane to cross it prepares for its exit from 2350 m less twice 295 m on.
    assert chosen(3, destination=2600.0) == 2
    in_lane = [params.replace(incidents=params.incidents.replace(incident_lane=jnp.array([lane])))
               for lane in range(4)]  # fmt: skip
    assert [chosen(params=each) for each in in_lane] == [0, 2, 3, None]
    assert chosen(round_number=1) is None


def test_incidents_of_one_place_and_second_stop_different_vehicles():
    """And a vehicle that stands already is not chosen again."""
    config, params, state = scene()
    clocks = state.stands_for_s
    for count in (1, 2, 3, 4, 4):
        clocks = break_down(state, clocks, 0, config, params)
        assert np.count_nonzero(clocks) == count
    assert clocks[4] == 0.0
    states = played(*road(4), decisions=4)
    assert (states.stands_for_s > 0.0).any(0).sum() == 4


@functools.cache
def blocked():
    """Vehicles past the place, mean speeds and so on by decision: without an incident, and with one in each lane."""
    size = {"num_lanes": 3, "num_ramps": 0, "num_meds": 1, "num_evs": 1, "num_gas": 500}
    size |= {"ev_share": 0.0, "mainline_per_h": 5000.0, "desired_speed_std": 0.0}
    times = {"incident_from_s": 200.0, "incident_until_s": 200.0}
    place = {"incident_from_x_m": 3000.0, "incident_until_x_m": 3000.0}
    env, params = medjax.make(
        "paper", num_incidents=1, rounds_per_decision=10, **size, **times, **place
    )

    def play(incident_s, lane):
        given = params.incidents.replace(incident_s=incident_s[None], incident_lane=lane[None])
        numbers = params.replace(incidents=given)

        def decide(state, key):
            _, state, *_ = env.step_env(key, state, 0, numbers)
            vehicles, stats = state.vehicles, state.stats
            past = jnp.sum(vehicles.active & (vehicles.x > 3050.0)) + stats.left.sum()
            there = jnp.maximum(jnp.sum(vehicles.active), 1)
            speed = jnp.sum(jnp.where(vehicles.active, vehicles.speed, 0.0)) / there
            lost = stats.entered.sum() - stats.left.sum() - jnp.sum(vehicles.active)
            return state, (past, speed, lost, stats.collisions)

        _, state = env.reset(jax.random.key(0), numbers)
        return jax.lax.scan(decide, state, jax.random.split(jax.random.key(1), 150))[1]

    seconds, lanes = jnp.array([0.0, 400.0, 400.0, 400.0]), jnp.array([-1, 0, 1, 2])
    return params, jax.device_get(jax.jit(jax.vmap(play))(seconds, lanes))


@pytest.mark.thorough
def test_a_blocked_lane_is_a_bottleneck():
    """Flow past it is at most the other lanes' capacity, 1 / (T + (s0 + l) / v) each; then the queue dissolves."""
    params, (past, speed, lost, collisions) = blocked()
    drivers = params.drivers
    spacing = drivers.min_gap[3] + drivers.vehicle_length[3]
    capacity = float(3600.0 / (drivers.time_headway[3] + spacing / drivers.desired_speed[3]))
    assert capacity == pytest.approx(2204.0, abs=1.0)

    def flow(start, end):
        return (past[:, end // 10] - past[:, start // 10]) * 3600.0 / (end - start)

    free, *during = flow(240, 600)
    assert free > 2.0 * capacity
    assert all(0.7 * 2.0 * capacity < each < 2.0 * capacity for each in during), during
    after = flow(640, 840)[1:]
    assert (after > 1.05 * free).all()  # more than the demand comes out of the queue
    assert (after < 3.0 * capacity).all()
    assert (speed[1:, 59] < 20.0).all()
    assert (speed[:, -1] > 29.0).all()
    assert not lost.any()
    assert not collisions.any()


@pytest.mark.thorough
def test_nothing_is_violated_in_dense_traffic():
    """Four incidents of the preset, drawn in half of each 300 s, at twice its demand."""
    lows = {"incident_from_s": 0.0, "incident_from_x_m": 300.0}
    highs = {"incident_until_s": 150.0, "incident_until_x_m": 3900.0, "incident_s": 100.0}
    size = {"num_gas": 300, "num_evs": 60, "rounds_per_decision": 10, "depleted_blocks": 1}
    env, params = medjax.make(
        "paper", num_incidents=4, mainline_per_h=6000.0, **size, **lows, **highs
    )
    env = env.with_probe(lambda state: state)

    def decide(before, key):
        action = jax.random.randint(key, (), 0, env.num_actions)
        obs, state, reward, _, _, info = env.step_env(key, before, action, params)
        found = check_decision(Decision(before, state, obs, reward, info), env.config, params)
        return state, (found, info["ticks"].stands_for_s > 0.0)

    def play(key):
        _, state = env.reset(key, params)
        return jax.lax.scan(decide, state, jax.random.split(key, 30))[1]

    found, stands = jax.jit(jax.vmap(play))(jax.random.split(jax.random.key(3), 8))
    totals = dict(zip(INVARIANTS, np.asarray(found).sum(axis=(0, 1)), strict=True))
    assert totals == dict.fromkeys(INVARIANTS, 0)
    assert stands.any((1, 2)).sum() == 8 * 4


@pytest.mark.thorough
def test_nothing_is_violated_in_random_worlds():
    """Any numbers, two lanes, three incidents each."""
    config = EnvConfig(
        num_lanes=2, num_ramps=1, num_exits=1, num_meds=2, num_evs=12, num_gas=40, num_incidents=3
    )
    case = Case(0, 0, num_envs=64, config=config)
    for episode in range(3):
        found = case.play(episode).violations.sum(0)
        assert dict(zip(INVARIANTS, found.tolist(), strict=True)) == dict.fromkeys(INVARIANTS, 0)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"incident_from_s": 21.0}, "incident_from_s = 21: allowed at most incident_until_s = 20"),
        ({"incident_from_x_m": 2001.0}, "allowed at most incident_until_x_m = 2000"),
        ({"incident_until_x_m": [3000.0, 4001.0]}, "= 4001: allowed at most length_m = 4000"),
        ({"incident_lane": [0, 4]}, "incident_lane = 4: allowed at most num_lanes - 1 = 3"),
        ({"incident_s": -1.0}, "incident_s = -1.0: allowed a number from 0 to 1e"),
        ({"incident_s": [1.0, 2.0, 3.0]}, r"incident_s has shape \(3,\): allowed \(2,\)"),
        ({"num_incidents": 9}, "num_incidents = 9: allowed a whole number from 0 to 8"),
        ({"num_gas": 0}, "num_incidents = 2: allowed 0 with num_gas = 0"),
    ],
)
def test_bad_input(overrides, message):
    with pytest.raises(InputError, match=message):
        medjax.make("paper", **{"num_incidents": 2, **GIVEN, **overrides})

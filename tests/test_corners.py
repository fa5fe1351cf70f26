"""Faults that random worlds found at the limits of what is allowed (`python -m benchmarks.soak`)."""

import contextlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.verification.draws import random_units
from benchmarks.verification.random_worlds import draw_params
from medjax.world.kinds import by_class
from medjax.world.params import EnvConfig
from medjax.wrappers import in_blocks

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.mark.parametrize(
    ("apart", "longest", "valid"), [(262.5, 12.0, True), (261.5, 12.0, False), (262.5, 18.0, False)]
)
def test_a_ramp_begins_beyond_a_vehicle_that_stands_at_the_end_of_the_one_before(
    apart, longest, valid
):
    """Lanes of 250 m: a newcomer reaches back by its length, at most that of the longest."""
    lengths = [longest, 5.0, 5.0, 5.0, 5.0]
    refused = pytest.raises(
        ValueError, match=f"ramp_x_m = .*longest vehicle_length = {250 + longest:g} m apart"
    )
    with contextlib.nullcontext() if valid else refused:
        medjax.make("paper", ramp_x_m=[100.0, 100.0 + apart], vehicle_length=lengths)


@pytest.mark.parametrize("name", ["ev.drivetrain_efficiency", "med.drivetrain_efficiency"])
def test_energy_is_not_divided_by_an_efficiency_of_zero(name):
    allowed = r"drivetrain_efficiency = 0\.0: allowed a number from 0\.01 to 1"
    with pytest.raises(ValueError, match=allowed):
        medjax.make("paper", **{name: 0.0})


def test_rows_may_be_empty():
    """Roads without ramps, each with numbers of its own, are (B, 0) arrays."""
    rows = jnp.zeros((256, 0)), jnp.arange(256)
    empty, doubled = in_blocks(lambda rows: (rows[0], 2 * rows[1]), rows)
    assert empty.shape == (256, 0)
    np.testing.assert_array_equal(doubled, 2 * np.arange(256))


def test_the_shortest_roads_start_without_overlap():
    """100 m hold one vehicle and its room a lane."""
    env, params = medjax.make(
        "paper", num_meds=1, num_evs=2, num_gas=20, num_lanes=6, num_ramps=0, length_m=100.0,
        vehicle_length=30.0, min_gap=5.0, mainline_per_h=18000.0, ev_share=0.0,
    )  # fmt: skip
    keys = jax.random.split(jax.random.key(0), 4000)
    _, state = jax.jit(jax.vmap(env.reset, (0, None)))(keys, params)
    vehicles = jax.device_get(state.vehicles)
    assert vehicles.active.any()
    for x, lane, active in zip(vehicles.x, vehicles.lane, vehicles.active, strict=True):
        ahead = x[:, None] - x
        pairs = (lane[:, None] == lane) & active[:, None] & active & ~np.eye(len(x), dtype=bool)
        assert not (pairs & (np.abs(ahead) < 30.0)).any()


@pytest.mark.parametrize("headway", [0.1, 0.6])
def test_nobody_starts_faster_than_tyres_can_brake(headway):
    """To the speed of the vehicle ahead within the gap to it, however short the headway and different the drivers."""
    config = EnvConfig(num_lanes=1, num_ramps=0, num_meds=1, num_evs=12, num_gas=12, tick_s=0.5)
    env, paper = medjax.make("paper", num_meds=1, num_evs=12, num_gas=12, num_lanes=1, num_ramps=0)
    worlds = draw_params(random_units(np.random.default_rng(0), 256), config, None)
    equal = {"time_headway": headway, "min_gap": 1.0, "vehicle_length": 5.0}
    shape = worlds.drivers.time_headway.shape
    columns = {name: np.full(shape, value, np.float32) for name, value in equal.items()}
    worlds = worlds.replace(drivers=worlds.drivers.replace(**columns))

    def start(key, params):
        link = params.link.replace(inductance=paper.link.inductance)
        return env.reset(key, params.replace(link=link))[1].vehicles

    keys = jax.random.split(jax.random.key(0), 256)
    vehicles = jax.device_get(jax.jit(jax.vmap(start))(keys, worlds))
    closing = 0
    for row in range(256):
        active = vehicles.active[row]
        x, speed = vehicles.x[row][active], vehicles.speed[row][active]
        order = np.argsort(x)
        gap = np.diff(x[order]) - 5.0
        faster = speed[order][:-1] ** 2 - speed[order][1:] ** 2
        closing += (faster > 0.0).sum()
        assert (faster <= 2.0 * worlds.motion.max_braking[row] * gap).all()
    assert closing > 100


@pytest.mark.thorough
@pytest.mark.parametrize("observation", ["flat", "profile"])
def test_a_road_may_be_for_evs_only(observation):
    """Without slots for gas vehicles these wait outside, EVs come and go, and every number is finite."""
    env, params = medjax.make("paper", num_gas=0, num_evs=8, num_meds=2, observation=observation)
    _, state = jax.jit(env.reset)(jax.random.key(0), params)
    step = jax.jit(env.step_env)
    for decision in range(40):
        key = jax.random.fold_in(jax.random.key(1), decision)
        obs, state, reward, _, _, info = step(key, state, decision % 5, params)
        numbers = jax.tree.leaves((obs, reward, info["metrics"], info["reward_terms"]))
        assert all(np.isfinite(leaf).all() for leaf in numbers)
    meds, evs, gas = np.asarray(by_class(state.stats.entered))
    assert min(meds, evs) > 0 == gas
    assert int(state.queue.sum()) > 0

"""Derivatives with respect to the numbers of the world: finite, equal in reverse and forward mode, and true."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.verification.golden import BUSY, QUIET, TRIPS
from medjax.env.tick import physics_tick
from medjax.traffic.step import drivers_of
from medjax.world.state import IN_SERVICE
from tests.float64_ticks import platoon, played

pytestmark = pytest.mark.usefixtures("quick_compiles")

DECISIONS = 2
WORLDS = {
    "charging": ("paper", {**QUIET, **BUSY, "eco_compliance": 0.5, "ev.auxiliary_w": 0.0}, 75),
    "exits and all": ("corridor", TRIPS | {"num_plugs": 1}, 40),
}


def floats(params):
    """The numbers that have derivatives, by name, and a function that replaces them."""
    leaves, tree = jax.tree_util.tree_flatten_with_path(params)
    names = [jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in leaves]
    arrays = dict(zip(names, (jnp.asarray(leaf) for _, leaf in leaves), strict=True))
    smooth = {n: x for n, x in arrays.items() if jnp.issubdtype(x.dtype, jnp.floating)}
    return smooth, lambda changed: jax.tree.unflatten(tree, (arrays | changed).values())


@pytest.mark.parametrize(
    "world",
    [
        pytest.param("charging", marks=pytest.mark.thorough),
        pytest.param("exits and all", marks=pytest.mark.slow),  # for its compiling
    ],
)
def test_reverse_mode_is_finite_and_as_forward_mode(world):
    """Two decisions on a road in traffic: no derivative is NaN, and both modes agree in any direction."""
    name, size, warm = WORLDS[world]
    env, params = medjax.make(name, **size)

    def warmed(key):
        keys = jax.random.split(key, warm)

        def step(number, state):
            return env.step_env(keys[number], state, 1, params)[1]

        return jax.lax.fori_loop(0, warm, step, env.reset(key, params)[1])

    state = jax.jit(warmed)(jax.random.key(0))
    assert (state.meds.status == IN_SERVICE).any()
    assert state.evs.is_charging.any()
    smooth, replaced = floats(params)
    assert len(smooth) > 100

    def outcome(changed):
        """A sum of observations, rewards, places and charges after both decisions."""
        numbers, after, parts = replaced(changed), state, []
        for key in jax.random.split(jax.random.key(1), DECISIONS):
            obs, after, reward, *_ = env.step_env(key, after, 1, numbers)
            parts += [jnp.mean(obs), reward]
        energies = jnp.mean(after.evs.energy_j) + jnp.mean(after.meds.energy_j)
        places = jnp.mean(after.vehicles.x) + jnp.mean(after.vehicles.lateral_offset)
        return sum(parts) + 1e-6 * energies + places

    value, slopes = jax.jit(jax.value_and_grad(outcome))(smooth)
    assert np.isfinite(value)
    assert not [name for name, slope in slopes.items() if not np.isfinite(slope).all()]
    assert sum(bool(np.any(slope)) for slope in slopes.values()) > 20

    forwards = jax.jit(lambda way: jax.jvp(outcome, (smooth,), (way,))[1])
    for number in range(3):
        keys = jax.random.split(jax.random.key(number), len(smooth))
        # As large as the numbers themselves, so that each has a say.
        way = {}
        for key, (name, x) in zip(keys, smooth.items(), strict=True):
            drawn = x * jax.random.normal(key, x.shape)
            way[name] = jnp.where(jnp.isfinite(drawn), drawn, 0.0)
        each = [np.vdot(np.asarray(slopes[name], np.float64), x) for name, x in way.items()]
        size = sum(map(abs, each))
        assert float(forwards(way)) == pytest.approx(sum(each), rel=2e-3, abs=1e-5 * size)


SMOOTH = ("ev.mass_kg", "med.drag_coefficient", "charging.slot_power_w", "link.load_ohm")


@pytest.mark.thorough
def test_derivatives_are_those_of_central_differences():
    """In float64, of the charge and place of a MED and the EVs in its slots, after eight ticks in which all charge."""
    env, params = medjax.make("long", num_meds=1, num_evs=4, num_gas=0, service_speed=17.987)
    state, _ = played(env, params, platoon(env, params, 1000.0), 80, np.float64)
    state = jax.tree.map(lambda leaf: leaf[-1], state)
    assert state.evs.is_charging.all()
    with jax.enable_x64(True):
        smooth, replaced = floats(in_float64(params))
        state = in_float64(state)
        numbers = {name: smooth[name] for name in SMOOTH}

        def outcome(changed):
            world = replaced(changed)
            drivers = drivers_of(state, env.config, world)

            def tick(state, number):
                return physics_tick(state, drivers, number, env.config, world)[0], None

            last, _ = jax.lax.scan(tick, state, jnp.arange(8, dtype=jnp.int32))
            return jnp.sum(last.evs.energy_j) + 2.0 * last.meds.energy_j[0] + last.vehicles.x.sum()

        slopes = jax.jit(jax.grad(outcome))(numbers)
        value = jax.jit(outcome)
        for name, number in numbers.items():
            step = 1e-4 * number
            high, low = (value(numbers | {name: number + by}) for by in (step, -step))
            difference = float(high - low) / float(2.0 * step)
            assert abs(difference * number) > 1.0, name  # J: it matters
            assert float(slopes[name]) == pytest.approx(difference, rel=1e-5), name


def in_float64(tree):
    """The same numbers in float64."""
    return jax.tree.map(
        lambda leaf: jnp.asarray(leaf, np.float64 if np.asarray(leaf).dtype.kind == "f" else None),
        jax.device_get(tree),
    )


def test_the_code_for_gpus_has_derivatives(monkeypatch):
    """It only traces: every operation of a decision has its rules for reverse and forward mode."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    env, params = medjax.make("corridor")
    smooth, replaced = floats(params)
    key = jax.random.key(0)
    state = jax.eval_shape(env.reset, key, params)[1]

    def reward(changed, state):
        return env.step_env(key, state, 1, replaced(changed))[2]

    slopes = jax.eval_shape(jax.grad(reward), smooth, state)
    assert slopes.keys() == smooth.keys()
    forwards = jax.eval_shape(
        lambda state: jax.jvp(lambda numbers: reward(numbers, state), (smooth,), (smooth,)), state
    )
    assert [each.shape for each in forwards] == [(), ()]

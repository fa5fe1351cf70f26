"""Derivatives of decisions with respect to every number of the world: finite, and equal in reverse and forward mode."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.verification.golden import BUSY, QUIET, TRIPS
from medjax.world.state import IN_SERVICE

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


SLOW = pytest.param("exits and all", marks=pytest.mark.slow)  # for its compiling


@pytest.mark.thorough
@pytest.mark.parametrize("world", ["charging", SLOW])
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

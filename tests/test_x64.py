"""With `JAX_ENABLE_X64=1`, the world is float32 all the same, to the last bit."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.agents import agents_of
from medjax.physics import tractive_energy
from tests.compiling import quickly
from train.api import PPOConfig, train

SIZE = {"num_meds": 3, "num_evs": 12, "num_gas": 20, "mainline_per_h": 900.0, "ramp_per_h": 60.0}
SIZE |= {"cooldown_s": 2.0, "arrival_soc_high": 0.3, "request_soc": 0.5, "battery_scale": 60.0}
EXITS = {"exit_x_m": [900.0, 2900.0], "exit_notice_m": 500.0, "num_depots": 2}


def wide(tree):
    """Leaves of 64 bits, by name."""
    leaves = jax.tree_util.tree_leaves_with_path(jax.tree.map(jnp.asarray, tree))
    keys = jax.dtypes.prng_key
    narrow = [jnp.issubdtype(x.dtype, keys) or x.dtype.itemsize < 8 for _, x in leaves]
    named = zip(leaves, narrow, strict=True)
    return [jax.tree_util.keystr(path) for (path, _), is_narrow in named if not is_narrow]


def played():
    """A minute under a rule: NumPy arrays of all that `step` returns."""
    env, params = medjax.make("paper", **SIZE, observation="profile")
    policy = medjax.BASELINES["budgeted"](env)

    def decide(state, key):
        choice = policy(key, None, state, params)
        obs, state, reward, *_, info = env.step(key, state, choice.action, params)
        return state, (obs, reward, choice, info["metrics"])

    @jax.jit
    def play(key):
        _, state = env.reset(key, params)
        return jax.lax.scan(decide, state, jax.random.split(key, 60))

    found = play(jax.random.key(0))
    assert not wide((params, found)), wide((params, found))
    metrics = found[1][-1]
    assert metrics["ev_received_kwh"][-1] > 0.0
    return [np.asarray(leaf) for leaf in jax.tree.leaves(found)]


def of_agents():
    """Shapes and types of a decision of agents, on a road with exits, depots and a critic's view."""
    env, params = agents_of("paper", **SIZE, **EXITS, central=True)

    def decide(key):
        _, state = env.reset(key, params)
        return env.step(key, state, jnp.zeros((env.num_agents,), jnp.int32), params)

    return jax.eval_shape(decide, jax.random.key(0))


def under_x64(file, run_dir):
    """With x64: writes the bits of `played` to a file, trains and evaluates a learner."""
    assert jax.config.jax_enable_x64
    np.savez(file, *played())
    shapes = jax.tree.leaves(of_agents())
    assert not [leaf for leaf in shapes if leaf.dtype in (np.float64, np.int64)]
    small = {"num_envs": 4, "num_minibatches": 2, "rollout_length": 8, "total_timesteps": 64}
    small |= {"hidden": (8,), "eval_episodes": 2}
    overrides = {**SIZE, "episode_decisions": 10}
    settings = PPOConfig(scenario="paper", overrides=overrides, **small)
    with quickly():
        learned = train(config=settings, run_dir=run_dir, quiet=True)
    assert learned.evaluation.result["policies"]["ppo"]["return_mean"] is not None
    assert not wide(learned.policy), wide(learned.policy)
    # The formulas are as wide as what they are given.
    body = {"mass": 1e3, "drag_coefficient": 0.3, "frontal_area": 2.0, "rolling_resistance": 0.01}
    for dtype in (np.float32, np.float64):
        assert tractive_energy(jnp.full(3, 10.0, dtype), 10.0, 1.0, **body).dtype == dtype


@pytest.mark.thorough
def test_the_world_is_float32_where_x64_is_on(tmp_path):
    """Reset, decisions of a rule, training and evaluation; the same bits as without, and no leaf of 64."""
    file = tmp_path / "played.npz"
    run_dir, wide = str(tmp_path / "run"), {**os.environ, "JAX_ENABLE_X64": "1"}
    code = f"from tests.test_x64 import under_x64; under_x64({str(file)!r}, {run_dir!r})"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=wide, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    with np.load(file) as found:
        theirs = [found[name] for name in found.files]
    ours = played()
    assert len(ours) == len(theirs) > 100
    for mine, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(mine, other)

"""The code for GPUs, run on a CPU."""

from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.wrappers import BatchAutoReset

ENVS, DECISIONS = 4, 30


def played(scenario, backend):
    """Every tenth state and reward of a batch whose dispatcher sends MEDs, with the code for a backend."""
    env, params = medjax.make(scenario)
    batch = BatchAutoReset(env)
    with mock.patch.object(jax, "default_backend", return_value=backend):
        keys = jax.random.split(jax.random.key(1), ENVS)
        _, state = jax.jit(lambda keys: batch.reset(keys, params))(keys)

        def decide(state, key):
            keys = jax.random.split(key, ENVS)
            action = jax.random.randint(key, (ENVS,), 0, env.num_actions)
            _, state, reward, *_ = batch.step(keys, state, action, params)
            return state, (state.env, reward)

        keys = jax.random.split(jax.random.key(2), DECISIONS)
        _, seen = jax.jit(lambda state: jax.lax.scan(decide, state, keys))(state)
    return jax.tree.map(lambda leaf: leaf[:: DECISIONS // 3], seen)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="a GPU would fuse the two differently")
@pytest.mark.parametrize("scenario", ["paper", "corridor"])
def test_the_code_for_gpus_gives_the_same_bits(scenario):
    """All but the order in which a CPU's next sort begins, which the code for GPUs leaves as it was."""
    (of_cpu, rewards), (of_gpu, same) = (played(scenario, which) for which in ("cpu", "gpu"))
    np.testing.assert_array_equal(same, rewards)
    order = of_cpu.vehicles.road_order
    assert (np.asarray(order) != of_gpu.vehicles.road_order).any()
    of_gpu = of_gpu.replace(vehicles=of_gpu.vehicles.replace(road_order=order))
    jax.tree.map(np.testing.assert_array_equal, of_gpu, of_cpu)
    for seen in (of_cpu.stats.meds_dispatched, of_cpu.stats.lane_changes):
        assert jnp.sum(seen) > 0

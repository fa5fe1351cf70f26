"""The drive of several updates: in any pieces, of any number of seeds, on any number of devices."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.algorithms.ppo.test_learner import BASE
from tests.train.probe_envs import Probe, ProbeParams
from train.algorithms.ppo.settings import PPOConfig
from train.algorithms.programs import make_train
from train.algorithms.registry import algorithm_of
from train.runs.policies import weight_shapes, weights_by_name
from train.settings import MOST_PER_CALL

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_seeds_are_independent():
    env, params = Probe("noisy"), ProbeParams()
    config = PPOConfig(**(BASE | {"num_seeds": 2}))
    programs = make_train(env, params, config)
    state, metrics = programs.run(programs.init(jax.random.key(0), params), params, jnp.int32(2))
    assert metrics["loss"].shape == (2, MOST_PER_CALL)
    first, second = metrics["loss"][:, :2]
    assert (first != second).all()
    assert state.update.shape == (2,)


def test_one_program_serves_all_chunks_and_these_do_not_change_the_result():
    env, params = Probe("noisy"), ProbeParams()
    steps = BASE["num_envs"] * BASE["rollout_length"] * 6
    config = PPOConfig(**(BASE | {"total_timesteps": steps}))
    programs = make_train(env, params, config)
    ends, run = [], None
    for chunks in ((6,), (1, 2, 3)):
        state = programs.init(jax.random.key(0), params)
        # Compiled ahead of time: a call that this program does not fit would fail.
        run = run or programs.run.lower(state, params, jnp.int32(1)).compile()
        rates = []
        for count in chunks:
            state, metrics = run(state, params, jnp.int32(count))
            assert np.isfinite(metrics["loss"][:count]).all()
            assert not metrics["loss"][count:].any()
            rates += metrics["learning_rate"][:count].tolist()
        assert int(state.update) == 6
        np.testing.assert_allclose(rates, [1e-2 * (1 - n / 6) for n in range(6)], rtol=1e-5)
        ends.append(state.weights)
    chex.assert_trees_all_equal(*ends)


def test_the_number_of_devices_changes_rounding_only():
    """The same start, lots and noise on one device and on two: all metrics and weights agree."""
    env, params = Probe("noisy"), ProbeParams()
    ends = []
    for num_devices in (1, 2):
        config = PPOConfig(**(BASE | {"num_devices": num_devices}))
        programs = make_train(env, params, config)
        state = programs.init(jax.random.key(0), params)
        assert len(state.rollout.obs.sharding.device_set) == num_devices
        state, metrics = programs.run(state, params, jnp.int32(3))
        ends.append(jax.device_get((state.weights, state.rollout.obs, metrics)))
    chex.assert_trees_all_close(*ends, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("num_seeds", [1, 3])
def test_the_start_is_what_training_begins_with(num_seeds):
    """Made anew from what a run leaves: its settings, and the shapes of its weights."""
    env, params = Probe("noisy"), ProbeParams()
    config = PPOConfig(**(BASE | {"seed": 7, "num_seeds": num_seeds}))
    begun = make_train(env, params, config).init(jax.random.key(config.seed), params).weights
    first = weights_by_name(config, begun)["ppo"]
    made = algorithm_of(config).start(env, config, weight_shapes(env, params, config))
    chex.assert_trees_all_close(made, first, rtol=1e-6)
    assert any(leaf.std() > 0 for leaf in jax.tree.leaves(made))

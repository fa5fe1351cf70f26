"""Programs of several updates: in any chunks, of any number of seeds, on any number of devices."""

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

ENV, PARAMS = Probe("noisy"), ProbeParams()
STEPS = BASE["num_envs"] * BASE["rollout_length"] * 6
CONFIG = PPOConfig(**(BASE | {"total_timesteps": STEPS, "seed": 7}))


def begin(programs):
    return programs.init(jax.random.key(CONFIG.seed), PARAMS)


@pytest.fixture(scope="module")
def shared():
    """Programs on two devices, and `run` compiled ahead of time: a call that it does not fit would fail."""
    programs = make_train(ENV, PARAMS, CONFIG)
    return programs, programs.run.lower(begin(programs), PARAMS, jnp.int32(1)).compile()


def assert_recreated(config, begun):
    """Initial weights are recreated from the settings of a run and the shapes of its weights."""
    made = algorithm_of(config).start(ENV, config, weight_shapes(ENV, PARAMS, config))
    chex.assert_trees_all_close(made, weights_by_name(config, begun)["ppo"], rtol=1e-6)
    assert any(leaf.std() > 0 for leaf in jax.tree.leaves(made))


@pytest.mark.thorough
def test_chunks_share_one_program_and_do_not_change_the_result(shared):
    programs, run = shared
    ends = []
    for chunks in ((6,), (1, 2, 3)):
        state = begin(programs)
        assert_recreated(CONFIG, jax.device_get(state.weights))
        rates = []
        for count in chunks:
            state, metrics = run(state, PARAMS, jnp.int32(count))
            assert np.isfinite(metrics["loss"][:count]).all()
            assert not metrics["loss"][count:].any()
            rates += metrics["learning_rate"][:count].tolist()
        assert int(state.update) == 6
        np.testing.assert_allclose(rates, [1e-2 * (1 - n / 6) for n in range(6)], rtol=1e-5)
        ends.append(state.weights)
    chex.assert_trees_all_equal(*ends)


@pytest.mark.thorough
def test_the_number_of_devices_changes_rounding_only(shared):
    """With the same keys on one device and on two, all metrics and weights agree."""
    alone = make_train(
        ENV, PARAMS, PPOConfig(**(BASE | {"num_devices": 1, "total_timesteps": STEPS}))
    )
    ends = []
    for num_devices, programs, run in ((1, alone, alone.run), (2, *shared)):
        state = begin(programs)
        assert len(state.rollout.obs.sharding.device_set) == num_devices
        state, metrics = run(state, PARAMS, jnp.int32(3))
        ends.append(jax.device_get((state.weights, state.rollout.obs, metrics)))
    chex.assert_trees_all_close(*ends, rtol=1e-3, atol=1e-4)


@pytest.mark.thorough
def test_seeds_are_independent():
    config = PPOConfig(**(BASE | {"seed": CONFIG.seed, "num_seeds": 3}))
    programs = make_train(ENV, PARAMS, config)
    state = begin(programs)
    assert_recreated(config, jax.device_get(state.weights))
    state, metrics = programs.run(state, PARAMS, jnp.int32(2))
    assert metrics["loss"].shape == (3, MOST_PER_CALL)
    for column in metrics["loss"][:, :2].T:
        assert len({*column.tolist()}) == 3
    assert state.update.shape == (3,)

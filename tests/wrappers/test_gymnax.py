"""gymnax 1.0's step contract, by gymnax itself: its base class, its wrappers, its rollouts."""

from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.wrappers import DecideEvery, RandomDemand

gymnax = pytest.importorskip("gymnax", reason='pip install "gymnax>=1.0"')
if int(version("gymnax").split(".")[0]) < 1:
    pytest.skip(f"gymnax {version('gymnax')}: its step had five values", allow_module_level=True)

from gymnax import wrappers  # noqa: E402
from gymnax.environments.environment import Environment  # noqa: E402
from gymnax.experimental import RolloutWrapper  # noqa: E402

from medjax.wrappers.gymnax import GymnaxEnv  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick_compiles")

DECISIONS = 4
STEPS = DECISIONS + 1
SMALL = {"num_meds": 3, "num_evs": 8, "num_gas": 12, "mainline_per_h": 600.0}
ENV, PARAMS = medjax.make("paper", **SMALL, episode_decisions=DECISIONS)
SIZE = ENV.observation_space(PARAMS).shape
KEY = jax.random.key(4)


class Inherited(Environment):
    """ChargingEnv's raw step under gymnax's own step, truncation, auto-reset and info."""

    default_params = PARAMS

    def step_env(self, key, state, action, params):
        obs, state, reward, terminated, _, info = ENV.step_env(key, state, action, params)
        return obs, state, reward, terminated, info

    def reset_env(self, key, params):
        return ENV.reset(key, params)

    def is_truncated(self, state, params):
        return state.time >= params.episode_decisions


def play(env):
    """A program: (first observation, results of STEPS decisions), each leaf `(STEPS, ...)`."""

    def run(key):
        obs, state = env.reset(key, PARAMS)

        def decide(state, key):
            action = ENV.action_space(PARAMS).sample(key)
            obs, state, *rest = env.step(key, state, action, PARAMS)
            return state, (obs, *rest)

        return obs, jax.lax.scan(decide, state, jax.random.split(key, STEPS))[1]

    return run


def test_step_is_that_of_gymnax_base_class():
    """Under gymnax's LogWrapper, which passes on all results and counts the episode."""
    env = wrappers.LogWrapper(ENV)
    first, (*values, info) = jax.device_get(jax.jit(play(env))(KEY))
    their_first, (*their_values, their_info) = jax.device_get(jax.jit(play(Inherited()))(KEY))
    np.testing.assert_allclose(first, their_first, rtol=1e-5, atol=1e-5)
    assert len(values) == len(their_values) == 4
    mine = [*values, info["final_observation"]]
    theirs = [*their_values, their_info["final_observation"]]
    for own, other in zip(mine, theirs, strict=True):
        assert (own.dtype, own.shape) == (other.dtype, other.shape)
        np.testing.assert_allclose(own, other, rtol=1e-4, atol=1e-4)
    _, reward, terminated, truncated = values
    assert not terminated.any()
    assert np.flatnonzero(truncated).tolist() == [DECISIONS - 1]
    np.testing.assert_array_equal(info["returned_episode"], truncated)
    assert info["returned_episode_lengths"][-1] == DECISIONS
    total = reward[:DECISIONS].sum()
    assert info["returned_episode_returns"][-1] == pytest.approx(total, rel=1e-5)
    assert info["metrics"]["vehicle_ticks"][DECISIONS - 1] > 0.0


# Traced, not run: what follows would compile the same step again, and can fail only in a shape, a type or a name.


def play_traced(env):
    first, (obs, reward, *_, info) = jax.eval_shape(play(env), KEY)
    assert first.shape == SIZE
    assert obs.shape == (STEPS, *SIZE)
    assert reward.shape == (STEPS,)
    assert info["final_observation"].shape == obs.shape


def play_gym(env):
    """Under Gymnasium's spaces."""
    obs, _ = env.reset(seed=1)
    assert env.observation_space.contains(np.asarray(obs))
    assert env.action_space.n == ENV.num_actions
    obs, reward, terminated, truncated, _ = env.step(1)
    assert env.observation_space.contains(np.asarray(obs))
    assert (bool(terminated), bool(truncated)) == (False, False)
    assert np.isfinite(float(reward))


def play_vector(env):
    obs, _ = env.reset(seed=1)
    assert obs.shape == env.observation_space.shape == (2, *SIZE)
    for _ in range(DECISIONS):
        obs, _, _, truncated, info = env.step(np.zeros(2, np.int32))
    assert truncated.all()
    assert info["final_observation"].shape == obs.shape


def play_dm_env(env):
    """Finds the final observation."""

    def run(key):
        def decide(step, key):
            step = env.step(key, step, ENV.action_space(PARAMS).sample(key), PARAMS)
            return step, (step.observation, step.final_observation, step.discount)

        first = env.reset(key, PARAMS)
        first = first.replace(discount=jnp.float32(1.0), reward=jnp.float32(0.0))
        return jax.lax.scan(decide, first, jax.random.split(key, STEPS))[1]

    obs, final, discount = jax.eval_shape(run, KEY)
    assert obs.shape == final.shape == (STEPS, *SIZE)
    assert discount.shape == (STEPS,)
    return final


# A wrapper that a new version of gymnax brings is missing here, and fails the test.
CHECKS = {
    "FlattenObservationWrapper": play_traced,
    "GymnaxToGymWrapper": play_gym,
    "GymnaxToVectorGymWrapper": play_vector,
    "LogWrapper": play_traced,
    "StickyActionWrapper": play_traced,
    "LegacyStepAPIWrapper": play_traced,
    "GymnaxToDmEnvWrapper": play_dm_env,
}


@pytest.mark.thorough
def test_every_wrapper_of_gymnax_takes_the_environment():
    assert set(wrappers.__all__) == set(CHECKS)
    for name, check in CHECKS.items():
        more = {"num_envs": 2} if "Vector" in name else {}
        check(getattr(wrappers, name)(GymnaxEnv(ENV, PARAMS), **more))


@pytest.mark.parametrize("wrap", [wrappers.LogWrapper, wrappers.LegacyStepAPIWrapper])
def test_wrappers_without_spaces_take_environments_directly(wrap):
    """The five values of gymnax before 1.0 come from gymnax's own wrapper."""
    wrapped = DecideEvery(RandomDemand(ENV, 0.5, 1.5), 2)
    for env in (ENV, wrapped):
        play_traced(wrap(env))
    values = jax.eval_shape(play(wrap(ENV)), KEY)[1]
    assert len(values) == (4 if wrap is wrappers.LegacyStepAPIWrapper else 5)


def test_log_wrapper_takes_a_wrapped_environment():
    env = wrappers.LogWrapper(DecideEvery(RandomDemand(ENV, 0.5, 1.5), 2))
    _, (obs, *_, info) = jax.eval_shape(play(env), KEY)
    assert obs.shape == (STEPS, *SIZE)
    assert info["returned_episode_returns"].shape == (STEPS,)


def test_dm_env_wrapper_takes_the_environment_directly():
    assert play_dm_env(wrappers.GymnaxToDmEnvWrapper(ENV)).shape == (STEPS, *SIZE)


def test_rollout_wrapper_plays_batches_of_episodes():
    rollouts = RolloutWrapper(env=GymnaxEnv(ENV, PARAMS), num_env_steps=DECISIONS)
    keys = jax.random.split(KEY, 2)
    obs, action, reward, _, done, total = jax.eval_shape(
        rollouts.batch_rollout, keys, jnp.zeros(())
    )
    assert obs.shape == (2, DECISIONS, *SIZE)
    assert action.shape == reward.shape == done.shape == (2, DECISIONS)
    assert total.shape == (2, 1)

"""Bad arguments are refused in one line when an object is made or traced."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.env.reward import TERMS
from medjax.errors import InputError
from medjax.wrappers import (
    BatchAutoReset,
    DecideEvery,
    EpisodeLog,
    RandomDemand,
    TimeLimitAsEnd,
    environment_mesh,
)
from medjax.wrappers.agents import NamedAgents
from train.algorithms.normalization import init_stats, update_stats

NONE = "env is None: allowed an environment"
FACTORS = "factors of the demand are"


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda env: DecideEvery(None, 2), NONE),
        (lambda env: BatchAutoReset(None), NONE),
        (lambda env: TimeLimitAsEnd(None), NONE),
        (lambda env: RandomDemand(None, 0.5, 1.0), NONE),
        (lambda env: EpisodeLog(None), NONE),
        (lambda env: NamedAgents(env, None), "allowed one of agents, as make_agents gives it"),
        (lambda env: RandomDemand(env, None, 1.0), "factors of the demand are None to 1.0"),
        (lambda env: RandomDemand(env, 0.5, "1"), "factors of the demand are 0.5 to '1'"),
        (lambda env: RandomDemand(env, np.ones(2), 1.0), "factors of the demand are array("),
        (lambda env: DecideEvery(env, 1.5), "interval is 1.5, must be a whole number, at least 1"),
        (lambda env: DecideEvery(env, True), "interval is True, must be a whole number"),
        (lambda env: DecideEvery(env, 0), "interval is 0, must be a whole number, at least 1"),
        (lambda env: BatchAutoReset(env, stagger=-1), "stagger is -1, must be a whole number"),
        (lambda env: RandomDemand(env, -0.1, 1.0), f"{FACTORS} -0.1 to 1.0, must be"),
        (lambda env: RandomDemand(env, 1.0, 0.9), f"{FACTORS} 1.0 to 0.9, must be"),
        (lambda env: RandomDemand(env, 0.0, np.inf), f"{FACTORS} 0.0 to inf, must be"),
        (lambda env: RandomDemand(env, np.nan, 1.0), f"{FACTORS} nan to 1.0, must be"),
        (
            lambda env: BatchAutoReset(env, reset_pool_size=float("nan")),
            "reset_pool_size is nan, must be a whole number, at least 0",
        ),
        (lambda env: BatchAutoReset(env, -1), "reset_pool_size is -1, must be a whole number"),
        (lambda env: BatchAutoReset(env, group=0), "group is 0, must be a whole number"),
        (lambda env: env.with_probe(3), "probe is 3: allowed a function"),
        (lambda env: medjax.ChargingEnv(env.config, {"x": 3}), "reward['x'] = 3: allowed a func"),
        (lambda env: medjax.ChargingEnv(env.config, {3: max}), "reward[3] = <built-in function"),
        (lambda env: medjax.ChargingEnv(env.config, "money"), "reward = 'money': allowed functio"),
        (lambda env: environment_mesh(0), "num_envs is 0, allowed: at least 1"),
        (lambda env: environment_mesh("x"), "num_envs is 'x', allowed: a whole number"),
        (lambda env: environment_mesh(4, 2.0), "num_devices is 2.0, allowed: a whole number"),
        (lambda env: update_stats(init_stats(), jnp.zeros((0,))), "samples have shape (0,)"),
    ],
)
def test_refused_when_made(paper, make, says):
    with pytest.raises(InputError) as refusal:
        make(paper[0])
    assert says in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_reward_of_another_shape_is_refused_when_traced():
    """The message names the term."""
    reward = {**TERMS, "many": lambda outcome: jnp.zeros(3)}
    env, params = medjax.make("paper", reward=reward, num_evs=8, num_gas=12)
    _, state = jax.eval_shape(env.reset, jax.random.key(0), params)
    with pytest.raises(InputError, match=r"reward term 'many' returns shape \(3,\): allowed \(\)"):
        jax.eval_shape(env.step_env, jax.random.key(0), state, jnp.int32(0), params)


class Seen:
    """A user's observation, which returns `seen` whatever size it declares."""

    def __init__(self, size, seen):
        self.declared, self.seen = size, seen

    def size(self, config):
        return self.declared

    def __call__(self, state, config, params):
        return self.seen


@pytest.mark.parametrize(
    ("observation", "says"),
    [
        (Seen(3, jnp.zeros(5)), "returns shape (5,) and type float32: allowed (3,) and float32"),
        (Seen(3, jnp.zeros((3, 1))), "returns shape (3, 1) and type"),
        (Seen(3, jnp.zeros(3, int)), "returns shape (3,) and type int32: allowed"),
        (Seen(2, [0.0, 1.0]), "returns [0.0, 1.0]: allowed (2,) and float32"),
        (Seen(2.0, jnp.zeros(2)), "size(config) of the observation is 2.0: allowed an integer"),
        (lambda state, config, params: jnp.zeros(3), "its size(config) is missing, allowed flat"),
        (Seen, "allowed flat, profile, or one of your own with size(config) and __call__"),
    ],
)
def test_observations_must_have_their_declared_size(observation, says):
    """In `make`, and when an environment made by hand is traced."""
    paper, params = medjax.make("paper", num_evs=8, num_gas=12)

    def by_hand():
        env = medjax.ChargingEnv(paper.config, observation=observation)
        jax.eval_shape(env.reset, jax.random.key(0), params)

    for make in (lambda: medjax.make("paper", observation=observation), by_hand):
        with pytest.raises(InputError) as refusal:
            make()
        assert says in str(refusal.value)
        assert "\n" not in str(refusal.value)


def test_a_users_observation_is_accepted():
    env, params = medjax.make("paper", observation=Seen(3, jnp.ones(3)), num_evs=8, num_gas=12)
    obs, _ = jax.eval_shape(env.reset, jax.random.key(0), params)
    assert obs.shape == env.observation_space(params).shape == (3,)


@pytest.mark.parametrize(
    ("sizes", "says"),
    [
        ({"num_exits": 1}, "road.exit_x_m has shape (1,), allowed (0,)"),
        ({"num_ramps": 2}, "road.ramp_x_m has shape (2,), allowed (4,)"),
        ({"profile": [1.0, 2.0]}, "demand.profile has shape (2, 5), allowed (1, 5)"),
    ],
)
@pytest.mark.parametrize("around", [lambda call: call, jax.jit], ids=["eager", "jit"])
def test_params_of_another_config_are_refused(paper, around, sizes, says):
    """By reset and step, before anything is computed; so is a batch of params outside of vmap."""
    env, params = paper
    _, others = medjax.make("paper", **sizes)
    key = jax.random.key(0)
    _, state = jax.eval_shape(env.reset, key, params)
    state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), state)
    many = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), params)
    for given, words in ((others, says), (many, "has shape (2,")):
        for call in (
            lambda given=given: around(env.reset)(key, given),
            lambda given=given: around(env.step)(key, state, 0, given),
        ):
            with pytest.raises(InputError) as refusal:
                call()
            assert "params were made for another config: " in str(refusal.value)
            assert words in str(refusal.value)


def test_params_of_more_lanes_are_refused(paper):
    """Their shapes fit; a service lane that does not exist tells, where values are known."""
    env, _ = paper
    _, others = medjax.make("paper", num_lanes=6, service_lane=5)
    with pytest.raises(InputError, match="service_lane = 5: allowed at most num_lanes - 1 = 3"):
        env.reset(jax.random.key(0), others)

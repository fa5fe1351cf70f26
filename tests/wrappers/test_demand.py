"""Episodes of a demand of their own, against the environment without the wrapper and closed forms."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

import medjax
from medjax.traffic.demand import entry_rates, expected_vehicles
from medjax.world.kinds import GAS
from medjax.wrappers import BatchAutoReset, RandomDemand, scale_demand
from train.algorithms.ppo.learner import build_learner
from train.algorithms.ppo.settings import PPOConfig

LOW, HIGH = 0.5, 1.5
THRESHOLD = 2600.0


@struct.dataclass
class TollState:
    """State of `Toll`."""

    time: jax.Array  # () int32


class Toll:
    """Pays the demand of the mainline at every decision; episodes of three."""

    name, num_actions = "toll", 2

    def reset(self, key, params):
        return params.demand.mainline_per_h, TollState(jnp.int32(0))

    def step_env(self, key, state, action, params):
        paid = params.demand.mainline_per_h
        time = state.time + 1
        return paid, TollState(time), paid, jnp.bool_(False), time == 3, {"metrics": {}}

    def action_mask(self, state, params):
        return jnp.array([True, params.demand.mainline_per_h > THRESHOLD])


@pytest.fixture(scope="module")
def small():
    """A road with few slots, which sees the known demand."""
    return medjax.make("paper", observation="profile", num_meds=2, num_evs=8, num_gas=20)


def course_of(env):
    """A function of (key, params): all that 30 random decisions return, and the first state."""

    @jax.jit
    def course(key, params):
        reset_key, key = jax.random.split(key)
        obs, first = env.reset(reset_key, params)

        def step(state, key):
            action = jax.random.randint(key, (), 0, env.num_actions)
            mask = env.action_mask(state, params)
            obs, state, *rest = env.step_env(key, state, action, params)
            return state, (obs, mask, state.time, *rest)

        return first, (obs, *jax.lax.scan(step, first, jax.random.split(key, 30))[1])

    return course


@pytest.fixture(scope="module")
def plain(small):
    """The course of the environment without the wrapper."""
    return course_of(small[0])


@pytest.mark.parametrize("bounds", [pytest.param((1.0, 1.0), marks=pytest.mark.slow), (LOW, HIGH)])
def test_an_episode_is_that_of_the_demand_drawn(small, plain, bounds):
    """Bit for bit, observations, masks and metrics included; that of the preset at a factor of 1."""
    env, params = small
    wrapped = RandomDemand(env, *bounds)
    first, results = course_of(wrapped)(jax.random.key(5), params)
    true = scale_demand(params, first.factor)
    own_first, own_results = plain(jax.random.key(5), true)
    chex.assert_trees_all_equal((first.env, results), (own_first, own_results))
    of_preset = plain(jax.random.key(5), params)[1]
    same = bounds == (1.0, 1.0)
    assert (first.factor == 1.0) == same
    assert bool((of_preset[0] == results[0]).all()) == same
    assert wrapped.name == env.name
    assert wrapped.observation_space(params).shape == results[0].shape


def test_the_factor_is_of_all_entries_alike(small):
    params = small[1]
    demand = scale_demand(params, HIGH).demand
    assert demand.mainline_per_h == HIGH * params.demand.mainline_per_h
    np.testing.assert_array_equal(demand.ramp_per_h, HIGH * params.demand.ramp_per_h)
    assert demand.ev_share == params.demand.ev_share
    chex.assert_trees_all_equal(scale_demand(params, 1.0), params)


def test_every_episode_has_one_factor_of_its_own(small):
    """Drawn anew where an episode ends, and only there; uniform between the bounds."""
    params, num_envs = small[1], 64
    batch = BatchAutoReset(RandomDemand(Toll(), LOW, HIGH))

    @jax.jit
    def play(key):
        def step(state, key):
            keys = jax.random.split(key, num_envs)
            mask = batch.action_mask(state, params)
            _, state, reward, _, truncated, _ = batch.step(keys, state, mask[:, 1], params)
            return state, (state.env.factor, mask, reward, truncated)

        reset_key, key = jax.random.split(key)
        _, state = batch.reset(jax.random.split(reset_key, num_envs), params)
        return state.env.factor, jax.lax.scan(step, state, jax.random.split(key, 7))[1]

    first, (after, mask, reward, done) = jax.device_get(play(jax.random.key(0)))
    factors = np.concatenate([first[None], after])
    assert done.sum() == 2 * num_envs
    np.testing.assert_array_equal(np.diff(factors, axis=0) != 0.0, done)
    # What a step pays and what the mask says before it is of the episode that it belongs to.
    demands = factors[:-1] * float(params.demand.mainline_per_h)
    np.testing.assert_allclose(reward, demands, rtol=1e-6)
    np.testing.assert_array_equal(mask[..., 1], demands > THRESHOLD)
    assert factors.min() >= LOW
    assert factors.max() <= HIGH
    drawn = np.concatenate([first, after[done]])
    assert len(np.unique(drawn)) == 3 * num_envs
    quarters = np.histogram(drawn, 4, (LOW, HIGH))[0] / drawn.size
    np.testing.assert_allclose(quarters, 0.25, atol=0.1)  # three standard deviations


def test_vehicles_that_enter_follow_the_factor():
    """Those on the road at the start and those that come are as many as the demand brings on average."""
    env, params = medjax.make("paper", arrival_soc_low=0.8, arrival_soc_high=0.9)
    wrapped = RandomDemand(env, 0.25, 1.0)
    decisions, episodes = 30, 96

    @jax.jit
    @jax.vmap
    def entered(key):
        def step(state, key):
            return wrapped.step_env(key, state, jnp.int32(0), params)[1], None

        _, state = wrapped.reset(key, params)
        state, _ = jax.lax.scan(step, state, jax.random.split(key, decisions))
        return state.factor, jnp.sum(state.env.tally.entered)

    factor, count = jax.device_get(entered(jax.random.split(jax.random.key(1), episodes)))
    start = expected_vehicles(params.demand, params.road, params.drivers.desired_speed[GAS])
    comes = jnp.sum(entry_rates(params.demand, env.config.num_lanes, 0.0))
    expected = float(start + comes * decisions * env.config.decision_s)
    slope, offset = np.polyfit(factor, count, 1)
    error = 3.0 * np.sqrt(expected / episodes) / factor.std()  # of the slope, counts being Poisson
    assert slope == pytest.approx(expected, abs=error)
    assert offset == pytest.approx(0.0, abs=error)


@pytest.mark.parametrize(("low", "high"), [(-0.1, 1.0), (1.0, 0.9), (0.0, np.inf), (np.nan, 1.0)])
def test_bad_factors_are_refused(low, high):
    with pytest.raises(ValueError, match=f"factors of the demand are {low} to {high}, must be"):
        RandomDemand(Toll(), low, high)


@pytest.mark.parametrize("bounds", [(LOW, HIGH), (1.0, 1.0)])
def test_the_learner_draws_what_its_settings_say(small, bounds):
    """By default it has no wrapper at all."""
    config = PPOConfig(num_envs=8, num_minibatches=8, demand_range=bounds)
    learner = build_learner(*small, config)
    state = jax.eval_shape(
        learner.collector.env.reset, jax.random.split(jax.random.key(0), 8), small[1]
    )[1]
    inner = state.env.env
    assert hasattr(inner, "factor") == (bounds != (1.0, 1.0))
    assert inner.time.shape == (8,)

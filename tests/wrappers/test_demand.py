"""`RandomDemand` against the environment without it, and against closed forms."""

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
from tests.compiling import quickly
from train.algorithms.ppo.learner import build_learner
from train.algorithms.ppo.settings import PPOConfig

LOW, HIGH = 0.5, 1.5
THRESHOLD = 2600.0


@struct.dataclass
class TollState:
    """State of `Toll`."""

    time: jax.Array  # () int32


class Toll:
    """Rewards each decision with the mainline's demand; episodes of three decisions."""

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
    """Few slots, and an observation that forecasts demand."""
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
    return course_of(small[0])


@pytest.mark.parametrize(
    "bounds",
    [
        pytest.param((1.0, 1.0), marks=pytest.mark.slow),
        pytest.param((LOW, HIGH), marks=pytest.mark.thorough),
    ],
)
def test_an_episode_equals_that_of_its_demand_without_the_wrapper(small, plain, bounds):
    """Bit for bit, observations, masks and metrics included."""
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


def test_the_factor_scales_all_entries(small):
    params = small[1]
    demand = scale_demand(params, HIGH).demand
    assert demand.mainline_per_h == HIGH * params.demand.mainline_per_h
    np.testing.assert_array_equal(demand.ramp_per_h, HIGH * params.demand.ramp_per_h)
    assert demand.ev_share == params.demand.ev_share
    chex.assert_trees_all_equal(scale_demand(params, 1.0), params)


@pytest.mark.thorough
def test_each_episode_draws_one_factor(small):
    """Only where an episode ends, uniformly between the bounds."""
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
    # Rewards and masks read the factor of their own episode.
    demands = factors[:-1] * float(params.demand.mainline_per_h)
    np.testing.assert_allclose(reward, demands, rtol=1e-6)
    np.testing.assert_array_equal(mask[..., 1], demands > THRESHOLD)
    assert factors.min() >= LOW
    assert factors.max() <= HIGH
    drawn = np.concatenate([first, after[done]])
    assert len(np.unique(drawn)) == 3 * num_envs
    quarters = np.histogram(drawn, 4, (LOW, HIGH))[0] / drawn.size
    np.testing.assert_allclose(quarters, 0.25, atol=0.1)  # three standard deviations


@pytest.mark.thorough
def test_vehicles_that_enter_follow_the_factor():
    """As many as the demand brings on average, on the road at the start and later."""
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
        return state.factor, jnp.sum(state.env.stats.entered)

    with quickly():
        factor, count = jax.device_get(entered(jax.random.split(jax.random.key(1), episodes)))
    start = expected_vehicles(params.demand, params.road, params.drivers.desired_speed[GAS])
    comes = jnp.sum(entry_rates(params.demand, env.config.num_lanes, 0.0))
    expected = float(start + comes * decisions * env.config.decision_s)
    slope, offset = np.polyfit(factor, count, 1)
    error = 3.0 * np.sqrt(expected / episodes) / factor.std()  # of the slope, counts being Poisson
    assert slope == pytest.approx(expected, abs=error)
    assert offset == pytest.approx(0.0, abs=error)


@pytest.mark.parametrize("bounds", [(LOW, HIGH), (1.0, 1.0)])
def test_a_learner_wraps_only_where_its_settings_say(small, bounds):
    config = PPOConfig(num_envs=8, num_minibatches=8, demand_range=bounds)
    learner = build_learner(*small, config)
    state = jax.eval_shape(
        learner.collector.env.reset, jax.random.split(jax.random.key(0), 8), small[1]
    )[1]
    inner = state.env.env
    assert hasattr(inner, "factor") == (bounds != (1.0, 1.0))
    assert inner.time.shape == (8,)

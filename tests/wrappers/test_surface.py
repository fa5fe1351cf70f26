"""A wrapped environment has the whole interface of an environment, for each wrapper and for all stacked."""

import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax import wrappers
from medjax.episodes.recording import record_episode
from medjax.episodes.scores import evaluate_policies
from medjax.episodes.table import vehicle_table
from medjax.policies.about import About
from medjax.policies.saved import load_policy, save_policy
from medjax.wrappers import DecideEvery, RandomDemand, TimeLimitAsEnd
from train.algorithms.networks import PolicyWeights, build_network, learned_policy
from train.algorithms.normalization import init_stats
from train.algorithms.ppo.settings import PPOConfig

pytestmark = pytest.mark.usefixtures("quick_compiles")

DECISIONS, EPISODES = 5, 2
WORLDS = {
    "time limit": TimeLimitAsEnd,
    "decide every": lambda env: DecideEvery(env, 3),
    "demand": lambda env: RandomDemand(env, 0.5, 1.5),
    "demand over decide every": lambda env: RandomDemand(DecideEvery(env, 3), 0.5, 1.5),
    "all": lambda env: TimeLimitAsEnd(RandomDemand(DecideEvery(env, 3), 0.5, 1.5)),
}


@pytest.fixture(scope="module")
def highway(quick_compiles):
    """An environment of a user's class."""
    env, params = medjax.make(
        "paper", num_meds=2, num_evs=4, num_gas=6, mainline_per_h=600, episode_decisions=DECISIONS
    )
    own = type("Own", (medjax.ChargingEnv,), {})(env.config, name="mine")
    return own, params


@pytest.fixture(scope="module")
def saved(highway, tmp_path_factory):
    """A policy from a file that prefers the last allowed action."""
    env, _ = highway
    rows, size = jax.export.symbolic_shape("rows")[0], env.observation_space().shape[0]

    def network(obs, mask):
        chances = jnp.where(mask, jnp.arange(1.0, 1.0 + env.num_actions), 0.0)
        return chances / chances.sum(axis=1, keepdims=True), obs.sum(axis=1)

    shapes = ((rows, size), "float32"), ((rows, env.num_actions), "bool")
    exported = jax.export.export(jax.jit(network))(
        *(jax.ShapeDtypeStruct(*each) for each in shapes)
    )
    path = tmp_path_factory.mktemp("saved") / "policy.zip"
    save_policy(path, About("paper", {}, "flat", 2, size, env.num_actions, "saved"), exported)
    return load_policy(path)


# The stack of all covers the others, which are slow.
CASES = [
    pytest.param(world, marks=pytest.mark.thorough if world == "all" else pytest.mark.slow)
    for world in WORLDS
]


@pytest.mark.parametrize("world", CASES)
def test_the_whole_surface(world, highway, saved):
    env, params = WORLDS[world](highway[0]), highway[1]
    steps = -(-DECISIONS // env.decisions_per_step)
    policies = {name: build(env) for name, build in medjax.BASELINES.items()}
    policies |= {"saved": saved.policy(env), "learned": learned(env, params)}
    check_members(env, params, policies)
    scores = evaluate_policies(env, params, policies, EPISODES, seed=3)
    assert all((score["length"] == steps).all() for score in scores.values())
    assert (scores["saved"]["meds_dispatched"] >= 1.0).all()
    recording = record_episode(env, params, policies["saved"], seed=3, episode=1)
    check_recording(recording, scores["saved"], steps)
    check_gymnasium(env, params, steps)


def learned(env, params):
    """A network before training."""
    network = build_network(env, PPOConfig(hidden=(4,)))
    shape = env.observation_space(params).shape
    variables = jax.jit(network.init)(jax.random.key(0), jnp.zeros((1, *shape)))
    return learned_policy(env, network, PolicyWeights(variables, init_stats(shape)))


def check_members(env, params, policies):
    """All members of the contract, in one program."""

    def everything(key):
        obs, state = env.reset(key, params)
        mask = env.action_mask(state, params)
        actions = {name: act(key, obs, state, params).action for name, act in policies.items()}
        after = env.step_env(jax.random.split(key)[0], state, actions["saved"], params)
        step = env.step(key, state, actions["saved"], params)
        again = [env.get_obs(state, params), env.get_obs(after[1], params)]
        road, numbers = env.highway(after[1], params)
        rows = env.observe(after[1], params)
        return mask, actions, (obs, state), after, step, again, (road, numbers), rows

    mask, actions, (obs, state), after, step, again, (road, numbers), rows = jax.device_get(
        jax.jit(everything)(jax.random.key(1))
    )
    assert (env.name, env.num_actions) == ("mine", 5)
    assert mask.shape == (5,)
    assert all(mask[action] for action in actions.values())
    assert env.action_space(params).n == 5
    assert obs.shape == env.observation_space(params).shape == (env.observation.size(env.config),)
    np.testing.assert_allclose(obs, again[0], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(after[0], again[1], rtol=1e-5, atol=1e-6)
    assert rows.meds.shape[0] == env.config.num_meds
    np.testing.assert_allclose(step[0], after[0], rtol=1e-5, atol=1e-6)
    assert len(step) == 6
    np.testing.assert_array_equal(step[-1]["final_observation"], step[0])
    assert sum(after[-1]["reward_terms"].values()) == pytest.approx(after[2], rel=1e-4)
    assert int(road.time) == int(after[1].time) == env.decisions_per_step
    drawn = getattr(state, "factor", 1.0) * params.demand.mainline_per_h
    assert numbers.demand.mainline_per_h == pytest.approx(float(drawn))
    assert env.render(after[1], params, width=320, height=200).shape == (200, 320, 3)
    assert type(env.with_probe(None)) is type(env)


def check_recording(recording, score, steps):
    """A recording holds the episode that evaluation plays."""
    ticks = DECISIONS * recording.config.ticks_per_decision
    assert len(recording.frames.x) == 1 + ticks
    assert recording.decisions.action.shape == (steps,)
    assert recording.decision_frames[-1] == ticks
    assert recording.decisions.reward.sum() == pytest.approx(score["return"][1], rel=1e-4)
    stats = recording.decisions.stats
    assert stats.meds_dispatched.sum() == score["meds_dispatched"][1]
    rows = len(vehicle_table(recording)["time_s"])
    assert rows == recording.frames.active.sum() > 0
    assert rows == stats.vehicle_ticks.sum() + recording.frames.active[0].sum()


def check_gymnasium(env, params, steps):
    """One episode in the single and in the vector environment."""
    gym = pytest.importorskip("medjax.wrappers.gymnasium", reason='pip install -e ".[gymnasium]"')
    single = gym.ChargingGymEnv(env=env, params=params)
    several = gym.ChargingVectorEnv(2, env=env, params=params)
    assert single.simulator is env
    obs, info = single.reset(seed=1)
    both, infos = several.reset(seed=1)
    np.testing.assert_allclose(obs, both[0], rtol=1e-4, atol=1e-4)
    assert info["action_mask"].all()
    for number in range(steps):
        obs, reward, terminated, truncated, info = single.step(1)
        _, rewards, *ends, infos = several.step(np.ones(2))
        assert (terminated or truncated) == (number == steps - 1)
        assert reward == pytest.approx(rewards[0], rel=1e-3, abs=1e-4)
        assert sum(info["reward_terms"].values()) == pytest.approx(reward, rel=1e-4)
    assert np.logical_or(*ends).all()
    np.testing.assert_allclose(obs, infos["final_obs"][0], atol=1e-3)


@pytest.mark.parametrize(
    "wrap", [*WORLDS.values(), wrappers.BatchAutoReset, lambda env: wrappers.EpisodeLog(env)]
)
def test_a_wrapped_environment_pickles(wrap):
    env, params = medjax.make("paper", num_meds=2, num_evs=4, num_gas=6)
    wrapped = wrap(env)
    copy, _ = pickle.loads(pickle.dumps((wrapped, params)))
    assert type(copy) is type(wrapped)
    assert copy.num_actions == wrapped.num_actions

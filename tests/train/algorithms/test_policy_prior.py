"""The policy that training starts from, and the former name of its setting."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.agents import agents_of
from medjax.env.wrapper import Wrapper
from medjax.errors import InputError
from medjax.policies.rules import BASELINES
from medjax.scenarios import prepare
from train import option
from train.algorithms.environments import check_given
from train.algorithms.networks import build_network, masked_categorical
from train.algorithms.policy_prior import prior_logits
from train.algorithms.ppo.settings import PPOConfig
from train.runs.arguments import parse_request
from train.settings import from_json, to_json

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_the_environment_decides_whether_a_rule_is_the_start():
    """Of one's own environment, whose observation the settings do not name."""
    soft = PPOConfig(rule_sharpness=2.0)
    profile, flat = (prepare("paper", observation=name)[0] for name in ("profile", "flat"))
    check_given(profile, dataclasses.replace(soft, observation="flat"))
    for env in (flat, MoreActions(profile)):
        with pytest.raises(InputError, match=r"rule_sharpness is 2.0 .*allowed: 1.0 or 4.0"):
            check_given(env, soft)


@dataclasses.dataclass(frozen=True)
class MoreActions(Wrapper):
    """An environment of one's own, with an action more than there are ramps."""

    @property
    def num_actions(self):
        return self.env.num_actions + 1


def logits_at(env, params, config):
    """Initial logits of one observation."""
    obs = jnp.ones((1, *env.observation_space(params).shape))
    network = build_network(env, config)
    return network.apply(network.init(jax.random.key(0), obs), obs)[0][0]


def test_other_actions_than_ramps_start_without_the_rule():
    env, params = medjax.make("paper", observation="profile", num_meds=3, num_evs=5, num_gas=12)
    for world, even in ((MoreActions(env), True), (env, False)):
        logits = logits_at(world, params, PPOConfig(hidden=(4,), rule_sharpness=4.0))
        assert logits.shape == (world.num_actions,)
        assert (np.ptp(logits[1:]) < 0.1) == even


@pytest.mark.parametrize("sharpness", [1.0, 4.0])
def test_starts_as_the_rule(sharpness):
    """Before training the most probable action is that of `budgeted`, except for ties that the last layer decides."""
    env, params = medjax.make("paper", observation="profile")
    network = build_network(env, PPOConfig(hidden=(16,), rule_sharpness=sharpness))
    policy, rule = BASELINES["budgeted"](env), BASELINES["random"](env)

    def play(state, key):
        obs, mask = env.get_obs(state, params), env.action_mask(state, params)
        act_key, step_key = jax.random.split(key)
        choice = policy(act_key, obs, state, params).action
        taken = rule(act_key, obs, state, params).action
        goes = jnp.where(jax.random.bernoulli(step_key, 0.1), taken, choice)
        return env.step_env(step_key, state, goes, params)[1], (obs, mask, choice)

    @jax.jit
    def rollout(key):
        reset_key, key = jax.random.split(key)
        return jax.lax.scan(play, env.reset(reset_key, params)[1], jax.random.split(key, 400))[1]

    obs, mask, expected = rollout(jax.random.key(3))
    logits, _ = network.apply(network.init(jax.random.key(0), obs), obs)
    mode = np.asarray(masked_categorical(logits, mask).mode())
    near = np.sort(np.asarray(jnp.where(mask, logits, -1e9)), axis=1)
    clear = near[:, -1] - near[:, -2] > 0.2
    np.testing.assert_array_equal(mode[clear], np.asarray(expected)[clear])
    assert (mode[clear] > 0).sum() >= 3
    assert clear.mean() > 0.8


def test_the_rules_sharpness_scales_its_margins():
    """A rule half as sharp has half of each logit, and waiting's stays 0: the same most probable action, softer."""
    env, params = medjax.make("paper", observation="profile")
    obs = jax.random.uniform(jax.random.key(0), (8, *env.observation_space(params).shape))
    sharp, soft = (
        np.asarray(prior_logits(env, PPOConfig(rule_sharpness=each))(obs)) for each in (2.0, 1.0)
    )
    assert (sharp[:, 0] == 0.0).all()
    assert np.abs(sharp[:, 1:]).min() > 0.0
    np.testing.assert_allclose(soft, 0.5 * sharp, rtol=1e-6)


@pytest.mark.parametrize(("observation", "prior"), [("profile", "wait"), ("flat", "rule")])
def test_waits_with_the_given_probability(started, observation, prior):
    """A flat observation does not tell what the rule reads, so that training starts by waiting whatever is set."""
    env, params = medjax.make("paper", observation=observation)
    config = PPOConfig(hidden=(16,), policy_prior=prior, initial_wait=0.9)
    logits = logits_at(env, params, config)
    np.testing.assert_allclose(jax.nn.softmax(logits), [0.9, *[0.025] * 4], atol=0.01)
    _, state = started
    obs, network = env.get_obs(state, params), build_network(env, config)
    logits, _ = network.apply(network.init(jax.random.key(1), obs[None]), obs)
    probs = masked_categorical(logits, env.action_mask(state, params)).probs
    np.testing.assert_allclose(probs, [0.9, *[0.025] * 4], atol=0.01)


def test_agents_try_all_speeds_and_most_probably_serve_as_the_fleet():
    """Speeds that are hardly tried are not learned; the most probable action before training is still the rule's."""
    env, _ = agents_of("paper", num_meds=3, num_evs=5, num_gas=12)
    config = PPOConfig(hidden=(4,), agents="ippo", policy_prior="wait")
    logits = np.asarray(prior_logits(env, config)(jnp.zeros(env.observation.size(env.config))))
    enter, *parts = env.actions.parts
    starts = np.cumsum([enter.n, *(part.n for part in parts)])
    speed, lane, accept, leave = np.split(logits, starts[:-1])[1:]
    assert speed.argmax() == env.actions.speeds.index(22.0)
    chosen = np.exp(speed) / np.exp(speed).sum()
    np.testing.assert_allclose(chosen, 1 / len(env.actions.speeds), atol=0.03)
    assert (lane.argmax(), accept.argmax(), leave.argmax()) == (env.actions.usual[1], 1, 0)


def test_a_rollout_is_an_episode():
    """Of `paper` where none is known: 600 decisions of 1 s, of agents 150 of 4 s. Else in choices, the last one cut."""
    (_, alone), (_, params) = medjax.make("paper"), agents_of("paper")
    assert PPOConfig().for_episodes(0).rollout_length == 600
    assert PPOConfig(agents="ippo").for_episodes(0).rollout_length == 150
    assert PPOConfig().choices_per_update == int(alone.episode_decisions)
    assert PPOConfig(agents="ippo").choices_per_update == int(params.episode_decisions)
    assert PPOConfig(agents="ippo", rollout_length=50).choices_per_update == 50
    assert PPOConfig(decide_every=10).for_episodes(600).choices_per_update == 60
    assert PPOConfig().for_episodes(360).choices_per_update == 360
    assert PPOConfig(decide_every=7).for_episodes(360).choices_per_update == 52
    assert PPOConfig(rollout_length=50).for_episodes(360).choices_per_update == 50


def test_the_former_name_is_accepted_and_says_the_new_one(capsys):
    """From Python, in a file, and on the command line; one line names the new one."""
    option._say_once.cache_clear()
    config = PPOConfig(policy_prior="wait")
    assert PPOConfig(start="wait") == config
    assert dataclasses.replace(PPOConfig(), start="wait") == config
    assert from_json({"start": "wait"}, PPOConfig) == config
    assert parse_request(PPOConfig, ["--start=wait"]).config == config
    assert "start" not in to_json(config)
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("start is now policy_prior")

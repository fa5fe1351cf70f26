"""Pretrained policies load, describe their training, and play in environments that they fit."""

import json
import re
import zipfile

import jax
import numpy as np
import pytest

import medjax
from medjax.errors import InputError
from medjax.policies.given import as_policy
from medjax.policies.pretrained import FILES
from medjax.scenarios import prepare
from tests.refusals import refused

SCENARIOS = sorted(path.stem for path in FILES.glob("*.zip"))


def test_presets_with_a_pretrained_policy():
    assert SCENARIOS == ["corridor", "paper"]


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_card_says_how_it_was_trained(scenario):
    """Settings, seed, commit and evaluation; the file is small."""
    about = medjax.load_pretrained(scenario).about
    settings = about.training["settings"]
    assert (about.scenario, settings["scenario"]) == (scenario, scenario)
    assert not about.overrides
    assert settings["total_timesteps"] > 0
    assert settings["seed"] >= 0
    commit = about.training["versions"]["commit"]
    assert len(commit) >= 7
    assert "changes" not in commit
    played = about.training["evaluation"]
    assert played["episodes"] >= 16
    for name in ("ppo", "budgeted", "none"):
        low, high = played["policies"][name]["return_ci95"]
        assert low < played["policies"][name]["return_mean"] < high
    path = FILES / f"{scenario}.zip"
    assert path.stat().st_size < 300_000
    with zipfile.ZipFile(path) as file:
        assert json.loads(file.read("policy.json"))["training"] == about.training
        for name in file.namelist():
            # Debug information would name files of the machine that exported the network.
            assert not re.search(rb"\.py\b|site-packages", file.read(name)), name


def test_repr_is_one_line():
    env, _ = medjax.make("paper")
    policy = medjax.load_pretrained("paper")
    assert repr(policy) == "<ppo: trained on paper, 244 features, 5 actions>"
    assert len(repr(policy.policy(env))) < 80


@pytest.mark.parametrize("action", [1.5, np.zeros((2, 2), int)])
def test_a_function_that_returns_no_action_is_refused(action):
    env, *_ = prepare("paper")
    with pytest.raises(InputError, match="a policy returned"):
        as_policy(env, lambda *given: action)(jax.random.key(0), None, None, None)


def test_a_function_that_builds_no_policy_is_refused():
    env, *_ = prepare("paper")
    with pytest.raises(InputError, match="policy 'math:sqrt' failed to build: TypeError"):
        as_policy(env, "math:sqrt")


@pytest.mark.usefixtures("quick_compiles")
def test_plays_by_name_in_environments_that_it_fits():
    """It computes its own observation if the environment has another."""
    env, params = medjax.make("paper")
    act = jax.jit(as_policy(env, "pretrained"))
    obs, state = jax.jit(env.reset)(jax.random.key(0), params)
    choice = act(jax.random.key(1), obs, state, params)
    assert choice.probabilities.shape == (env.num_actions,)
    assert float(choice.probabilities.sum()) == pytest.approx(1.0, abs=1e-5)
    seen, numbers = medjax.make("paper", observation="profile")
    same = jax.jit(as_policy(seen, "pretrained"))
    obs, state = jax.jit(seen.reset)(jax.random.key(0), numbers)
    again = same(jax.random.key(1), obs, state, numbers)
    np.testing.assert_allclose(choice.probabilities, again.probabilities, atol=1e-6)
    three, *_ = prepare("paper", num_ramps=3)
    with pytest.raises(InputError, match="features"):
        as_policy(three, "pretrained")
    refused(lambda: medjax.load_pretrained("moon"), "moon", "paper")
    refused(lambda: medjax.load_pretrained(["paper"]), "['paper']", "paper")


@pytest.mark.usefixtures("quick_compiles")
def test_sampled_it_draws_from_its_probabilities():
    """While it is unsure it does not always do what is most probable, and never what is not allowed."""
    env, params = medjax.make("paper", observation="profile")
    policy, drawn = as_policy(env, "pretrained"), as_policy(env, "pretrained_sampled")

    @jax.jit
    def play(key):
        def decide(state, key):
            obs, mask = env.get_obs(state, params), env.action_mask(state, params)
            likely, sampled = (each(key, obs, state, params) for each in (policy, drawn))
            after = env.step_env(key, state, likely.action, params)[1]
            return after, (likely, sampled, mask)

        first, key = jax.random.split(key)
        return jax.lax.scan(decide, env.reset(first, params)[1], jax.random.split(key, 600))[1]

    likely, sampled, mask = jax.tree.map(
        np.asarray, jax.vmap(play)(jax.random.split(jax.random.key(2), 32))
    )
    np.testing.assert_array_equal(likely.probabilities, sampled.probabilities)
    others = 1.0 - likely.probabilities.max(-1)
    unlike = likely.action != sampled.action
    spread = np.sqrt((others * (1.0 - others)).sum())
    assert others.sum() > 5 * spread  # so that a policy that never draws would fail
    assert abs(unlike.sum() - others.sum()) < 5 * spread
    assert np.take_along_axis(mask, sampled.action[..., None], -1).all()

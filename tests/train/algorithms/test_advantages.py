"""GAE against a float64 recursion written the other way round: from the definition, episode by episode."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from train.algorithms.advantages import (
    Steps,
    generalized_advantages,
    leave_one_out_baseline,
    needs_bootstrap,
)

STEPS = 24
estimate = jax.jit(generalized_advantages)


def by_definition(rollout, last_value, gamma, lam):
    """A_t = sum_k (gamma lam)^k delta_{t+k}, the sum ending with the episode."""
    reward, value, terminated, truncated, final_value = (
        np.asarray(x) for x in vars(rollout).values()
    )
    steps, envs = reward.shape
    out = np.zeros((steps, envs))
    for env in range(envs):
        for start in range(steps):
            weight = 1.0
            for t in range(start, steps):
                follow = value[t + 1, env] if t + 1 < steps else last_value[env]
                if terminated[t, env]:
                    follow = 0.0
                elif truncated[t, env]:
                    follow = final_value[t, env]
                out[start, env] += weight * (reward[t, env] + gamma * follow - value[t, env])
                if terminated[t, env] or truncated[t, env]:
                    break
                weight *= gamma * lam
    return out


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    gamma=st.floats(0.0, 1.0),
    lam=st.floats(0.0, 1.0),
    often=st.sampled_from([0.0, 0.1, 0.5, 1.0]),
)
def test_equals_the_definition(seed, gamma, lam, often):
    rng = np.random.default_rng(seed)
    shape = (STEPS, 3)
    reward, value, final_value = rng.normal(size=(3, *shape))
    last_value = rng.normal(size=3)
    terminated, truncated = rng.random((2, *shape)) < often
    rollout = Steps(reward, value, terminated, truncated, final_value)
    expected = by_definition(rollout, last_value, gamma, lam)
    advantage, target = estimate(rollout, last_value, gamma=gamma, gae_lambda=lam)
    np.testing.assert_allclose(advantage, expected, rtol=2e-5, atol=2e-5)
    np.testing.assert_allclose(target, expected + value, rtol=2e-5, atol=2e-5)


def test_nothing_leaks_over_the_end_of_an_episode():
    zeros = jnp.zeros((4, 1))
    reward = zeros.at[3].set(100.0)  # of the next episode
    ends = jnp.zeros((4, 1), bool).at[1].set(True)
    never = jnp.zeros((4, 1), bool)
    for terminated, truncated in ((ends, never), (never, ends)):
        rollout = Steps(reward, zeros, terminated, truncated, zeros)
        advantage, _ = generalized_advantages(rollout, zeros[0], gamma=0.9, gae_lambda=0.9)
        np.testing.assert_array_equal(advantage[:2], 0.0)
        assert (advantage[2:] > 0.0).all()


def test_lambda_one_gives_discounted_returns_bootstrapped_at_a_truncation():
    reward = jnp.ones((3, 1))
    zeros, never = jnp.zeros((3, 1)), jnp.zeros((3, 1), bool)
    cut = never.at[2].set(True)
    rollout = Steps(reward, zeros, never, cut, zeros + 10.0)
    _, target = generalized_advantages(rollout, zeros[0] + 7.0, gamma=0.5, gae_lambda=1.0)
    np.testing.assert_allclose(target[:, 0], [1.75 + 1.25, 1.5 + 2.5, 1.0 + 5.0])


def test_leave_one_out_baseline_removes_what_a_group_shares():
    """By loops; and whatever is added to a whole group at a step changes nothing."""
    rng = np.random.default_rng(0)
    advantage = rng.normal(size=(6, 4)).astype(np.float32)
    got = np.asarray(leave_one_out_baseline(jnp.asarray(advantage), 3))
    for env in range(6):
        first = env // 3 * 3
        others = [advantage[other] for other in range(first, first + 3) if other != env]
        np.testing.assert_allclose(got[env], advantage[env] - np.mean(others, axis=0), atol=1e-6)
    luck = np.repeat(10.0 * rng.normal(size=(2, 4)), 3, axis=0)
    np.testing.assert_allclose(
        leave_one_out_baseline(jnp.asarray(advantage + luck), 3), got, atol=1e-5
    )
    np.testing.assert_array_equal(leave_one_out_baseline(jnp.asarray(advantage), 1), advantage)


def test_bootstrap_is_needed_where_values_of_other_steps_do_not_cancel():
    """Rollouts that end with a termination, with a truncation, within an episode, and with a truncation inside."""
    rng = np.random.default_rng(5)
    reward, value, final_value = jnp.asarray(rng.normal(size=(3, 6, 4)), jnp.float32)
    terminated = jnp.zeros((6, 4), bool).at[5, 0].set(True).at[2, 0].set(True).at[5, 3].set(True)
    truncated = jnp.zeros((6, 4), bool).at[5, 0].set(True).at[5, 1].set(True).at[1, 3].set(True)
    steps = Steps(reward, value, terminated, truncated, final_value)
    own = jnp.arange(6)[:, None] == 3  # the step with a choice

    def advantage(last_value, others, gae_lambda):
        changed = Steps(
            reward, jnp.where(own, value, others), terminated, truncated, final_value + others
        )
        advantages = generalized_advantages(changed, last_value, gamma=0.9, gae_lambda=gae_lambda)[
            0
        ]
        return advantages[0] + jnp.where(own, 0.0, changed.value)[0], advantages[3]

    for gae_lambda in (0.5, 1.0):
        everywhere = needs_bootstrap(steps, gae_lambda)
        zeros, ones = (
            advantage(jnp.zeros(4), 0.0, gae_lambda),
            advantage(jnp.ones(4), 1.0, gae_lambda),
        )
        depends = np.abs(np.subtract(zeros, ones)).max(axis=0) > 1e-5
        np.testing.assert_array_equal(everywhere, depends)

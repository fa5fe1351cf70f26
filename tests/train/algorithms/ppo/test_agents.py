"""Agents that learn together: credit goes to whom it is due, each by its own mask, in closed form.

Probes of three agents; every array of theirs has an axis of agents first.
"""

import dataclasses
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from tests.train.algorithms.ppo.test_learner import GAMMA, learn
from train.algorithms.networks import apply_policy

pytestmark = pytest.mark.usefixtures("quick_compiles")

AGENTS = 3


@struct.dataclass
class TeamState:
    """State of a probe."""

    time: jax.Array  # () int32
    cues: jax.Array  # (AGENTS,) -1 or 1


@dataclasses.dataclass(frozen=True)
class Team:
    """Agents that see their cue, their number and the time; action 1 is right on a cue of 1, else 0.

    own: one step; agent i gets i + 1 if it is right, and nothing for others.
    shared: one step; all get the number of agents that are right.
    masked: as `own`, but agent 2 may do nothing but 0, and 2 pays everybody and is forbidden to all.
    leaves: two steps; agent 0 is paid for being right in both, and has no choice in the second, when it is gone.
    """

    kind: str
    num_actions: int = 3
    observation: Any = None
    name: str = "team"

    def observation_space(self, params):
        return SimpleNamespace(shape=(AGENTS + 2,))

    def _observe(self, state):
        time = jnp.full((AGENTS, 1), state.time, jnp.float32)
        return jnp.concatenate([state.cues[:, None], jnp.eye(AGENTS), time], axis=1)

    def action_mask(self, state, params):
        mask = jnp.ones((AGENTS, self.num_actions), bool).at[:, 2].set(False)
        if self.kind == "masked":
            mask = mask.at[2, 1].set(False)
        if self.kind == "leaves":
            gone = (jnp.arange(AGENTS) == 0) & (state.time == 1)
            mask = mask.at[:, 1].set(~gone)
        return mask

    def _draw(self, key):
        return jnp.where(jax.random.bernoulli(key, 0.5, (AGENTS,)), 1.0, -1.0)

    def reset(self, key, params):
        state = TeamState(jnp.int32(0), self._draw(key))
        return self._observe(state), state

    def step_env(self, key, state, action, params):
        right = ((action == 1) == (state.cues > 0)).astype(jnp.float32)
        due = right * (1.0 + jnp.arange(AGENTS))
        if self.kind == "shared":
            due = jnp.full((AGENTS,), right.sum())
        if self.kind == "leaves":
            due = jnp.full((AGENTS,), right[0])
        due = due + 10.0 * jnp.any(action == 2)
        ends = state.time + 1 >= (2 if self.kind == "leaves" else 1)
        after = TeamState(state.time + 1, self._draw(key))
        info = {"metrics": {"right": right.sum()}, "rewards": due}
        return self._observe(after), after, due.sum(), ends, jnp.bool_(False), info


def solved(kind, updates=150):
    """Values and probabilities of agents at cues of -1 and of 1, `(2, AGENTS)` and `(2, AGENTS, actions)`."""
    env = Team(kind)
    state, network, metrics = learn(env, updates, stagger=False)
    values, rows = [], []
    for cue in (-1.0, 1.0):
        for time in (0, 1):
            own = TeamState(jnp.int32(time), jnp.full((AGENTS,), cue))
            mask = env.action_mask(own, None)
            policy, value = apply_policy(network, state.weights, env._observe(own), mask)
            values.append(value)
            rows.append(policy.probs)
    shape = (2, 2, AGENTS)
    return (
        np.reshape(np.asarray(values), shape),
        np.reshape(np.asarray(rows), (*shape, -1)),
        metrics,
    )


def test_each_is_paid_for_its_own():
    """Every agent is right, and its value is what it alone is paid: 1, 2, 3."""
    values, probs, _ = solved("own")
    assert (probs[0, 0, :, 0] > 0.98).all()
    assert (probs[1, 0, :, 1] > 0.98).all()
    np.testing.assert_allclose(values[:, 0], [[1.0, 2.0, 3.0]] * 2, rtol=0.06)


def test_the_team_is_paid_alike():
    """By a reward that others' luck is in each still learns its own part, and all values are the team's."""
    values, probs, _ = solved("shared", updates=300)
    assert (probs[0, 0, :, 0] > 0.95).all()
    assert (probs[1, 0, :, 1] > 0.95).all()
    np.testing.assert_allclose(values[:, 0], 3.0, rtol=0.06)


def test_masks_are_each_agent_s_own():
    """Whom a mask leaves one action takes it on either cue; nobody takes what is forbidden to all."""
    values, probs, metrics = solved("masked")
    np.testing.assert_array_equal(probs[..., 2], 0.0)
    np.testing.assert_array_equal(probs[:, :, 2, 0], 1.0)
    assert (probs[1, 0, :2, 1] > 0.98).all()
    np.testing.assert_allclose(values[:, 0, 2], [3.0, 0.0], atol=0.2)
    assert np.nanmax(np.asarray(metrics["episode_return"])) <= 6.0  # the forbidden action pays 30


def test_who_is_gone_still_gets_what_the_team_gets():
    """Without a choice in the second step agent 0 is right in half the cases; all know that before, and after."""
    values, probs, _ = solved("leaves", updates=300)
    assert probs[0, 0, 0, 0] > 0.95
    assert probs[1, 0, 0, 1] > 0.95
    np.testing.assert_array_equal(probs[:, 1, 0, 0], 1.0)
    np.testing.assert_allclose(values[:, 0, 0], 1.0 + GAMMA * 0.5, rtol=0.08)
    # Its own cue says what comes; the others do not see it.
    np.testing.assert_allclose(values[:, 1, 0], [1.0, 0.0], atol=0.1)
    np.testing.assert_allclose(values[:, 1, 1:], 0.5, atol=0.15)

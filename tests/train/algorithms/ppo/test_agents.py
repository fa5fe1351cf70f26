"""Agents that learn together: each is paid what is due to it and acts by its own mask, in closed form.

Probes of three agents; every array of theirs has an axis of agents first.
"""

import dataclasses
import functools
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from tests.train.algorithms.ppo.test_learner import GAMMA, learner

pytestmark = pytest.mark.usefixtures("quick_compiles")

AGENTS = 3
# own: one step; agent i gets i + 1 if it is right, and nothing for others.
# shared: one step; all get the number of agents that are right.
# masked: as `own`, but agent 2 may do nothing but 0, and 2 pays everybody and is forbidden to all.
# leaves: two steps; agent 0 is paid for being right in both, and has no choice in the second, when it is gone.
KINDS = ("own", "shared", "masked", "leaves")


@struct.dataclass
class TeamState:
    """State of a probe."""

    time: jax.Array  # () int32
    cues: jax.Array  # (AGENTS,) -1 or 1


@dataclasses.dataclass(frozen=True)
class Team:
    """Agents that see their cue, their number and the time; action 1 is right on a cue of 1, else 0.

    All of `KINDS` in one program: parameters are the index of one.
    """

    num_actions: int = 3
    observation: Any = None
    name: str = "team"

    def observation_space(self, params):
        return SimpleNamespace(shape=(AGENTS + 2,))

    def observe(self, state):
        time = jnp.full((AGENTS, 1), state.time, jnp.float32)
        return jnp.concatenate([state.cues[:, None], jnp.eye(AGENTS), time], axis=1)

    def action_mask(self, state, kind):
        agent = jnp.arange(AGENTS)
        gone = (kind == KINDS.index("leaves")) & (agent == 0) & (state.time == 1)
        tied = (kind == KINDS.index("masked")) & (agent == 2)
        no = jnp.zeros(AGENTS, bool)
        return jnp.stack([~no, ~(gone | tied), no], axis=1)

    def _draw(self, key):
        return jnp.where(jax.random.bernoulli(key, 0.5, (AGENTS,)), 1.0, -1.0)

    def reset(self, key, kind):
        state = TeamState(jnp.int32(0), self._draw(key))
        return self.observe(state), state

    def step_env(self, key, state, action, kind):
        right = ((action == 1) == (state.cues > 0)).astype(jnp.float32)
        own = right * (1.0 + jnp.arange(AGENTS))
        alike = [jnp.broadcast_to(each, (AGENTS,)) for each in (right.sum(), right[0])]
        due = jnp.stack([own, alike[0], own, alike[1]])[kind] + 10.0 * jnp.any(action == 2)
        ends = state.time + 1 >= jnp.where(kind == KINDS.index("leaves"), 2, 1)
        after = TeamState(state.time + 1, self._draw(key))
        info = {"metrics": {"right": right.sum()}, "rewards": due}
        return self.observe(after), after, due.sum(), ends, jnp.bool_(False), info


@pytest.fixture(scope="module")
def solve():
    """Of a kind: values `(cue, time, AGENTS)`, probabilities `(cue, time, AGENTS, actions)`, and metrics."""
    env = Team()
    learn = functools.cache(lambda updates: learner(env, jnp.int32(0), updates, stagger=False))

    def solved(name, updates=150):
        kind = jnp.int32(KINDS.index(name))
        act, metrics = learn(updates)(kind)
        cues = jnp.broadcast_to(jnp.array([-1.0, -1.0, 1.0, 1.0])[:, None], (4, AGENTS))
        states = TeamState(jnp.array([0, 1, 0, 1]), cues)
        obs = jax.vmap(env.observe)(states)
        mask = jax.vmap(env.action_mask, (0, None))(states, kind)
        policy, value = act(obs, mask)
        shape = (2, 2, AGENTS)
        return np.reshape(value, shape), np.reshape(policy.probs, (*shape, -1)), metrics

    return solved


@pytest.mark.thorough
def test_each_is_paid_for_its_own(solve):
    """Every agent is right, and its value is what it alone is paid: 1, 2, 3."""
    values, probs, _ = solve("own")
    assert (probs[0, 0, :, 0] > 0.98).all()
    assert (probs[1, 0, :, 1] > 0.98).all()
    np.testing.assert_allclose(values[:, 0], [[1.0, 2.0, 3.0]] * 2, rtol=0.06)


def test_the_team_is_paid_alike(solve):
    """Each learns its own part from a reward that includes others' luck, and all values are the team's."""
    values, probs, _ = solve("shared", updates=300)
    assert (probs[0, 0, :, 0] > 0.95).all()
    assert (probs[1, 0, :, 1] > 0.95).all()
    np.testing.assert_allclose(values[:, 0], 3.0, rtol=0.06)


def test_each_agent_has_its_own_mask(solve):
    """An agent with one allowed action takes it on either cue; nobody takes what is forbidden to all."""
    values, probs, metrics = solve("masked")
    np.testing.assert_array_equal(probs[..., 2], 0.0)
    np.testing.assert_array_equal(probs[:, :, 2, 0], 1.0)
    assert (probs[1, 0, :2, 1] > 0.98).all()
    np.testing.assert_allclose(values[:, 0, 2], [3.0, 0.0], atol=0.2)
    assert np.nanmax(np.asarray(metrics["episode_return"])) <= 6.0  # the forbidden action pays 30


def test_an_agent_that_left_still_gets_the_teams_reward(solve):
    """Agent 0 has no choice in the second step and is right half the time, which every agent's value includes."""
    values, probs, _ = solve("leaves", updates=300)
    assert probs[0, 0, 0, 0] > 0.95
    assert probs[1, 0, 0, 1] > 0.95
    np.testing.assert_array_equal(probs[:, 1, 0, 0], 1.0)
    np.testing.assert_allclose(values[:, 0, 0], 1.0 + GAMMA * 0.5, rtol=0.08)
    # Its own cue says what comes; the others do not see it.
    np.testing.assert_allclose(values[:, 1, 0], [1.0, 0.0], atol=0.1)
    np.testing.assert_allclose(values[:, 1, 1:], 0.5, atol=0.15)

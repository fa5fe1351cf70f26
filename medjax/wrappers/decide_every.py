"""Choices that last for several decisions."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from medjax.env.contract import Info, Params, State, StepResult
from medjax.env.wrapper import Wrapper, whole_number_of
from medjax.numerics import loops


@dataclasses.dataclass(frozen=True)
class DecideEvery(Wrapper):
    """`env` for a policy that chooses at every `interval`-th decision; action 0 is taken in between.

    A step covers a choice and all decisions up to the next one, as in a semi-Markov decision process (Sutton, Precup
    and Singh 1999), so waiting means waiting for the whole interval. If waiting pays only over several decisions, a
    policy that chooses at each of them sees almost no gain from a single wait, and does not learn to wait.

    Attributes:
        interval: decisions from one choice to the next, at least 1.

    Raises:
        InputError: the interval is out of its range.
    """

    interval: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        whole_number_of("interval", self.interval, 1)

    @property
    def decisions_per_step(self) -> int:
        """Highway decisions from one choice to the next."""
        return self.interval * self.env.decisions_per_step

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> StepResult:
        """Takes the action, then action 0 until the next choice or the end of the episode.

        Returns:
            obs, state, reward, terminated, truncated, info of the last decision. The reward and the entries ADDED of
            info are sums over all decisions. The probe's entries cover all decisions; after the end of an episode
            they are meaningless.
        """
        action = jnp.asarray(action, jnp.int32)
        actions = jnp.zeros((self.interval, *action.shape), jnp.int32).at[0].set(action)
        steps = (jax.random.split(key, self.interval), actions)
        shapes = jax.eval_shape(self.env.step_env, key, state, actions[0], params)
        obs, _, *rest, info = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        _split(info)

        def decide(
            before: StepResult, step: tuple[jax.Array, jax.Array]
        ) -> tuple[StepResult, Info]:
            """Takes one decision; a finished episode stays unchanged."""
            _, state, total, terminated, truncated, sums = before
            obs, state, reward, *ends, info = self.env.step_env(step[0], state, step[1], params)
            probed = _split(info)
            added = {name: info[name] for name in ADDED if name in info}
            info |= jax.tree.map(jnp.add, {name: sums[name] for name in added}, added)
            after: StepResult = (obs, state, total + reward, *ends, info)
            over = terminated | truncated
            return jax.tree.map(lambda old, new: jnp.where(over, old, new), before, after), probed

        first: Any = (obs, state, *rest, info)
        (*last, info), probed = loops.scan(decide, first, steps)
        joined = jax.tree.map(lambda each: each.reshape(-1, *each.shape[2:]), probed)
        return *last, info | joined


ADDED = (
    "reward_terms",
    "step_stats",
    "tally",
    "rewards",
)  # entries of info that are summed over decisions
PROBED = ("begun", "ticks")  # entries of info that are concatenated over decisions


def _split(info: Info) -> Info:
    """Removes the probe's entries from `info` and returns them."""
    return {name: info.pop(name) for name in PROBED if name in info}

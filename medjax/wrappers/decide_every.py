"""Choices that stand for several decisions."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from medjax.env.contract import Info, Params, State, StepResult
from medjax.env.wrapper import Wrapper, whole_number_of


@dataclasses.dataclass(frozen=True)
class DecideEvery(Wrapper):
    """`env` for a policy that chooses at every `interval`-th decision; action 0 is taken in between.

    A step is a choice and the decisions up to the next one, as in a semi-Markov decision process (Sutton, Precup and
    Singh 1999): to wait then means to wait for the whole interval. Where waiting pays only if the next decisions wait
    too, a policy that may change its mind at each of them gains next to nothing by it, and does not learn to wait.

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
        """Decisions of the highway from one choice to the next."""
        return self.interval * self.env.decisions_per_step

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> StepResult:
        """The action, then action 0, until the next choice or the end of the episode.

        Returns:
            obs, state, reward, terminated, truncated, info of the last decision; but the reward and what of info adds
            up are sums over all, and what a probe reports is of all, which after the end of an episode means nothing.
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
            """One decision; what is over stays as it is."""
            _, state, total, terminated, truncated, sums = before
            obs, state, reward, *ends, info = self.env.step_env(step[0], state, step[1], params)
            probed = _split(info)
            added = {name: info[name] for name in ADDED if name in info}
            info |= jax.tree.map(jnp.add, {name: sums[name] for name in added}, added)
            after: StepResult = (obs, state, total + reward, *ends, info)
            over = terminated | truncated
            return jax.tree.map(lambda old, new: jnp.where(over, old, new), before, after), probed

        first: Any = (obs, state, *rest, info)
        (*last, info), probed = lax.scan(decide, first, steps)
        joined = jax.tree.map(lambda each: each.reshape(-1, *each.shape[2:]), probed)
        return *last, info | joined


ADDED = ("reward_terms", "tally", "rewards")  # of info: sums over decisions
PROBED = ("begun", "ticks")  # of info: those of all, one after the other


def _split(info: Info) -> Info:
    """What a probe reports, taken out of `info`."""
    return {name: info.pop(name) for name in PROBED if name in info}

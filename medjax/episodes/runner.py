"""Runs whole episodes, for evaluation, recordings, traces and studies.

Each row of a batch is an episode and uses that episode's random streams (`medjax.episodes.keys`): decision t uses
`fold_in(stream, t)`. All policies thus face the same episode, so their scores differ only through their choices.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jax import lax

from medjax.env.contract import Environment
from medjax.env.dispatch import is_allowed
from medjax.episodes.keys import ACT, RESET, STEP
from medjax.errors import InputError
from medjax.policies.policy import Choice, Policy


class Episodes(struct.PyTreeNode):
    """Progress of a batch of episodes; axis 0 of every leaf is the row."""

    streams: jax.Array  # (rows, 3) keys, see `medjax.episodes.keys`
    obs: Any
    state: Any
    done: jax.Array  # (rows,) bool
    # (rows,) float32: "return", "length", "reward_NAME" for each reward term, and the environment's metrics
    scores: dict[str, jax.Array]


class Decision(struct.PyTreeNode):
    """The decision of every row and its outcome."""

    # (rows,) int32, as the policy chose; a masked action counts as 0. With A agents, here and below, (rows, A, ...).
    action: jax.Array
    probabilities: jax.Array  # (rows, num_actions) of the policy
    mask: jax.Array  # (rows, num_actions) bool, allowed actions
    reward: jax.Array  # (rows,)
    info: dict[str, Any]  # of the environment's step

    def of_dispatcher(self, num_actions: int) -> "Decision":
        """Reduces agents' decisions to a dispatcher's: that of an agent that entered, else of one that could have."""
        if self.action.ndim == 1:
            return self
        enters = self.mask[..., 1:num_actions].any(axis=-1)  # at most one agent per depot
        counts = is_allowed(self.action, self.mask) & (self.action < num_actions)
        ramp = jnp.where(counts, self.action, 0)
        first = jnp.argmax(jnp.where(enters, ramp, -1), axis=-1)[:, None]
        action = jnp.take_along_axis(self.action, first, axis=1)[:, 0]
        rows = [
            jnp.take_along_axis(each, first[..., None], axis=1)[:, 0, :num_actions]
            for each in (self.probabilities, self.mask)
        ]
        free = enters.any(axis=-1)
        action = jnp.where(free & (action < num_actions), action, 0)
        waits = jax.nn.one_hot(jnp.zeros_like(action), num_actions, dtype=jnp.float32)
        probabilities = jnp.where(free[:, None], rows[0], waits)
        mask = jnp.where(free[:, None], rows[1], waits > 0.0)
        return self.replace(action=action, probabilities=probabilities, mask=mask)


class EpisodeRunner:
    """Plays several policies in one batch: policy `r % len(policies)` plays row r.

    The environment compiles once for all policies, and they share the fixed cost of a decision. Every decision takes
    the weights as arguments, so that the compiled program does not contain them.

    Args:
        env: a single environment.
        policies: at least one. The runner does not read their own weights. Each policy plays in the world that its
            `Policy.params_transform` makes of the environment's params.
    """

    def __init__(self, env: Environment, policies: Sequence[Policy]) -> None:
        self.env, self.policies = env, tuple(policies)
        # Jitted so that `start`, which needs only the shapes of the results, and `go_on` share one trace.
        self._step = jax.jit(self._over_rows(env.step_env))

    def start(self, keys: jax.Array, params: Any) -> Episodes:
        """Resets episodes with keys `(episodes,)`, one row per episode and policy.

        Returns:
            `episodes * policies` rows: all policies of the first episode, then all of the second, and so on.
        """
        streams = jax.vmap(jax.random.split, (0, None))(keys, 3)
        streams = jnp.repeat(streams, len(self.policies), axis=0)
        obs, state = self._over_rows(self.env.reset)(streams[:, RESET], params)
        mask = jax.eval_shape(self._over_rows(self.env.action_mask), state, params)
        actions = jnp.zeros(mask.shape[:-1], jnp.int32)
        *_, info = jax.eval_shape(self._step, streams[:, STEP], state, actions, params)
        names = ("return", "length", *reward_parts(info), *info["metrics"])
        return Episodes(
            streams=streams,
            obs=obs,
            state=state,
            done=jnp.zeros(streams.shape[:1], bool),
            scores=dict.fromkeys(names, jnp.zeros(streams.shape[:1], jnp.float32)),
        )

    def choose(
        self, episodes: Episodes, number: Any, weights: Sequence[Any], params: Any
    ) -> Choice:
        """The policies' choices at decision `number` of their episodes, leaves `(rows, ...)`.

        Args:
            number: () int32 for all rows, or (rows,).
            weights: of the policies.

        Raises:
            InputError: some policies are for a dispatcher and some for agents.
        """
        rows = _at(episodes.streams[:, ACT], number), episodes.obs, episodes.state
        count = len(self.policies)
        choices = []
        for index, (policy, own) in enumerate(zip(self.policies, weights, strict=True)):
            mine = jax.tree.map(lambda leaf, index=index: leaf[index::count], rows)
            choices.append(
                _over_rows(partial(policy.act, own))(*mine, policy.params_transform(params))
            )

        shapes = {choice.action.shape[1:] for choice in choices}
        if len(shapes) > 1:
            raise InputError(
                "policies of a dispatcher mixed with policies of agents: allowed one of the two"
            )

        def take_turns(*leaves: jax.Array) -> jax.Array:
            return jnp.stack(leaves, axis=1).reshape(-1, *leaves[0].shape[1:])

        return jax.tree.map(take_turns, *choices)

    def go_on(
        self, episodes: Episodes, number: Any, choice: Choice, params: Any
    ) -> tuple[Episodes, Decision]:
        """Takes decision `number` in every row; finished episodes keep their scores.

        Args:
            episodes: their progress.
            number: as in `choose`.
            choice: leaves `(rows, ...)`.
            params: of the environment.
        """
        mask = self._over_rows(self.env.action_mask)(episodes.state, params)
        action = choice.action.astype(jnp.int32)
        allowed = jnp.take_along_axis(mask, action[..., None], axis=-1, mode="clip")[..., 0]
        taken = jnp.where(allowed, action, 0)  # action 0 is always allowed
        keys = _at(episodes.streams[:, STEP], number)
        obs, state, reward, terminated, truncated, info = self._step(
            keys, episodes.state, taken, params
        )
        live, scores = ~episodes.done, episodes.scores
        now = {
            "return": scores["return"] + reward.astype(jnp.float32),
            "length": scores["length"] + 1.0,
            **{name: scores[name] + part for name, part in reward_parts(info).items()},
            **{name: value.astype(jnp.float32) for name, value in info["metrics"].items()},
        }
        after = Episodes(
            streams=episodes.streams,
            obs=obs,
            state=state,
            done=episodes.done | terminated | truncated,
            scores={name: jnp.where(live, now[name], old) for name, old in scores.items()},
        )
        return after, Decision(action, choice.probabilities, mask, reward, info)

    def decide(
        self, episodes: Episodes, number: Any, weights: Sequence[Any], params: Any
    ) -> tuple[Episodes, Decision]:
        """Takes decision `number` in every row as its policy chooses: `choose`, then `go_on`."""
        return self.go_on(episodes, number, self.choose(episodes, number, weights, params), params)

    def to_end(
        self, episodes: Episodes, weights: Sequence[Any], params: Any, most: int
    ) -> Episodes:
        """Plays episodes from their first decision until all are over, for at most `most` decisions."""

        def unfinished(carry: tuple[Episodes, jax.Array]) -> jax.Array:
            episodes, number = carry
            return (number < most) & ~jnp.all(episodes.done)

        def decide(carry: tuple[Episodes, jax.Array]) -> tuple[Episodes, jax.Array]:
            episodes, number = carry
            return self.decide(episodes, number, weights, params)[0], number + 1

        return lax.while_loop(unfinished, decide, (episodes, jnp.int32(0)))[0]

    def _over_rows(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Maps `function(*row, params)` over rows, each with the params of its policy's world."""

        def mapped(*given: Any) -> Any:
            """Takes leaves `(rows, ...)`, then the environment's params; returns leaves `(rows, ...)`."""
            *rows, params = given
            first, *others = (policy.params_transform(params) for policy in self.policies)
            turns = jax.tree.leaves(rows)[0].shape[0] // len(self.policies)
            # Batch only the numbers that differ between worlds. The worlds share the others, such as the coils' table.
            numbers = jax.tree.map(lambda *leaves: _in_turn(leaves, turns), first, *others)
            axes = jax.tree.map(lambda *leaves: 0 if _differ(leaves) else None, first, *others)
            return _over_rows(function, axes)(*rows, numbers)

        return mapped


def reward_parts(info: dict[str, Any]) -> dict[str, jax.Array]:
    """The weighted reward terms of a step as scores named `reward_NAME`; empty if the step reports none."""
    return {f"reward_{name}": part for name, part in info.get("reward_terms", {}).items()}


def _differ(leaves: Sequence[Any]) -> bool:
    """Whether any policy's world replaces this number."""
    return any(leaf is not leaves[0] for leaf in leaves)


def _in_turn(leaves: Sequence[Any], turns: int) -> Any:
    """One number from several policies' worlds: one value per row if they differ, else the shared value."""
    if not _differ(leaves):
        return leaves[0]
    stacked = jnp.stack([jnp.asarray(leaf, jnp.result_type(leaves[0])) for leaf in leaves])
    return jnp.tile(stacked, (turns, *[1] * (stacked.ndim - 1)))


def _over_rows(function: Callable[..., Any], axes: Any = None) -> Callable[..., Any]:
    """Maps `function(*row, params)` over rows. A single row runs without `jax.vmap`, which compiles faster.

    Args:
        function: of one row.
        axes: of params, as in `jax.vmap`; unused for a single row, whose params have no row axis.
    """

    def mapped(*given: Any) -> Any:
        *rows, params = given
        if jax.tree.leaves(rows)[0].shape[0] != 1:
            return jax.vmap(function, (*[0] * len(rows), axes))(*rows, params)
        row = jax.tree.map(lambda leaf: leaf[0], rows)
        return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], function(*row, params))

    return mapped


def _at(streams: jax.Array, number: Any) -> jax.Array:
    """Keys `(rows,)` of a decision, derived from streams `(rows,)`."""
    return jax.vmap(jax.random.fold_in, (0, 0 if jnp.ndim(number) else None))(streams, number)


def episode_decisions(params: Any) -> int:
    """Decisions until the environment truncates an episode; 0 if the parameters do not say."""
    return int(getattr(params, "episode_decisions", 0))


def episode_steps(env: Environment, params: Any) -> int:
    """Steps of the environment in the longest episode."""
    return -(-episode_decisions(params) // env.decisions_per_step)

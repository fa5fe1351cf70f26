"""Scores several policies on the same whole episodes, with common random numbers."""

import contextlib
import sys
import time
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import numpy as np

from medjax.commandline import SECONDS_PER_LINE, time_left
from medjax.env.contract import Environment
from medjax.episodes.duration import reckoned_time
from medjax.episodes.keys import episode_keys
from medjax.episodes.runner import EpisodeRunner, Episodes, episode_decisions
from medjax.errors import InputError
from medjax.numerics.compilation import compiled, computed
from medjax.numerics.devices import environment_mesh, on_devices
from medjax.numerics.rows import in_blocks, rows_that_fit
from medjax.policies.policy import Policy
from medjax.streams import shows_bars

MAX_DECISIONS = 100_000  # limit for episodes whose parameters give no length

Scores = dict[str, np.ndarray]  # "return", "length" and the environment's metrics, each (episodes,)


def make_runner(
    env: Environment, policies: Mapping[str, Policy], max_decisions: int, worlds: int = 1
) -> Any:
    """Builds the jitted program `(weights, keys (episodes,), params) -> dict of (policies, episodes)`.

    `worlds` is the number of params over which `jax.vmap` will map the program. The more worlds, the fewer episodes it
    plays at once.
    """
    runner = EpisodeRunner(env, [*policies.values()])
    count = len(runner.policies)

    def play(keys: jax.Array, same: tuple[Any, Any]) -> dict[str, jax.Array]:
        """Scores `(episodes, policies)`."""
        weights, params = same
        start = runner.start(keys, params)

        def to_end(some: Episodes) -> dict[str, jax.Array]:
            return runner.to_end(some, weights, params, max_decisions).scores

        block = rows_that_fit(start, count, worlds)
        scores = in_blocks(to_end, start, block, group=count)
        return {name: values.reshape(-1, count) for name, values in scores.items()}

    def run(weights: Any, keys: jax.Array, params: Any) -> dict[str, jax.Array]:
        scores = on_devices(environment_mesh(keys.shape[0]), play)(keys, (weights, params))
        return {name: values.T for name, values in scores.items()}

    return jax.jit(run)


class Evaluation:
    """Evaluates policies on the same episodes. The constructor compiles the program.

    Episode i and each of its decisions use the same keys for all policies, so scores differ only through the policies'
    choices. Masked actions count as 0.

    Args:
        env: a single environment, wrapped or not.
        params: its parameters.
        policies: by name. The constructor uses only the shapes of their weights.
        episodes: whole episodes per policy, at least 1.
        batch: episodes of each policy that play side by side. It changes results only by rounding.
    """

    def __init__(
        self,
        env: Environment,
        params: Any,
        policies: Mapping[str, Policy],
        episodes: int,
        batch: int = 128,
    ) -> None:
        self.names, self.params, self.episodes = list(policies), params, episodes
        self.batch = min(batch, episodes)
        self._most = episode_decisions(params) or MAX_DECISIONS
        runner = make_runner(env, policies, self._most)
        self._run = compiled(runner.lower(_host_weights(policies), self._keys(0)[0], params))

    def play(
        self, policies: Mapping[str, Policy], seed: int, params: Any = None
    ) -> dict[str, Scores]:
        """Plays the episodes.

        Args:
            policies: the policies of the constructor, with the weights to use.
            seed: of the episodes.
            params: to play with instead of the constructor's. They must not make episodes longer.

        Returns:
            For each policy, arrays `(episodes,)` float64 of `return`, `length` and the environment's metrics.

        Raises:
            InputError: params make longer episodes.
        """
        weights = _host_weights(policies)
        params = self.params if params is None else params
        if (length := episode_decisions(params) or MAX_DECISIONS) > self._most:
            raise InputError(
                f"episode_decisions is {length}, allowed: at most {self._most}, as compiled"
            )
        keys = self._keys(seed)
        blocks = _progress(keys, desc="episodes") if shows_bars() else _in_lines(keys, self.batch)
        parts = [jax.device_get(computed(self._run(weights, keys, params))) for keys in blocks]
        columns = jax.tree.map(lambda *each: np.concatenate(each, axis=1, dtype=np.float64), *parts)
        return {
            policy: {name: values[index, : self.episodes] for name, values in columns.items()}
            for index, policy in enumerate(self.names)
        }

    def _keys(self, seed: int) -> jax.Array:
        """Keys `(batches, batch)`. All batches are full, so one program serves; `play` discards surplus episodes."""
        batches = -(-self.episodes // self.batch)
        return episode_keys(seed, batches * self.batch).reshape(batches, self.batch)


def _host_weights(policies: Mapping[str, Policy]) -> Any:
    """Weights on the host, since training may have left them on devices that the evaluation does not use."""
    return jax.device_get(tuple(policy.weights for policy in policies.values()))


def _progress(items: Any = None, **options: Any) -> Any:
    """Shows a progress bar or line on a terminal; without tqdm, nothing."""
    try:
        from tqdm import tqdm
    except ImportError:
        return contextlib.nullcontext() if items is None else items
    return tqdm(items, disable=None, leave=False, **options)


def _in_lines(blocks: jax.Array, batch: int) -> Iterator[jax.Array]:
    """Yields the blocks of `batch` episodes. Prints progress and time left to stderr about every ten seconds."""
    begin = said = time.perf_counter()
    for done, block in enumerate(blocks):
        now = time.perf_counter()
        if done and now - said > SECONDS_PER_LINE:
            said, left_s = now, (now - begin) / done * (len(blocks) - done)
            played = f"{done * batch:,} of {len(blocks) * batch:,} episodes"
            print(f"{played} of each policy, {time_left(left_s)}", file=sys.stderr, flush=True)
        yield block


def evaluate_policies(
    env: Environment,
    params: Any,
    policies: Mapping[str, Policy],
    episodes: int,
    seed: int = 0,
    batch: int = 128,
) -> dict[str, Scores]:
    """Plays the same episodes with every policy (see `Evaluation`). If that takes long, first prints how long."""
    if takes := reckoned_time(env, episodes * len(policies) * episode_decisions(params)):
        print(f"playing takes {takes}, after compiling", file=sys.stderr, flush=True)
    with _progress(desc="compiling ...", bar_format="{desc}"):
        evaluation = Evaluation(env, params, policies, episodes, batch)
    return evaluation.play(policies, seed)

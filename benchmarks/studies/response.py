"""Tunes a rule's numbers by the returns of many variants, each played on one episode.

A group of variants plays each episode, in pairs that take opposite steps from a centre (antithetic sampling, as in
evolution strategies: Salimans et al. 2017, arXiv:1703.03864). Subtracting the group's mean return removes the effect
of the episode's demand, which is most of the variance. A quadratic in all numbers is fitted to the rest by least
squares (response surface method, Box and Wilson 1951), and the centre moves to its top.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from medjax.env.contract import Environment
from medjax.episodes.keys import episode_keys
from medjax.episodes.player import Player, episode_steps
from medjax.numerics.devices import environment_mesh, on_devices
from medjax.policies.policy import Policy

GROUP = 16  # variants that play one episode
LEAST_CURVATURE = 4.0  # of the return per step squared; keeps steps short where the fit has no top


class Responses:
    """Plays variants of a rule, each with its own numbers.

    Args:
        env: a single environment.
        params: its parameters.
        policy: any variant; its weights are a pytree of floats.
        plays: variants played at once, a multiple of GROUP.
    """

    def __init__(self, env: Environment, params: Any, policy: Policy, plays: int) -> None:
        self.plays, self.params = plays, params
        self._weights_of = ravel_pytree(policy.weights)[1]
        player, steps = Player(env, [policy]), episode_steps(env, params)

        def play(row: tuple[jax.Array, jax.Array], params: Any) -> jax.Array:
            numbers, key = row
            weights = [self._weights_of(numbers)]

            def decide(number: jax.Array, episodes: Any) -> Any:
                return player.decide(episodes, number, weights, params)[0]

            start = player.start(key[None], params)
            return jax.lax.fori_loop(0, steps, decide, start).scores["return"][0]

        def all_rows(rows: Any, params: Any) -> jax.Array:
            return jax.vmap(play, (0, None))(rows, params)

        self._play = jax.jit(on_devices(environment_mesh(plays), all_rows))

    def of(self, numbers: np.ndarray, seed: int) -> np.ndarray:
        """Returns `(groups, GROUP)` of variants `(groups, GROUP, n)`, with one episode of the seed per group."""
        keys = jnp.repeat(episode_keys(seed, numbers.shape[0]), GROUP)
        rows = jnp.asarray(numbers, jnp.float32).reshape(self.plays, -1), keys
        return np.asarray(self._play(rows, self.params), np.float64).reshape(numbers.shape[:2])

    @staticmethod
    def numbers_of(weights: Any) -> np.ndarray:
        """A pytree of weights as numbers `(n,)` float64."""
        return np.asarray(ravel_pytree(weights)[0], np.float64)

    def policy_weights(self, numbers: np.ndarray) -> Any:
        """Numbers `(n,)` as a pytree of weights."""
        return self._weights_of(jnp.asarray(numbers, jnp.float32))


def directions(rng: np.random.Generator, groups: int, size: int) -> np.ndarray:
    """Standard normal steps `(groups, GROUP, size)`; the second half of each group negates the first."""
    half = rng.standard_normal((groups, GROUP // 2, size))
    return np.concatenate([half, -half], axis=1)


def fit(steps: np.ndarray, returns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slopes `(n,)` and curvatures `(n, n)` of the returns, and the slopes' standard errors `(n,)`.

    Args:
        steps: `(groups, GROUP, n)`.
        returns: `(groups, GROUP)`.
    """
    groups, _, size = steps.shape
    one, other = np.triu_indices(size)
    terms = np.concatenate([steps, steps[..., one] * steps[..., other]], axis=2)
    terms = (terms - terms.mean(1, keepdims=True)).reshape(groups * GROUP, -1)
    own = (returns - returns.mean(1, keepdims=True)).ravel()
    found, *_ = np.linalg.lstsq(terms, own, rcond=None)
    rest = own - terms @ found
    variance = (rest @ rest) / (groups * (GROUP - 1) - terms.shape[1])
    errors = np.sqrt(variance * np.diag(np.linalg.inv(terms.T @ terms)))
    curvature = np.zeros((size, size))
    curvature[one, other] = found[size:]
    return found[:size], curvature + curvature.T, errors[:size]


def step_to_top(slope: np.ndarray, curvature: np.ndarray) -> np.ndarray:
    """The step `(n,)` to the top of the fitted surface, scaled down to at most 1 in each number."""
    bend, axes = np.linalg.eigh(curvature)
    along = (axes.T @ slope) / np.maximum(-bend, LEAST_CURVATURE)
    step = axes @ along
    return step / max(1.0, float(np.abs(step).max()))

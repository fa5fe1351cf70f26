"""Policies side by side on whole episodes with paired randomness."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import lax
from tqdm import tqdm

from medjax.episodes.keys import ACT, RESET, STEP, episode_keys
from medjax.numerics.rows import CACHED_ROWS
from medjax.wrappers import Environment, environment_mesh, on_devices
from train.algorithms.environments import episode_decisions
from train.algorithms.networks import PolicyWeights, apply_policy
from train.evaluation.statistics import bootstrap_ci95, interquartile_mean, relative_change
from train.runs.compilation import compiling

TRAINED = "ppo"
CLAIMED = ("depleted_share", "mean_range_m", "mean_soc")  # what the paper compares with no action
MAX_DECISIONS = 100_000  # of an episode whose parameters do not say how long it is

Scores = dict[str, np.ndarray]  # "return", "length" and the environment's metrics, each (episodes,)


@dataclasses.dataclass(frozen=True)
class Policy:
    """A way to act in one environment.

    Attributes:
        act: `(weights, key, obs, state, mask, params) -> () int32`; vectorised with `jax.vmap` over the middle four.
        weights: arrays it acts with; an argument of the compiled program, not a part of it.
    """

    act: Callable[[Any, jax.Array, Any, Any, jax.Array, Any], jax.Array]
    weights: Any = ()


def baseline(act: Callable[[jax.Array, Any, Any], jax.Array]) -> Policy:
    """Policy from `act(key, state, params)`, as `medjax.policies.BASELINES` build it."""
    return Policy(lambda weights, key, obs, state, mask, params: act(key, state, params))


def trained(
    network: nn.Module, weights: PolicyWeights, decide_every: int, stochastic: bool = False
) -> Policy:
    """The learned policy: its most probable action, or a sample.

    Args:
        network: the network.
        weights: what it learned.
        decide_every: decisions from one choice to the next, see `medjax.wrappers.DecideEvery`.
        stochastic: sample.
    """

    def act(
        given: PolicyWeights,
        key: jax.Array,
        obs: jax.Array,
        state: Any,
        mask: jax.Array,
        params: Any,
    ) -> jax.Array:
        """See `Policy.act`."""
        considered = mask.at[1:].set(mask[1:] & (state.time % decide_every == 0))
        distribution, _ = apply_policy(network, given, obs, considered)
        action = distribution.sample(seed=key) if stochastic else distribution.mode()
        return action.astype(jnp.int32)

    return Policy(act, weights)


@struct.dataclass
class _Episodes:
    """Where some episodes stand, each played by all policies; arrays are `(episodes * policies, ...)`."""

    obs: Any
    env: Any
    time: jax.Array  # () int32
    done: jax.Array  # bool
    total: jax.Array  # float32, return
    length: jax.Array  # int32
    metrics: dict[str, jax.Array]  # at the last decision of the episode


def make_runner(
    env: Environment, policies: Mapping[str, Policy], max_decisions: int, worlds: int = 1
) -> Any:
    """The jitted program `(weights, keys (episodes,), params) -> dict of (policies, episodes)` of whole episodes.

    All policies play side by side in one batch: the environment is compiled once, and the fixed cost of a decision is
    paid once. `worlds` is the number of params that it will be mapped over by `jax.vmap`: blocks are the smaller.
    """
    acts: list[Callable[..., Any]] = [
        jax.vmap(policy.act, (None, 0, 0, 0, 0, None)) for policy in policies.values()
    ]
    reset_all = jax.vmap(env.reset, (0, None))
    # Traced once for its shapes and its use.
    step_all = jax.jit(jax.vmap(env.step_env, (0, 0, 0, None)))

    def play(keys: jax.Array, same: tuple[Any, Any]) -> dict[str, jax.Array]:
        """Scores `(episodes, policies)`; a row of the batch plays one episode with one policy."""
        weights, params = same
        streams = jnp.repeat(jax.vmap(jax.random.split, (0, None))(keys, 3), len(acts), axis=0)

        def decide(state: _Episodes) -> _Episodes:
            """One decision in every row; what is over keeps its score."""
            now = jax.vmap(jax.vmap(jax.random.fold_in, (0, None)), (0, None))(streams, state.time)
            mask = jax.vmap(env.action_mask, (0, None))(state.env, params)
            action = choose(acts, weights, (now[:, ACT], state.obs, state.env, mask), params)
            obs, env_state, reward, terminated, truncated, info = step_all(
                now[:, STEP], state.env, action, params
            )
            live = ~state.done
            return _Episodes(
                obs=obs,
                env=env_state,
                time=state.time + 1,
                done=state.done | terminated | truncated,
                total=state.total + jnp.where(live, reward.astype(jnp.float32), 0.0),
                length=state.length + live,
                metrics={
                    name: jnp.where(live, info["metrics"][name].astype(jnp.float32), old)
                    for name, old in state.metrics.items()
                },
            )

        obs, env_state = reset_all(streams[:, RESET], params)
        actions = jnp.zeros(streams.shape[:1], jnp.int32)
        shapes = jax.eval_shape(step_all, streams[:, STEP], env_state, actions, params)
        end = lax.while_loop(
            lambda state: (state.time < max_decisions) & ~jnp.all(state.done),
            decide,
            _first(obs, env_state, list(shapes[-1]["metrics"])),
        )
        scores = {"return": end.total, "length": end.length.astype(jnp.float32), **end.metrics}
        return {name: values.reshape(-1, len(acts)) for name, values in scores.items()}

    def run(weights: Any, keys: jax.Array, params: Any) -> dict[str, jax.Array]:
        mesh = environment_mesh(keys.shape[0])
        episodes_at_once = max(1, CACHED_ROWS // (len(acts) * worlds))
        scores = on_devices(mesh, play, episodes_at_once)(keys, (weights, params))
        return {name: values.T for name, values in scores.items()}

    return jax.jit(run)


def choose(
    acts: Sequence[Callable[..., Any]], weights: Sequence[Any], rows: Any, params: Any
) -> jax.Array:
    """Actions `(rows,)` int32, each row's by its own policy; rows of all policies take turns.

    Args:
        acts: of the policies, vectorised.
        weights: theirs.
        rows: keys, observations, states and masks, leaves `(rows, ...)`.
        params: of the environment.
    """
    actions = []
    for index, (act, own) in enumerate(zip(acts, weights, strict=True)):
        mine: Any = jax.tree.map(lambda x, index=index: x[index :: len(acts)], rows)
        chosen: jax.Array = act(own, *mine, params)
        actions.append(chosen.astype(jnp.int32))
    action = jnp.stack(actions, axis=1).ravel()
    mask = rows[-1]
    allowed = jnp.take_along_axis(mask, action[:, None], axis=1, mode="clip")[:, 0]
    return jnp.where(allowed, action, 0)  # action 0 is always allowed


def _first(obs: Any, env_state: Any, metric_names: list[str]) -> _Episodes:
    """Before the first decision."""
    rows = jax.tree.leaves(obs)[0].shape[0]
    zeros = jnp.zeros((rows,), jnp.float32)
    return _Episodes(
        obs=obs,
        env=env_state,
        time=jnp.int32(0),
        done=jnp.zeros((rows,), bool),
        total=zeros,
        length=jnp.zeros((rows,), jnp.int32),
        metrics=dict.fromkeys(metric_names, zeros),
    )


class Evaluation:
    """Policies side by side on the same episodes, compiled when built.

    Episode i starts from the same key for all, and its decision t draws from the same key, so that differences between
    policies are theirs. Actions that the mask forbids count as 0.

    Args:
        env: a single environment.
        params: its parameters.
        policies: by name. Their weights are read for shapes only.
        episodes: whole episodes per policy, at least 1.
        batch: episodes of each policy played together; the result does not depend on it but for rounding.
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
        runner = make_runner(env, policies, episode_decisions(params) or MAX_DECISIONS)
        self._run = runner.lower(_host_weights(policies), self._keys(0)[0], params).compile()

    def play(
        self, policies: Mapping[str, Policy], seed: int, params: Any = None
    ) -> dict[str, Scores]:
        """Plays the episodes.

        Args:
            policies: those that this was built for, with the weights to act with.
            seed: which episodes.
            params: other numbers of the environment than those that this was built for.

        Returns:
            For each policy, arrays `(episodes,)` float64 of `return`, `length` and the environment's metrics.
        """
        weights = _host_weights(policies)
        params = self.params if params is None else params
        blocks = tqdm(self._keys(seed), "episodes", disable=None, leave=False)
        parts = [jax.device_get(self._run(weights, keys, params)) for keys in blocks]
        columns = {
            name: np.concatenate([part[name] for part in parts], axis=1)[:, : self.episodes].astype(
                np.float64
            )
            for name in parts[0]
        }
        return {
            policy: {name: values[index] for name, values in columns.items()}
            for index, policy in enumerate(self.names)
        }

    def _keys(self, seed: int) -> jax.Array:
        """Keys `(batches, batch)`: whole batches, so that one program serves; episodes too many are thrown away."""
        batches = -(-self.episodes // self.batch)
        return episode_keys(seed, batches * self.batch).reshape(batches, self.batch)


def _host_weights(policies: Mapping[str, Policy]) -> Any:
    """From the host, since training may have left them on other devices than play here."""
    return jax.device_get(tuple(policy.weights for policy in policies.values()))


def evaluate_policies(
    env: Environment,
    params: Any,
    policies: Mapping[str, Policy],
    episodes: int,
    seed: int = 0,
    batch: int = 128,
) -> dict[str, Scores]:
    """Plays the same episodes with every policy, see `Evaluation`."""
    with compiling():
        evaluation = Evaluation(env, params, policies, episodes, batch)
    return evaluation.play(policies, seed)


def summarize(scores: Mapping[str, Scores], scenario: str, seed: int = 0) -> dict[str, Any]:
    """The JSON of `train.evaluate`.

    Args:
        scores: of `evaluate_policies`.
        scenario: name of the preset.
        seed: of the bootstrap.

    Returns:
        `policies` (by name: `return_mean`, `return_std`, `return_ci95`, and the mean of every metric), `episodes` and
        `scenario`. If a trained policy is there also, each of an episode's mean over the training seeds:
        `paired_return_difference` (to every rule: `mean`, `ci95`) and `change_against_none` (of metrics, as a share:
        `mean`, `ci95`). With several training seeds `training_seeds` (`return_means`, `interquartile_mean`, `ci95`, and
        `paired_return_differences`, each learner's own).
    """
    policies: dict[str, Any] = {}
    for name, score in scores.items():
        returns = score["return"]
        means = {
            column: float(np.mean(values)) for column, values in score.items() if column != "return"
        }
        policies[name] = {
            "return_mean": float(np.mean(returns)),
            "return_std": float(np.std(returns, ddof=1)) if returns.size > 1 else 0.0,
            "return_ci95": list(bootstrap_ci95(returns, seed)),
            **{
                ("episode_length" if column == "length" else column): value
                for column, value in means.items()
            },
        }
    result: dict[str, Any] = {
        "policies": policies,
        "episodes": int(next(iter(scores.values()))["return"].size),
        "scenario": scenario,
    }
    trained = [score for name, score in scores.items() if name.startswith(TRAINED)]
    rules = {name: score for name, score in scores.items() if not name.startswith(TRAINED)}
    if trained:
        ours = {
            column: np.mean([score[column] for score in trained], axis=0) for column in trained[0]
        }
        result |= _compare(ours, rules, seed)
    if len(trained) > 1:
        result["training_seeds"] = _over_seeds([score["return"] for score in trained], seed) | {
            "paired_return_differences": [_gains(score, rules, seed) for score in trained]
        }
    return result


def _compare(ours: Scores, rules: Mapping[str, Scores], seed: int) -> dict[str, Any]:
    """The trained policy beside the rules, episode by episode; see `summarize`."""
    result: dict[str, Any] = {"paired_return_difference": _gains(ours, rules, seed)}
    base = rules.get("none", {})
    changes = {}
    for metric in CLAIMED:
        if metric not in base:
            continue
        pairs = np.stack([ours[metric], base[metric]], axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = bootstrap_ci95(pairs, seed, statistic=relative_change)
        if np.isfinite(ends).all():  # few episodes may hold nothing to compare with
            change = float(relative_change(pairs[None])[0])
            changes[metric] = {"mean": change, "ci95": list(ends)}
    return result | ({"change_against_none": changes} if changes else {})


def _gains(ours: Scores, rules: Mapping[str, Scores], seed: int) -> dict[str, Any]:
    """Return less that of each rule in the same episode: `mean`, `ci95`."""
    gains = {name: ours["return"] - score["return"] for name, score in rules.items()}
    return {
        name: {"mean": float(np.mean(gain)), "ci95": list(bootstrap_ci95(gain, seed))}
        for name, gain in gains.items()
    }


def _over_seeds(returns: Sequence[np.ndarray], seed: int) -> dict[str, Any]:
    """Mean returns of all training seeds, and their interquartile mean."""
    means = np.mean(returns, axis=1)
    return {
        "return_means": means.tolist(),
        "interquartile_mean": float(interquartile_mean(means[None])[0]),
        "ci95": list(bootstrap_ci95(means, seed, statistic=interquartile_mean)),
    }

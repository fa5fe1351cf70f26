"""Worlds or learners that differ in a few numbers, side by side in one compiled program.

A world's numbers are leaves of `EnvParams`, so `jax.vmap` runs over them: over the worlds in which policies play whole
episodes, and over the worlds in which dispatchers are trained. The numbers of a learner are settings.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from tqdm import tqdm

from medjax.episodes.keys import episode_keys
from medjax.episodes.runner import episode_decisions
from medjax.episodes.scores import MAX_DECISIONS, Scores, make_runner
from medjax.errors import InputError
from medjax.numerics.rows import in_blocks
from medjax.policies.policy import Policy
from medjax.world.params import EnvParams
from train.algorithms.finite import BAD, finite_updates
from train.algorithms.networks import PolicyWeights
from train.algorithms.programs import shardings
from train.algorithms.registry import algorithm_of
from train.settings import TrainConfig

Numbers = Mapping[str, Any]  # by "group.leaf" of EnvParams; of several worlds: (worlds,) each
EPISODES_A_CALL = 32  # approximate; sets how often the bar moves and Ctrl-C is heard


def with_numbers(params: EnvParams, numbers: Numbers) -> EnvParams:
    """Params of one world with scalars replaced, by names such as `fleet.cooldown_s`; they may be traced."""
    for name, value in numbers.items():
        group, leaf = name.split(".")
        holder = getattr(params, group)
        if isinstance(holder, Mapping):
            changed: Any = {**holder, leaf: jnp.asarray(value, holder[leaf].dtype)}
        else:
            changed = holder.replace(**{leaf: jnp.asarray(value, getattr(holder, leaf).dtype)})
        params = params.replace(**{group: changed})
    return params


def play_worlds(
    env: Any,
    params: EnvParams,
    numbers: Numbers,
    policies: Mapping[str, Policy],
    episodes: int,
    seed: int,
    own_weights: bool = False,
) -> dict[str, Scores]:
    """The same episodes in every world, played by every policy.

    Args:
      env: a single environment.
      params: what the worlds have in common.
      numbers: in which they differ, `(worlds,)` each.
      policies: by name.
      episodes, seed: as in `medjax.episodes.scores`.
      own_weights: the policies' weights have a leading axis of worlds: each world plays its own policy.

    Returns:
      For each policy, arrays `(worlds, episodes)` float64 of `return`, `length` and the environment's metrics.
    """
    worlds = len(next(iter(numbers.values())))
    runner = make_runner(env, policies, episode_decisions(params) or MAX_DECISIONS, worlds)

    @jax.jit
    def play(weights: Any, keys: jax.Array, params: EnvParams, numbers: Numbers) -> Any:
        def one(own: Any, world: Numbers) -> Any:
            return runner(own, keys, with_numbers(params, world))

        return jax.vmap(one, (0 if own_weights else None, 0))(weights, numbers)

    batch = _episodes_a_call(episodes)
    calls = -(-episodes // batch)
    keys = episode_keys(seed, calls * batch).reshape(calls, batch)
    weights = jax.device_get(tuple(policy.weights for policy in policies.values()))
    bar = tqdm(keys, "episodes", disable=None, leave=False)
    parts = [jax.device_get(play(weights, some, params, numbers)) for some in bar]
    columns = {
        name: np.concatenate([part[name] for part in parts], axis=-1)[..., :episodes]
        for name in parts[0]
    }
    return {
        policy: {name: values[:, index].astype(np.float64) for name, values in columns.items()}
        for index, policy in enumerate(policies)
    }


def in_world(score: Scores, index: int) -> Scores:
    """Scores `(episodes,)` in one world out of those of all, `(worlds, episodes)`."""
    return {metric: values[index] for metric, values in score.items()}


def _episodes_a_call(episodes: int) -> int:
    """Episodes per call: a power of two on every device, so that they split into blocks."""
    devices = len(jax.local_devices())
    each = -(-min(episodes, EPISODES_A_CALL) // devices)
    return devices * 2 ** (each - 1).bit_length()


class Trained(NamedTuple):
    """What several learners have learned; every leaf has an axis of learners first."""

    weights: PolicyWeights
    start: PolicyWeights  # before the first update
    # (updates, learners) mean return of the whole episodes that ended in an update; not finite without any
    curve: np.ndarray
    # (learners,) bool, whether all that a learner computed was finite
    finite: np.ndarray


def train_learners(
    learner_of: Callable[[Numbers], Any],
    params_of: Callable[[EnvParams, Numbers], EnvParams],
    keys: jax.Array,
    numbers: Numbers,
    params: EnvParams,
    num_updates: int,
) -> Trained:
    """Trains learners side by side, each as `train.ppo` trains a seed with its key.

    Args:
      learner_of: builds the `train.algorithms.algorithm.Learner` with these numbers.
      params_of: makes a learner's params from those of all and its numbers.
      keys: (learners,) keys.
      numbers: in which the learners differ, `(learners,)` each; both functions get those of one learner, traced.
      params: what the worlds have in common.
      num_updates: of each learner.
    """

    def start(each: tuple[jax.Array, Numbers], params: EnvParams) -> Any:
        # One after the other, see train.algorithms.programs.make_train.
        return lax.map(lambda own: learner_of(own[1]).init(own[0], params_of(params, own[1])), each)

    def go_on(state: Any, params: EnvParams, numbers: Numbers) -> Any:
        def one(own: Any, numbers: Numbers) -> Any:
            own, metrics = learner_of(numbers).update(own, params_of(params, numbers))
            return own, (metrics["episode_return"], metrics[BAD])

        # On a CPU the environments of one learner fill the cache.
        return in_blocks(lambda some: jax.vmap(one)(*some), (state, numbers), rows_at_once=1)

    where = shardings(learner_of({name: values[0] for name, values in numbers.items()}), seeds=True)
    init = jax.jit(start, out_shardings=where)
    run = jax.jit(
        go_on, in_shardings=(where, None, None), out_shardings=(where, None), donate_argnums=0
    )
    state = init((keys, numbers), params)
    first, curve, bad = jax.device_get(state.weights), [], []
    for _ in tqdm(range(num_updates), "training", disable=None, leave=False):
        state, (returns, first_bad) = jax.block_until_ready(run(state, params, numbers))
        curve.append(jax.device_get(returns))
        bad.append(jax.device_get(first_bad))
    finite = [finite_updates(of_learner)[1] is None for of_learner in np.transpose(bad)]
    by_update = np.reshape(curve, (num_updates, len(keys)))
    return Trained(state.weights, first, by_update, np.array(finite))


def train_worlds(
    env: Any, params: EnvParams, numbers: Numbers, config: TrainConfig
) -> PolicyWeights:
    """A dispatcher for every world, trained side by side, each as `train.ppo` would with the same seed.

    Arguments are those of `play_worlds` and the settings of each learner. Every leaf of what they learned has an axis
    of worlds first.

    Raises:
      InputError: a learner's numbers did not stay finite.
    """
    learner = algorithm_of(config).build_learner(env, params, config)
    keys = jnp.repeat(jax.random.key(config.seed)[None], len(next(iter(numbers.values()))))
    same = keys, numbers, params, config.num_updates
    learned = train_learners(lambda _: learner, with_numbers, *same)
    if not learned.finite.all():
        world = {name: float(each[np.argmin(learned.finite)]) for name, each in numbers.items()}
        raise InputError(
            f"training did not stay finite with {world}, allowed: other costs or --seed"
        )
    return learned.weights

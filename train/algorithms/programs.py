"""The two compiled programs of training, whatever the algorithm: the first state, and several updates.

The design is PureJaxRL's idea: environment, rollout and updates in one compiled program (Lu et al. 2022).
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import NamedSharding, PartitionSpec

from medjax.env.contract import Environment
from train.algorithms.algorithm import Learner, Metrics, TrainState
from train.algorithms.registry import algorithm_of
from train.settings import MOST_PER_CALL, TrainConfig


@dataclasses.dataclass(frozen=True)
class Programs:
    """The two programs of training, over all seeds at once."""

    init: jax.stages.Wrapped  # (key, env_params) to the state
    run: (
        jax.stages.Wrapped
    )  # (state, env_params, num_updates) to the state and metrics: `run_updates`
    shardings: Any  # of the state, a prefix of its tree


def run_updates(
    learner: Learner, state: TrainState, env_params: Any, num_updates: jax.Array
) -> tuple[TrainState, Metrics]:
    """Several updates.

    The number is an argument of the compiled program, not a part of it, and the program does not depend on how many
    the settings allow: run in whatever pieces, training takes the very same steps, bit for bit.

    Args:
        learner: of one seed.
        state: where training stands.
        env_params: parameters of the environments.
        num_updates: () int32, at most `MOST_PER_CALL`.

    Returns:
        The new state, and metrics `(MOST_PER_CALL,)`, of which the first `num_updates` entries are filled.
    """
    update = jax.jit(learner.update)  # traced once for its shapes and its use
    _, shapes = jax.eval_shape(update, state, env_params)
    # No placeholders that are not finite: JAX_DEBUG_NANS=1 would take them for a fault.
    table = {name: jnp.zeros((MOST_PER_CALL,), metric.dtype) for name, metric in shapes.items()}

    def body(index: jax.Array, carry: tuple[TrainState, Metrics]) -> tuple[TrainState, Metrics]:
        carried, rows = carry
        carried, metrics = update(carried, env_params)
        return carried, {name: rows[name].at[index].set(metrics[name]) for name in rows}

    return lax.fori_loop(jnp.int32(0), num_updates, body, (state, table))


def make_train(env: Environment, params: Any, config: TrainConfig) -> Programs:
    """Compilable training.

    Args:
        env: a single environment; it is copied `config.num_envs` times.
        params: its parameters, read only for the length of an episode.
        config: settings.

    Returns:
        Jitted functions (also for ahead-of-time compilation by `.lower`); `run` donates its state. With
        `config.num_seeds > 1` every leaf of the state and of the metrics has a leading axis of that length.

    Raises:
        InputError: `config.num_devices` is not possible.
    """
    learner = algorithm_of(config).build_learner(env, params, config)
    init: Callable[..., TrainState] = learner.init
    run: Callable[..., tuple[TrainState, Metrics]] = partial(run_updates, learner)
    if config.num_seeds > 1:
        # One after the other: each runs as fast as alone, its environments in the cache, its matrices plain.
        # Under vmap over seeds and environments, XLA's CPU program of a reset never returns.
        def run(
            states: TrainState, env_params: Any, num_updates: jax.Array
        ) -> tuple[TrainState, Metrics]:
            return lax.map(lambda own: run_updates(learner, own, env_params, num_updates), states)

        def init(key: jax.Array, env_params: Any) -> TrainState:
            keys = jax.random.split(key, config.num_seeds)
            return lax.map(lambda own: learner.init(own, env_params), keys)

    where = shardings(learner, seeds=config.num_seeds > 1)
    return Programs(
        init=jax.jit(init, out_shardings=where),
        run=jax.jit(
            run,
            in_shardings=(where, None, None),
            out_shardings=(where, NamedSharding(learner.mesh, PartitionSpec())),
            donate_argnums=0,
        ),
        shardings=where,
    )


def shardings(learner: Learner, seeds: bool) -> Any:
    """Where the parts of its state are: what belongs to environments is shared out, the rest is everywhere."""
    mesh = learner.mesh
    everywhere = NamedSharding(mesh, PartitionSpec())
    rows = NamedSharding(mesh, PartitionSpec(*([None] if seeds else []), *mesh.axis_names))
    parts: dict[str, Any] = {field.name: everywhere for field in dataclasses.fields(learner.state)}
    return learner.state(**parts | {"rollout": rows})


def shapes_of(programs: Programs, params: Any, config: TrainConfig) -> TrainState:
    """Shapes and types of the training state, found without computing or compiling it."""
    # Traced as it will be compiled, so that compiling need not trace it again.
    state = jax.eval_shape(programs.init, jax.random.key(config.seed), params)
    # They hold for any number of devices.
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), state)

"""The two compiled programs of training, for any algorithm: one makes the first state, one does several updates.

As in PureJaxRL, one program holds environment, rollout and updates (Lu et al. 2022).
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
    run: jax.stages.Wrapped  # `run_updates`: (state, env_params, num_updates) to state, metrics
    shardings: Any  # of the state, a prefix of its tree


def run_updates(
    learner: Learner, state: TrainState, env_params: Any, num_updates: jax.Array
) -> tuple[TrainState, Metrics]:
    """Several updates.

    Their number is an argument of the compiled program, so that training takes the same steps, bit for bit, however
    many updates each call does.

    Args:
        learner: learner of one seed.
        state: current training state.
        env_params: parameters of the environments.
        num_updates: () int32, at most `MOST_PER_CALL`.

    Returns:
        The new state, and metrics `(MOST_PER_CALL,)`, of which the first `num_updates` entries are filled.
    """
    update = jax.jit(learner.update)  # one trace serves both the shapes and the loop
    _, shapes = jax.eval_shape(update, state, env_params)
    # Placeholders are finite, because JAX_DEBUG_NANS=1 would report others as errors.
    table = {name: jnp.zeros((MOST_PER_CALL,), metric.dtype) for name, metric in shapes.items()}

    def body(index: jax.Array, carry: tuple[TrainState, Metrics]) -> tuple[TrainState, Metrics]:
        carried, rows = carry
        carried, metrics = update(carried, env_params)
        return carried, {name: rows[name].at[index].set(metrics[name]) for name in rows}

    return lax.fori_loop(jnp.int32(0), num_updates, body, (state, table))


def make_train(env: Environment, params: Any, config: TrainConfig) -> Programs:
    """The training programs, not yet compiled.

    Args:
        env: a single environment; the learner makes `config.num_envs` copies of it.
        params: its parameters; only the length of an episode is read.
        config: settings.

    Returns:
        Jitted functions (`.lower` compiles them ahead of time); `run` donates its state. With
        `config.num_seeds > 1` every leaf of the state and of the metrics has a leading axis of that length.

    Raises:
        InputError: `config.num_devices` is not possible.
    """
    learner = algorithm_of(config).build_learner(env, params, config)
    init: Callable[..., TrainState] = learner.init
    run: Callable[..., tuple[TrainState, Metrics]] = partial(run_updates, learner)
    if config.num_seeds > 1:
        # Seeds run one after the other, each as fast as alone: its environments fit the cache, its matrices stay 2-D.
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
    """Sharding of the training state: `rollout` is sharded across devices, the rest is replicated."""
    mesh = learner.mesh
    everywhere = NamedSharding(mesh, PartitionSpec())
    rows = NamedSharding(mesh, PartitionSpec(*([None] if seeds else []), *mesh.axis_names))
    parts: dict[str, Any] = {field.name: everywhere for field in dataclasses.fields(learner.state)}
    return learner.state(**parts | {"rollout": rows})


def shapes_of(programs: Programs, params: Any, config: TrainConfig) -> TrainState:
    """Shapes and types of the training state, for any number of devices, without computing or compiling it."""
    # Tracing the program with its later arguments spares the compilation another trace.
    state = jax.eval_shape(programs.init, jax.random.key(config.seed), params)
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), state)

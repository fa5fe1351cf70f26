"""Checkpoints of a whole training state, written by Orbax under `RUN_DIR/checkpoints/`.

One directory per checkpoint, named by the number of updates done, holds three items: `weights` (all that acting
needs), `rest` (everything else that training goes on from) and `layout` (JSON: the shape and type of each array, so
that a checkpoint of another shape is refused before anything is read).
"""

import dataclasses
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from train.config import SettingError
from train.learner import TrainState
from train.networks import PolicyWeights

Layout = dict[str, str]


class Checkpoints:
    """The checkpoints of one run.

    Args:
        run_dir: directory of the run; `checkpoints/` is made in it by the first save.
        keep: newest checkpoints kept; None keeps all and suits reading.
    """

    def __init__(self, run_dir: Path, keep: int | None = None) -> None:
        # Orbax takes a second to import; --help and bad input need not wait for it.
        import orbax.checkpoint as ocp

        # Orbax reports every step of every save through absl.
        logging.getLogger("absl").setLevel(logging.ERROR)
        self._ocp = ocp
        self.directory = Path(run_dir).absolute() / "checkpoints"
        self._options = ocp.CheckpointManagerOptions(
            max_to_keep=keep,
            # A donated state must be copied before the next update runs; saves are small, so wait for them.
            enable_async_checkpointing=False,
            cleanup_tmp_directories=True,
        )
        self._open: Any = None

    def save(self, state: TrainState) -> int:
        """Writes `state` under its number of updates; one that is already there is left alone.

        Returns:
            The number of updates.
        """
        ocp, manager = self._ocp, self._manager()
        step = updates_done(state)
        if step in manager.all_steps():
            return step
        plain = jax.tree.map(np.asarray, _without_keys(state))
        items = {
            "weights": ocp.args.StandardSave(plain.weights),
            "rest": ocp.args.StandardSave(_rest(plain)),
            "layout": ocp.args.JsonSave(layout(state)),
        }
        manager.save(step, args=ocp.args.Composite(**items), force=True)
        return step

    def all(self) -> list[int]:
        """Updates done at each checkpoint, the newest last."""
        return sorted(self._manager().all_steps()) if self.directory.is_dir() else []

    def latest(self) -> int | None:
        """Updates done at the newest checkpoint; None if there is none."""
        return max(self.all(), default=None)

    def check(self, expected: TrainState, prefix: str = "", step: int | None = None) -> int:
        """Compares a checkpoint with what it is to become, without reading arrays.

        Args:
            expected: shapes and types (`jax.eval_shape` of `Learner.init`).
            prefix: compare only arrays whose name begins so; `.weights` for evaluation.
            step: one of `all`; None is the newest.

        Returns:
            The checkpoint's number of updates.

        Raises:
            SettingError: there is none, or an array differs; the message names the first that does.
        """
        step = self.latest() if step is None else step
        if step is None:
            raise SettingError(
                f"{self.directory} holds no checkpoint, allowed: a directory that train.ppo wrote"
            )
        saved: Mapping[str, str] = self._restore(step, layout=self._ocp.args.JsonRestore())[
            "layout"
        ]
        wanted = layout(expected)
        where = f"checkpoint {self.directory / str(step)}"
        for name in sorted({*saved, *wanted}):
            if name.startswith(prefix) and saved.get(name) != wanted.get(name):
                found, allowed = saved.get(name, "missing"), wanted.get(name, "no such array")
                raise SettingError(
                    f"{where} is of another shape: {name.lstrip('.')} is {found}, allowed: {allowed}"
                )
        return step

    def restore(self, expected: TrainState) -> TrainState:
        """Reads the newest checkpoint.

        Args:
            expected: shapes and types; see `check`.

        Raises:
            SettingError: see `check`.
        """
        step = self.check(expected)
        plain = _abstract(expected)
        restore = self._ocp.args.StandardRestore
        read = self._restore(step, weights=restore(plain.weights), rest=restore(_rest(plain)))
        state = expected.replace(weights=read["weights"], **read["rest"])  # type: ignore[attr-defined]
        return _with_keys(state, expected)

    def restore_weights(self, expected: TrainState, step: int | None = None) -> PolicyWeights:
        """Reads only what acting needs, whatever number of environments it was trained with.

        Args:
            expected: shapes and types; only those of its weights are read.
            step: see `check`.

        Raises:
            SettingError: see `check`.
        """
        step = self.check(expected, ".weights", step)
        item = self._ocp.args.StandardRestore(_abstract(expected).weights)
        return _owned(self._restore(step, weights=item)["weights"])

    def close(self) -> None:
        """Finishes what Orbax does in the background."""
        if self._open is not None:
            self._open.close()
            self._open = None

    def _manager(self) -> Any:
        if self._open is None:
            self._open = self._ocp.CheckpointManager(self.directory, options=self._options)
        return self._open

    def _restore(self, step: int, **items: Any) -> Any:
        return self._manager().restore(step, args=self._ocp.args.Composite(**items))


def updates_done(state: TrainState) -> int:
    """Updates done, the same for all seeds."""
    return int(np.max(np.asarray(state.update)))


def layout(state: TrainState) -> Layout:
    """Shape and type of every array by its path, e.g. `(1024, 300) float32`."""
    leaves = jax.tree_util.tree_flatten_with_path(_abstract(state))[0]
    return {jax.tree_util.keystr(path): f"{leaf.shape} {leaf.dtype}" for path, leaf in leaves}


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _without_keys(tree: Any) -> Any:
    """Typed PRNG keys as the numbers they hold."""
    return jax.tree.map(lambda leaf: jax.random.key_data(leaf) if _is_key(leaf) else leaf, tree)


def _abstract(tree: Any) -> Any:
    """Shapes and types, of keys as numbers."""
    return jax.eval_shape(_without_keys, tree)


def _owned(tree: Any) -> Any:
    # A copy: what Orbax read may share memory with NumPy, and the training program overwrites its input.
    return jax.tree.map(lambda leaf: jnp.array(leaf, copy=True), tree)


def _with_keys(tree: Any, expected: Any) -> Any:
    """The inverse of `_without_keys`, on the device."""

    def wrap(like: Any, leaf: Any) -> jax.Array:
        return jax.random.wrap_key_data(leaf) if _is_key(like) else leaf

    return jax.tree.map(wrap, expected, _owned(tree))


def _rest(state: TrainState) -> dict[str, Any]:
    """All but the weights."""
    names = [field.name for field in dataclasses.fields(state) if field.name != "weights"]
    return {name: getattr(state, name) for name in names}

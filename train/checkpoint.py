"""Checkpoints of a whole training state, written by Orbax under `RUN_DIR/checkpoints/`.

One directory per checkpoint, named by the number of updates done, holds three items: `weights` (all that acting
needs), `rest` (everything else that training goes on from) and `about` (JSON: version of this format, settings, and
shape, type and checksum of each array). Orbax writes beside and renames, so a checkpoint is there whole or not at all.
A damaged, foreign or differently shaped one is refused; nothing in it is ever unpickled.
"""

import dataclasses
import logging
import zlib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from train.config import SettingError, TrainConfig, to_json
from train.learner import TrainState
from train.networks import PolicyWeights
from train.processes import fetch

FORMAT = 1  # of what this version writes and reads

Layout = dict[str, str]
Items = dict[str, dict[str, Any]]  # fields of a `TrainState` by the item that holds them


class Checkpoints:
    """The checkpoints of one run.

    Args:
        run_dir: directory of the run; `checkpoints/` is made in it by the first save.
        keep: newest checkpoints kept; None is for reading alone, beside a run that may be writing.
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
            read_only=keep is None,
            create=False,
            # A donated state must be copied before the next update runs; saves are small, so wait for them.
            enable_async_checkpointing=False,
            cleanup_tmp_directories=keep is not None,
            # One process writes, each reads for itself: no process waits for another here.
            multiprocessing_options=ocp.options.MultiprocessingOptions(
                primary_host=jax.process_index(),
                active_processes={jax.process_index()},
                barrier_sync_key_prefix=f"process{jax.process_index()}",
            ),
        )
        self._open: Any = None

    def save(self, state: TrainState, config: TrainConfig) -> int:
        """Writes `state` under its number of updates; one that is already there is left alone.

        Args:
            state: arrays of NumPy (`to_host`).
            config: settings that it was trained with.

        Returns:
            The number of updates.

        Raises:
            OSError: it could not be written; those before it are as they were.
        """
        args, step, items = self._ocp.args, updates_done(state), _items(state)
        about = {
            "format": FORMAT,
            "config": to_json(config),
            "arrays": layout(state),
            "checksums": {name: _checksum(leaf) for name, leaf in _named(items).items()},
        }
        saves = {name: args.StandardSave(fields) for name, fields in items.items()}
        try:
            self.directory.mkdir(exist_ok=True)
            manager = self._manager()
            if step not in manager.all_steps():
                composite = args.Composite(about=args.JsonSave(about), **saves)
                manager.save(step, args=composite, force=True)
        except Exception as error:  # Orbax passes on whatever its storage raises
            reason = getattr(error, "strerror", None) or str(error).partition("\n")[0]
            raise OSError(f"checkpoint {step} could not be written: {reason[:300]}") from error
        return step

    def all(self) -> list[int]:
        """Updates done at each checkpoint, the newest last."""
        return sorted(self._manager().all_steps()) if self.directory.is_dir() else []

    def latest(self) -> int | None:
        """Updates done at the newest checkpoint; None if there is none."""
        return max(self.all(), default=None)

    def restore(self, expected: TrainState) -> TrainState:
        """Reads the newest checkpoint.

        Args:
            expected: shapes and types that it must have (`jax.eval_shape` of `Learner.init`).

        Returns:
            The state as arrays of NumPy, for `to_devices`.

        Raises:
            SettingError: there is none, it is damaged or foreign, or an array differs; the message names the first.
        """
        empty = _empty(expected)
        read = self._read(None, _items(empty))
        return empty.replace(**read["weights"], **read["rest"])  # type: ignore[attr-defined,no-any-return]

    def restore_weights(self, expected: TrainState, step: int | None = None) -> PolicyWeights:
        """Reads only what acting needs, whatever number of environments it was trained with.

        Args:
            expected: shapes and types; only those of its weights are read.
            step: one of `all`; None is the newest.

        Raises:
            SettingError: see `restore`.
        """
        items = _items(_empty(expected))
        read = self._read(step, {"weights": items["weights"]})
        return jax.tree.map(jnp.asarray, read["weights"]["weights"])  # type: ignore[no-any-return]

    def close(self) -> None:
        """Finishes what Orbax does in the background."""
        if self._open is not None:
            self._open.close()
            self._open = None

    def _manager(self) -> Any:
        if self._open is None:
            self._open = self._ocp.CheckpointManager(self.directory, options=self._options)
        return self._open

    def _read(self, step: int | None, expected: Items) -> Items:
        """Items of a checkpoint that have the expected arrays."""
        step = self.latest() if step is None else step
        if step is None:
            raise SettingError(
                f"{self.directory} holds no checkpoint, allowed: a directory that train.ppo wrote"
            )
        where = f"checkpoint {self.directory / str(step)}"
        arrays, checksums = self._about(step, where)
        fields = tuple(name for item in expected.values() for name in item)
        saved = {name: shape for name, shape in arrays.items() if name.startswith(fields)}
        wanted = {name: f"{leaf.shape} {leaf.dtype}" for name, leaf in _named(expected).items()}
        for name in sorted({*saved, *wanted}):
            if saved.get(name) != wanted.get(name):
                found, allowed = saved.get(name, "missing"), wanted.get(name, "no such array")
                raise SettingError(
                    f"{where} is of another shape: {name} is {found}, allowed: {allowed}"
                )
        restore = self._ocp.args.StandardRestore
        try:
            read = self._restore(step, **{name: restore(item) for name, item in expected.items()})
        except Exception as error:  # whatever Orbax and its storage make of a damaged file
            raise _damaged(where, type(error).__name__) from error
        for name, leaf in _named(read).items():
            if checksums.get(name) != _checksum(leaf):
                raise _damaged(where, f"the checksum of {name} differs")
        return read

    def _about(self, step: int, where: str) -> tuple[Layout, dict[str, int]]:
        """Arrays and checksums, as the checkpoint says.

        Raises:
            SettingError: it says nothing, or is of another format.
        """
        try:
            about = self._restore(step, about=self._ocp.args.JsonRestore())["about"]
            version, arrays, checksums = about["format"], about["arrays"], about["checksums"]
        except Exception as error:
            raise _damaged(where, "no account of its contents") from error
        if version != FORMAT:
            raise SettingError(f"{where} is of format {version!r}, allowed: {FORMAT}")
        return arrays, checksums

    def _restore(self, step: int, **items: Any) -> Any:
        return self._manager().restore(step, args=self._ocp.args.Composite(**items))


def _damaged(where: str, what: str) -> SettingError:
    return SettingError(
        f"{where} is damaged, or none of train.ppo ({what}), allowed: a whole one;"
        " without its directory the one before it is taken"
    )


def updates_done(state: TrainState) -> int:
    """Updates done, the same for all seeds."""
    return int(np.max(np.asarray(state.update)))


def to_host(state: TrainState) -> TrainState:
    """Arrays of NumPy, those of other processes among them, with PRNG keys as the numbers they hold."""
    return fetch(_without_keys(state))  # type: ignore[no-any-return]


def to_devices(state: TrainState, expected: TrainState, shardings: Any) -> TrainState:
    """The inverse of `to_host`, in memory of its own: the training program overwrites its input.

    Args:
        state: arrays of NumPy, the same in every process.
        expected: shapes and types.
        shardings: see `TrainFunctions`.
    """

    def wrap(like: Any, leaf: jax.Array) -> jax.Array:
        return jax.random.wrap_key_data(leaf) if _is_key(like) else leaf

    place = jax.jit(lambda plain: jax.tree.map(wrap, expected, plain), out_shardings=shardings)
    placed: TrainState = place(state)
    return placed


def layout(state: TrainState) -> Layout:
    """Shape and type of every array by its path, e.g. `(1024, 300) float32`; of keys as numbers."""
    plain = jax.eval_shape(_without_keys, state)
    return {name: f"{leaf.shape} {leaf.dtype}" for name, leaf in _named(_items(plain)).items()}


def _items(state: TrainState) -> Items:
    """The fields of a state by item."""
    fields = {field.name: getattr(state, field.name) for field in dataclasses.fields(state)}
    return {"weights": {"weights": fields.pop("weights")}, "rest": fields}


def _named(items: Items) -> dict[str, Any]:
    """The arrays by their paths in the state."""
    return {
        name + jax.tree_util.keystr(path): leaf
        for fields in items.values()
        for name, tree in fields.items()
        for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]
    }


def _checksum(array: np.ndarray) -> int:
    return zlib.crc32(np.ascontiguousarray(array).tobytes())


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _without_keys(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jax.random.key_data(leaf) if _is_key(leaf) else leaf, tree)


def _empty(state: TrainState) -> TrainState:
    """Arrays of NumPy to be filled, of the shapes and types of `state`."""
    plain = jax.eval_shape(_without_keys, state)
    return jax.tree.map(lambda leaf: np.empty(leaf.shape, leaf.dtype), plain)  # type: ignore[no-any-return]

"""Checkpoints of the whole training state: one NumPy archive each, `RUN_DIR/checkpoints/UPDATE.npz`.

An archive holds every array under its path in the state, with PRNG keys as their raw numbers. Its member `about` is
JSON with the version of this format, the settings, and the generator of the keys. Writing to a temporary file and
renaming it makes a checkpoint appear whole or not at all. Reading verifies the ZIP checksum of each member and never
unpickles anything.
"""

import json
import os
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from medjax.errors import InputError
from medjax.files import remove_unfinished, replacing
from train.algorithms.algorithm import TrainState
from train.algorithms.networks import PolicyWeights
from train.runs.processes import fetch
from train.settings import TrainConfig, to_json

# Version that is written and read. In format 1 the initial policy was a bias of the last layer. In format 2, whose
# weights can still be read, no policy was sharpened.
FORMAT, UNSHARPENED = 3, 2
CHECKPOINTS = "checkpoints"  # in the directory of a run
ABOUT = "about"
PRNG = "jax_default_prng_impl"  # JAX's option
WEIGHTS = "weights/"  # prefix of the arrays that acting needs
SHARPNESS = WEIGHTS + "sharpness"


class ShapeError(InputError):
    """A checkpoint's shape differs from what the settings require."""


class Checkpoints:
    """The checkpoints of one run.

    Args:
        run_dir: directory of the run; the first save creates `checkpoints/` in it.
        keep: number of newest checkpoints that `save` keeps.
    """

    def __init__(self, run_dir: Path, keep: int = 1) -> None:
        self.directory = Path(run_dir) / CHECKPOINTS
        self.keep = keep

    def save(self, state: TrainState, config: TrainConfig) -> None:
        """Writes the result of `to_host` under its number of updates; an existing checkpoint is left alone.

        Raises:
            OSError: it could not be written; earlier checkpoints are unchanged.
        """
        path = self._path(updates_done(state))
        about = json.dumps({"format": FORMAT, "config": to_json(config), "prng": _prng()})
        arrays: dict[str, Any] = {ABOUT: np.asarray(about), **_named(state)}
        self.directory.mkdir(exist_ok=True)
        remove_unfinished(self.directory)
        if not path.exists():
            with replacing(path) as partial, partial.open("wb") as file:
                np.savez(file, **arrays)
                file.flush()
                os.fsync(file.fileno())
        for update in self.all()[: -self.keep]:
            self._path(update).unlink()

    def all(self) -> list[int]:
        """Number of updates at each checkpoint, the newest last."""
        stems = [path.stem for path in self.directory.glob("*.npz")]
        return sorted(int(stem) for stem in stems if stem.isdecimal())

    def latest(self) -> int | None:
        """Number of updates at the newest checkpoint; None if there is none."""
        return max(self.all(), default=None)

    def check(self, update: int) -> None:
        """Refuses (InputError) an update without a checkpoint."""
        if update not in self.all():
            there = ", ".join(map(str, self.all())) or "none"
            raise InputError(f"no checkpoint of update {update} is there, allowed: {there}")

    def remove_after(self, update: int) -> bool:
        """Removes the checkpoints of later updates, which will be done again. Returns whether there were any."""
        later = [each for each in self.all() if each > update]
        for each in later:
            self._path(each).unlink()
        return bool(later)

    def restore(self, expected: TrainState, step: int | None = None) -> TrainState:
        """Reads a checkpoint as NumPy arrays, for `to_devices`.

        Args:
            expected: required shapes and types (`train.algorithms.programs.shapes_of`).
            step: one of `all`; None is the newest.

        Raises:
            InputError: there is none, it is damaged or foreign, or an array differs.
        """
        return self._read(step, jax.eval_shape(_without_keys, expected), "")

    def restore_weights(self, expected: PolicyWeights) -> PolicyWeights:
        """Reads of the newest checkpoint only what acting needs, whatever the number of environments in training.

        Args:
            expected: required shapes and types (`train.runs.policies.weight_shapes`).

        Raises:
            InputError: see `restore`.
        """
        return jax.tree.map(jnp.asarray, self._read(None, expected, WEIGHTS))

    def _path(self, update: int) -> Path:
        return self.directory / f"{update}.npz"

    def _read(self, step: int | None, expected: Any, prefix: str) -> Any:
        """A tree like `expected`, read from the arrays whose names begin with `prefix`."""
        step = self.latest() if step is None else step
        if step is None:
            what = f"{self.directory} holds no checkpoint"
            raise InputError(f"{what}, allowed: a directory that train.ppo wrote")
        where = f"checkpoint {self._path(step)}"
        try:
            with np.load(self._path(step), allow_pickle=False) as file:
                about = json.loads(str(file[ABOUT]))
                version, prng = about["format"], about.get("prng", _prng())
                names = [name for name in file.files if name != ABOUT and name.startswith(prefix)]
                known = (FORMAT, UNSHARPENED) if prefix == WEIGHTS else (FORMAT,)
                arrays = {name: file[name] for name in names} if version in known else {}
        except Exception as error:  # NumPy and zipfile raise many types
            before = max((update for update in self.all() if update < step), default=None)
            go_on = "there is none before it"
            if before is not None:
                go_on = f"from the one before it: --resume {self.directory.parent} --from-update {before}"
            what = f"is damaged, or none of train.ppo ({type(error).__name__})"
            raise InputError(f"{where} {what}, allowed: a whole one; {go_on}") from error
        if version not in known:
            raise InputError(f"{where} is of format {version!r}, allowed: {FORMAT}")
        if prefix != WEIGHTS and prng != _prng():
            raise InputError(f"{PRNG} {_prng()}, allowed: {prng}, whose keys {where} holds")
        wanted = _named(expected, prefix)
        if version == UNSHARPENED:
            arrays[SHARPNESS] = np.ones(wanted[SHARPNESS].shape, np.float32)
        for name in sorted({*arrays, *wanted}):
            found, allowed = _layout(arrays.get(name)), _layout(wanted.get(name))
            if found != allowed:
                what = f"{name} is {found}, allowed: {allowed}"
                raise ShapeError(f"{where} is of another shape: {what}")
        return jax.tree.unflatten(jax.tree.structure(expected), [arrays[name] for name in wanted])


def updates_done(state: TrainState) -> int:
    """Number of updates done, the same for all seeds."""
    return int(np.max(np.asarray(state.update)))


def to_host(state: TrainState) -> TrainState:
    """The state as NumPy arrays, including the parts of other processes, with PRNG keys as raw numbers."""
    return fetch(_without_keys(state))


def to_devices(state: TrainState, expected: TrainState, shardings: Any) -> TrainState:
    """The inverse of `to_host`. It copies the arrays because the training program overwrites its input.

    Args:
        state: NumPy arrays, the same in every process.
        expected: shapes and types of the state.
        shardings: see `train.algorithms.programs.Programs`.
    """

    def wrap(like: Any, leaf: jax.Array) -> jax.Array:
        return jax.random.wrap_key_data(leaf) if _is_key(like) else leaf

    place = jax.jit(lambda plain: jax.tree.map(wrap, expected, plain), out_shardings=shardings)
    return place(state)


def _named(tree: Any, prefix: str = "") -> dict[str, Any]:
    """The leaves by path, e.g. `opt_state/0/count`."""
    return {
        prefix + jax.tree_util.keystr(path, simple=True, separator="/"): leaf
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
    }


def _layout(array: Any) -> str:
    """Shape and type, e.g. `(1024, 300) float32`."""
    return "missing" if array is None else f"{array.shape} {array.dtype}"


def _prng() -> str:
    """JAX's current key generator; keys of different generators may have the same shape."""
    return str(getattr(jax.config, PRNG))


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _without_keys(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jax.random.key_data(leaf) if _is_key(leaf) else leaf, tree)

"""The directory of a run: what is in it, and how it is claimed without overwriting anything."""

import contextlib
import dataclasses
import fcntl
import importlib.util
import itertools
import json
import os
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import IO, Any

from medjax.errors import InputError
from medjax.files import check_writable, replacing
from train.settings import TrainConfig, load_config, to_json

PACKAGES = ("medjax", "jax", "jaxlib", "flax", "optax", "distrax", "numpy")
LOCK = ".lock"


@dataclasses.dataclass(frozen=True)
class RunDir:
    """Paths in the directory of a run."""

    path: Path

    @property
    def config(self) -> Path:
        """Settings and versions."""
        return self.path / "config.json"

    @property
    def metrics(self) -> Path:
        """A line of JSON an update."""
        return self.path / "metrics.jsonl"

    @property
    def summary(self) -> Path:
        """What came out."""
        return self.path / "summary.json"

    @property
    def evaluation(self) -> Path:
        """The closing evaluation."""
        return self.path / "evaluation.json"

    @property
    def policy(self) -> Path:
        """The trained policy, for `medjax.policies.saved.load_policy`."""
        return self.path / "policy.zip"

    @property
    def plots(self) -> Path:
        """Pictures."""
        return self.path / "plots"

    @property
    def report(self) -> Path:
        """Tables and figures of `train.report`."""
        return self.path / "report"

    @property
    def tensorboard(self) -> Path:
        """Event files."""
        return self.path / "tensorboard"

    def load_config(self) -> TrainConfig:
        """Settings of the run.

        Raises:
            InputError: this is no directory of a run, or its settings cannot be read.
        """
        if not self.path.is_dir():
            raise InputError(
                f"run {self.path} is not a directory, allowed: one that train.ppo wrote"
            )
        return load_config(self.config)

    def claim(self, config: TrainConfig) -> IO[str]:
        """Makes the directory, locks it and writes the settings into it.

        Returns:
            The lock; see `lock`.

        Raises:
            InputError: it is in use or cannot be written.
        """
        check_unused(self.path)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            held = self.lock()
            check_unused(self.path)  # another run may have come and gone
            self._save_config(config)
        except OSError as error:
            self.release()
            raise _unwritable(self.path, error) from None
        return held

    def lock(self) -> IO[str]:
        """Keeps other runs out while the file that it returns is open: until this process ends, however it ends.

        Raises:
            InputError: a run under way has it, or the directory cannot be written.
        """
        try:
            file = (self.path / LOCK).open("a", encoding="utf-8")
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"run {self.path} is under way in another process, allowed: one process at a time"
            ) from None
        except OSError as error:
            raise _unwritable(self.path, error) from None
        return file

    def release(self) -> None:
        """Undoes `claim` of a run that ended before it did anything."""
        with contextlib.suppress(OSError):
            for path in (self.config, self.path / LOCK):
                path.unlink(missing_ok=True)
            self.path.rmdir()

    def update_config(self, config: TrainConfig, update: int) -> None:
        """Writes settings changed by --resume; those until `update` stay in `config-until-UPDATE.json`.

        Raises:
            InputError: the directory cannot be written.
        """
        try:
            check_writable(self.path)
            if load_config(self.config) != config:
                before = self.config.read_text(encoding="utf-8")
                write_text(self.path / f"config-until-{update}.json", before)
                self._save_config(config)
        except OSError as error:
            raise _unwritable(self.path, error) from None

    def _save_config(self, config: TrainConfig) -> None:
        """Writes the settings, and the versions of what ran them."""
        data = {"config": to_json(config), "versions": versions()}
        write_text(self.config, json.dumps(data, indent=2) + "\n")


def new_run_dir(scenario: str, root: Path = Path("runs")) -> Path:
    """Makes `root/SCENARIO-N` with the smallest N from 1 that is not there yet, and nobody else's.

    Raises:
        InputError: it cannot be made.
    """
    for number in itertools.count(1):
        path = root / f"{scenario}-{number}"
        try:
            path.mkdir(parents=True)
            return path
        except FileExistsError:
            if not root.is_dir():
                raise InputError(f"{root} is not a directory, allowed: a directory") from None
        except OSError as error:
            raise _unwritable(path, error) from None
    raise AssertionError


def check_unused(path: Path) -> None:
    """Refuses a directory that holds anything.

    Raises:
        InputError: it is in use, is not a directory, or could not be made.
    """
    try:
        if path.exists() and not path.is_dir():
            raise InputError(
                f"run-dir is {path}, which is not a directory, allowed: a new or empty directory"
            )
        if path.exists() and any(entry.name != LOCK for entry in path.iterdir()):
            raise InputError(
                f"run-dir is {path}, which already holds files, allowed: a new or empty directory"
                " (or --resume it)"
            )
        check_writable(next(there for there in (path, *path.parents) if os.path.lexists(there)))
    except OSError as error:
        raise _unwritable(path, error) from None


def check_matplotlib() -> None:
    """Refuses to draw where matplotlib is missing, before the work for it is done.

    Raises:
        InputError: it is not installed.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise InputError("matplotlib is not installed, allowed: pip install 'medjax[train]'")


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(
        f"cannot write run-dir {path}: {error.strerror}, allowed: a writable directory"
    )


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that determine results."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Writes JSON in full or not at all; the parent directory is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(data, indent=2, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Writes text in full or not at all."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")

"""The directory of a run: what is in it, and how it is claimed without overwriting anything."""

import dataclasses
import importlib.util
import itertools
import json
import os
import platform
import tempfile
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from train.config import SettingError, TrainConfig, load_config, save_config

PACKAGES = ("medjax", "jax", "jaxlib", "flax", "optax", "distrax", "orbax-checkpoint", "numpy")


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
        """The trained policy, for `medjax.exported.load_policy`."""
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
            SettingError: this is no directory of a run, or its settings cannot be read.
        """
        if not self.path.is_dir():
            raise SettingError(
                f"run {self.path} is not a directory, allowed: one that train.ppo wrote"
            )
        return load_config(self.config)

    def claim(self, config: TrainConfig) -> None:
        """Makes the directory and writes the settings into it.

        Raises:
            SettingError: it is in use or cannot be written.
        """
        check_unused(self.path)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            save_config(self.config, config, versions())
        except OSError as error:
            raise _unwritable(self.path, error) from None

    def release(self) -> None:
        """Undoes `claim` of a run that ended before it did anything."""
        self.config.unlink(missing_ok=True)
        if self.path.is_dir() and not any(self.path.iterdir()):
            self.path.rmdir()

    def update_config(self, config: TrainConfig, update: int) -> None:
        """Writes settings changed by --resume; those until `update` stay in `config-until-UPDATE.json`.

        Raises:
            SettingError: the directory cannot be written.
        """
        try:
            check_writable(self.path)
            if load_config(self.config) != config:
                self.config.replace(self.path / f"config-until-{update}.json")
                save_config(self.config, config, versions())
        except OSError as error:
            raise _unwritable(self.path, error) from None


def unused_run_dir(scenario: str, root: Path = Path("runs")) -> Path:
    """`root/SCENARIO-N` with the smallest N from 1 that is not there yet."""
    paths = (root / f"{scenario}-{number}" for number in itertools.count(1))
    return next(path for path in paths if not path.exists())


def check_unused(path: Path) -> None:
    """Refuses a directory that holds anything.

    Raises:
        SettingError: it is in use, is not a directory, or could not be made.
    """
    try:
        if path.exists() and not path.is_dir():
            raise SettingError(
                f"run-dir is {path}, which is not a directory, allowed: a new or empty directory"
            )
        if path.exists() and any(path.iterdir()):
            raise SettingError(
                f"run-dir is {path}, which already holds files, allowed: a new or empty directory"
                " (or --resume it)"
            )
        check_writable(next(there for there in (path, *path.parents) if os.path.lexists(there)))
    except OSError as error:
        raise _unwritable(path, error) from None


def check_writable(path: Path) -> None:
    """Tries to write in an existing directory.

    Raises:
        OSError: that failed.
    """
    with tempfile.TemporaryFile(dir=path):
        pass


def check_output(option: str, path: Path) -> None:
    """Refuses a file that cannot be written, before the work for it is done.

    Args:
        option: that it was given by.
        path: the file; its directory must be there.

    Raises:
        SettingError: it cannot be written.
    """
    try:
        if path.exists() and not path.is_file():
            what = "a directory" if path.is_dir() else "a device"
            raise SettingError(f"{option} is {path}, which is {what}, allowed: a file")
        check_writable(path.parent)
    except OSError as error:
        raise SettingError(
            f"cannot write {path}: {error.strerror}, allowed: a file in a writable directory"
        ) from None


def check_matplotlib() -> None:
    """Refuses to draw where matplotlib is missing, before the work for it is done.

    Raises:
        SettingError: it is not installed.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise SettingError("matplotlib is not installed, allowed: pip install 'medjax[train]'")


def _unwritable(path: Path, error: OSError) -> SettingError:
    return SettingError(
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
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    partial.replace(path)

"""The directory of a run: its files, and how a run claims it without overwriting anything."""

import contextlib
import dataclasses
import fcntl
import importlib.util
import itertools
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from medjax.errors import InputError
from medjax.files import check_writable, remove_unfinished, write_text
from train.algorithms.settings import SETTINGS
from train.runs.versions import versions
from train.settings import GIVEN, TrainConfig, load_config, to_json

LOCK = ".lock"
PLAYS = "the most probable action"  # how a policy file acts
# Other files with similar names belong to the user.
UNTIL = re.compile(r"config-until-([0-9]{1,18})\.json")


class RunDir:
    """The directory of a run, and the paths of its files.

    Args:
        path: path of the directory.
        given: `train.api` supplies the environment; the settings do not name it.
    """

    def __init__(self, path: Path, given: bool = False) -> None:
        self.path, self.given = path, given
        self._made = False  # whether `release` may remove the directory
        self.config = path / "config.json"  # settings and versions
        self.metrics = path / "metrics.jsonl"  # a line of JSON per update
        self.summary = path / "summary.json"  # results
        self.evaluation = path / "evaluation.json"  # closing evaluation
        self.policy = path / "policy.zip"  # for `medjax.policies.saved.load_policy`
        self.plots = path / "plots"
        self.report = path / "report"  # tables and figures of `train.report`
        self.tensorboard = path / "tensorboard"  # event files

    def load_config(self, *kinds: type[TrainConfig]) -> TrainConfig:
        """Settings of the run.

        Args:
            kinds: allowed classes of settings; by default those of every algorithm.

        Raises:
            InputError: this is not the directory of a run, or its settings cannot be read or do not describe its
                environment.
        """
        if not self.path.is_dir():
            what = f"run {self.path} is not a directory"
            raise InputError(f"{what}, allowed: one that train.ppo wrote")
        return load_config(self.config, *(kinds or SETTINGS), given=self.given)

    def card(self) -> dict[str, Any]:
        """How the policy is played and was trained: `plays`, `settings`, `versions`, and `evaluation` if there was one.

        The last has `episodes`, `seed`, and `return_mean` and `return_ci95` of each of `policies`.

        Raises:
            InputError: a file of the run cannot be read.
        """
        file = self.config
        try:
            run = json.loads(file.read_text(encoding="utf-8"))
            card = {"plays": PLAYS, "settings": run["config"], "versions": run["versions"]}
            if (file := self.evaluation).exists():
                played = json.loads(file.read_text(encoding="utf-8"))
                returns = {
                    name: {number: entry[number] for number in ("return_mean", "return_ci95")}
                    for name, entry in played["policies"].items()
                }
                numbers = {name: played[name] for name in ("episodes", "seed")}
                card["evaluation"] = {**numbers, "policies": returns}
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise InputError(f"cannot read {file}, allowed: as train.ppo wrote it") from error
        return card

    def claim(self, config: TrainConfig, made: bool = False) -> IO[str]:
        """Makes the directory, writes the settings into it and returns its `lock`.

        Args:
            config: the settings.
            made: the directory is there already, because `new_run_dir` made it for this run.

        Raises:
            InputError: the directory is in use or cannot be written.
        """
        check_unused(self.path)
        with _writing(self.path):
            self._made = made or not self.path.exists()
            try:
                self.path.mkdir(parents=True, exist_ok=True)
                held = self.lock()
                check_unused(self.path)  # another run may have come and gone
                self._save_config(config)
            except OSError:
                self.release()
                raise
        return held

    def lock(self) -> IO[str]:
        """Locks the directory for as long as the returned file is open, at most until this process ends.

        Raises:
            InputError: another run holds the lock, or the directory cannot be written.
        """
        with _writing(self.path):
            file = (self.path / LOCK).open("a", encoding="utf-8")
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                what = f"run {self.path} is under way in another process"
                raise InputError(f"{what}, allowed: one process at a time") from None
            remove_unfinished(self.path)
        return file

    def release(self) -> None:
        """Undoes `claim` for a run that ended before its first update; a directory that was there before stays."""
        with contextlib.suppress(OSError):
            for path in (self.config, self.path / LOCK):
                path.unlink(missing_ok=True)
            if self._made:
                self.path.rmdir()

    def remove_results(self) -> None:
        """Removes the policy's file, the closing evaluation and the summary, which belong to earlier weights."""
        for path in (self.policy, self.evaluation, self.summary):
            path.unlink(missing_ok=True)

    def update_config(self, config: TrainConfig, update: int) -> None:
        """Writes the settings and versions that hold after `update`, and keeps the earlier ones.

        An update had the settings of the first `config-until-UPDATE.json` whose UPDATE is not before it, or else those
        of `config.json`.

        Raises:
            InputError: the directory cannot be written.
        """
        with _writing(self.path):
            check_writable(self.path)
            named = ((UNTIL.fullmatch(path.name), path) for path in self.path.iterdir())
            numbers = {int(match[1]): path for match, path in named if match}
            later = [numbers[number] for number in sorted(numbers) if number >= update]
            ruled = later[0] if later else self.config
            if not self._holds(ruled, config):
                until = self.path / f"config-until-{update}.json"
                write_text(until, ruled.read_text(encoding="utf-8"))
                later = [path for path in later if path != until]
            if not self._holds(self.config, config):
                self._save_config(config)
            for path in later:  # these updates will be done again
                path.unlink()

    def _holds(self, path: Path, config: TrainConfig) -> bool:
        """Whether a file has these settings, and today's versions."""
        unforced = dataclasses.replace(config, force=False)  # as a file is read
        same = load_config(path, type(config), given=self.given) == unforced
        return same and json.loads(path.read_text(encoding="utf-8")).get("versions") == versions()

    def _save_config(self, config: TrainConfig) -> None:
        environment = {"environment": GIVEN} if self.given else {}
        data = {"config": to_json(config), **environment, "versions": versions()}
        write_text(self.config, json.dumps(data, indent=2) + "\n")


def new_run_dir(scenario: str, root: Path = Path("runs")) -> Path:
    """Makes `root/SCENARIO-N` with the smallest N from 1 that is free, even if several runs start at once.

    Raises:
        InputError: the directory cannot be made.
    """
    for number in itertools.count(1):
        path = root / f"{scenario}-{number}"
        with _writing(path):
            try:
                path.mkdir(parents=True)
                return path
            except FileExistsError:
                if not root.is_dir():
                    raise InputError(f"{root} is not a directory, allowed: a directory") from None
    raise AssertionError


def check_unused(path: Path) -> None:
    """Refuses (InputError) a path unless it is an empty directory, or one can be made there."""
    allowed = "allowed: a new or empty directory"
    with _writing(path):
        if path.exists() and not path.is_dir():
            raise InputError(f"run-dir is {path}, which is not a directory, {allowed}")
        if path.exists() and any(entry.name != LOCK for entry in path.iterdir()):
            what = f"run-dir is {path}, which already holds files"
            raise InputError(f"{what}, {allowed} (or --resume it)")
        check_writable(next(there for there in (path, *path.parents) if os.path.lexists(there)))


def check_matplotlib() -> None:
    """Refuses (InputError) to draw without matplotlib, before the work is done."""
    if importlib.util.find_spec("matplotlib") is None:
        raise InputError("matplotlib is not installed, allowed: pip install -e .[train]")


@contextlib.contextmanager
def _writing(path: Path) -> Iterator[None]:
    """A context that turns an OSError into an InputError: the directory cannot be written."""
    try:
        yield
    except OSError as error:
        what = f"cannot write run-dir {path}: {error.strerror}"
        raise InputError(f"{what}, allowed: a writable directory") from None

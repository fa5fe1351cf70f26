"""The command line, built from the fields of `TrainConfig`."""

import argparse
import dataclasses
import math
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from train.config import (
    NOT_NUMBERS,
    Override,
    SettingError,
    TrainConfig,
    from_json,
    load_config,
    to_json,
)
from train.reading import read_value
from train.wording import MOST_SHOWN, one_line, shown

AUTO = "auto"
MOST_PATH = 1000  # characters; directories are made one within the other
MOST_NAME = 255  # bytes, of every usual file system


class OneLineParser(argparse.ArgumentParser):
    """An argument parser whose errors are one line on stderr and exit code 2."""

    def error(self, message: str) -> NoReturn:
        """Ends the command."""
        self.exit(2, f"{self.prog}: {one_line(message)}\n")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse's, but for `--option=--`, which it takes for an empty list."""
        given = sys.argv[1:] if args is None else list(args)
        for word in given:
            if word.startswith("--") and word.partition("=")[2] == "--":
                self.error(f"argument {word.partition('=')[0]}: expected one argument")
        return super().parse_known_args(given, namespace)


@dataclasses.dataclass(frozen=True)
class Processes:
    """The processes that train together.

    Raises:
        SettingError: numbers that do not go together.
    """

    coordinator: str | None = (
        None  # HOST:PORT of the first; AUTO: the scheduler knows; None: this one is alone
    )
    number: int | None = None
    index: int | None = None

    def __post_init__(self) -> None:
        """Checks what can be checked before any of them is met."""
        numbers = (self.number, self.index)
        if self.coordinator in (None, AUTO):
            if numbers != (None, None):
                raise SettingError(
                    f"num_processes is {self.number} and process_id {self.index}, allowed: with --coordinator HOST:PORT"
                )
            return
        host, _, port = self.coordinator.rpartition(":")
        if not host or not re.fullmatch(r"\d{1,5}", port, re.ASCII) or not 0 < int(port) < 2**16:
            raise SettingError(
                f"coordinator is {shown(self.coordinator)}, allowed: HOST:PORT of the first process, or {AUTO}"
            )
        for name, number, low, high in (
            ("num_processes", self.number, 1, 2**16),
            ("process_id", self.index, 0, (self.number or 1) - 1),
        ):
            if not isinstance(number, int) or not low <= number <= high:
                raise SettingError(
                    f"{name} is {shown(number)}, allowed: a whole number from {low} to {high}"
                )


@dataclasses.dataclass(frozen=True)
class Request:
    """What the command line of `train.ppo` asks for."""

    config: TrainConfig
    run_dir: Path | None  # None: an unused one under runs/
    resume: Path | None  # run to go on with
    processes: Processes


class _Help(argparse.ArgumentDefaultsHelpFormatter):
    """Defaults are shown where they say something."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=32, width=100)

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default is None or action.default is argparse.SUPPRESS:
            return action.help
        return super()._get_help_string(action)


def build_parser(prog: str = "train.ppo") -> OneLineParser:
    """The parser of `python -m train.ppo`; the options are the fields of `TrainConfig`."""
    parser = OneLineParser(
        prog=f"python -m {prog}",
        description="Trains a dispatcher with PPO, then evaluates it beside those that are not learned.",
        epilog="Example: python -m train.ppo --num-envs 1024 --set cooldown_s=30 --run-dir runs/slow",
        formatter_class=_Help,
        allow_abbrev=False,
    )
    files = parser.add_argument_group("files")
    files.add_argument(
        "--run-dir",
        metavar="DIR",
        help="new or empty directory for the results (default: runs/SCENARIO-N)",
    )
    files.add_argument(
        "--resume",
        metavar="DIR",
        help="go on with the run in DIR from its newest checkpoint; its settings hold where none are given here",
    )
    files.add_argument(
        "--config",
        metavar="FILE",
        help="settings of a file, .json or .yaml, such as the config.json of a run, where none are given here",
    )
    several = parser.add_argument_group("several machines")
    several.add_argument(
        "--coordinator",
        metavar="HOST:PORT",
        help=f"train with other processes; address of the first. {AUTO}: as Slurm, Open MPI or Kubernetes say",
    )
    several.add_argument("--num-processes", metavar="N", help="how many there are")
    several.add_argument("--process-id", metavar="N", help="which of them this is, from 0")
    groups: dict[str, argparse._ArgumentGroup] = {}
    for field in dataclasses.fields(TrainConfig):
        title = field.metadata["group"]
        group = groups.setdefault(title, parser.add_argument_group(title))
        _add_option(group, field)
    return parser


def _add_option(group: argparse._ArgumentGroup, field: dataclasses.Field[Any]) -> None:
    """One option; values stay text here, so that all errors are worded in one place."""
    meta, default = field.metadata, field.default
    text = meta["help"]
    if field.name == "overrides":
        add_set_option(group, text)
        return
    name = "--" + field.name.replace("_", "-")
    if meta["choices"]:
        text += f"; one of {', '.join(meta['choices'])}"
    if isinstance(default, bool):
        word = "on" if default else "off"
        action = argparse.BooleanOptionalAction
        group.add_argument(
            name, action=action, default=argparse.SUPPRESS, help=f"{text} (default: {word})"
        )
        return
    shown_default = " ".join(map(str, default)) if isinstance(default, tuple) else default
    low, high = meta["low"], meta["high"]
    allowed = "" if low is None else f"{low:.10g} to {high:.10g}; "
    group.add_argument(
        name,
        *meta["flags"],
        default=argparse.SUPPRESS,
        metavar=meta["metavar"] or ("X" if isinstance(default, float) else "N"),
        nargs="+" if isinstance(default, tuple) else None,
        help=f"{text} ({allowed}default: {shown_default})",
    )


def add_set_option(group: Any, text: str) -> None:
    """The option `--set NAME=VALUE`, which fills `overrides` with text."""
    group.add_argument(
        "--set",
        dest="overrides",
        metavar="NAME=VALUE",
        action="append",
        default=argparse.SUPPRESS,
        help=text,
    )


def parse_request(argv: Sequence[str] | None = None) -> Request:
    """The request that `argv` makes, checked; bad input ends the command with exit code 2."""
    parser = build_parser()
    given = vars(parser.parse_args(argv))
    run_dir, resume, file = given.pop("run_dir"), given.pop("resume"), given.pop("config")
    coordinator = given.pop("coordinator")
    numbers = [given.pop(name) for name in ("num_processes", "process_id")]
    try:
        processes = Processes(
            coordinator, *(text if text is None else _number(text, int) for text in numbers)
        )
        for option, value in (("--run-dir", run_dir), ("--config", file)):
            if value is not None and resume is not None:
                raise SettingError(
                    f"{option} is {value} with --resume {resume}, allowed: one of the two"
                )
        given_paths = {"run-dir": run_dir, "resume": resume, "config": file}
        paths = {
            name: as_path(name, text) for name, text in given_paths.items() if text is not None
        }
        saved = _saved(paths.get("resume"), paths.get("config"))
        config = _config(settings_from_text(given), saved)
    except SettingError as error:
        parser.error(str(error))
    return Request(
        config,
        run_dir=paths.get("run-dir"),
        resume=paths.get("resume"),
        processes=processes,
    )


def as_path(option: str, text: str) -> Path:
    """The path that an option names.

    Raises:
        SettingError: no system takes it, or it could not be printed.
    """
    if not text or not text.isprintable() or len(text) > MOST_PATH:
        raise SettingError(
            f"{option} is {shown(text)}, allowed: a path of 1 to {MOST_PATH} printable characters"
        )
    if any(len(os.fsencode(name)) > MOST_NAME for name in text.split("/")):
        raise SettingError(
            f"{option} is {shown(text)}, allowed: names of at most {MOST_NAME} bytes"
        )
    if text.startswith("~"):  # a shell would have replaced it
        raise SettingError(f"{option} is {shown(text)}, allowed: the directory itself, or ./~")
    return Path(text)


def _saved(run: Path | None, file: Path | None) -> TrainConfig:
    """The settings that the command line changes: those of a run, of a file, or the defaults."""
    if run is not None:
        from train.rundir import RunDir

        return RunDir(run).load_config()
    return load_config(file) if file is not None else TrainConfig()


def _config(changes: dict[str, Any], saved: TrainConfig) -> TrainConfig:
    """The settings: those saved, and what the command line changes."""
    before = to_json(saved)
    changes["overrides"] = {**before["overrides"], **changes.get("overrides", {})}
    return from_json({**before, **changes})


def settings_from_text(given: dict[str, Any]) -> dict[str, Any]:
    """Values of settings from the text of the command line.

    Raises:
        SettingError: text that is no value of its setting's type.
    """
    fields = {field.name: field for field in dataclasses.fields(TrainConfig)}
    return {name: _value(fields[name], text) for name, text in given.items()}


def _value(field: dataclasses.Field[Any], text: Any) -> Any:
    """Value of one setting; what cannot be converted is left for `TrainConfig` to refuse in its words."""
    if field.name == "overrides":
        return parse_overrides(text)
    default = field.default
    if isinstance(default, bool | str):
        return text
    if isinstance(default, tuple):
        return tuple(_number(item, type(default[0])) for item in text)
    return _number(text, type(default))


def _number(text: str, kind: Any) -> Any:
    """`text` as int or float, itself if it is neither."""
    if not text.isascii():  # Python takes the digits of every script
        return text
    if kind is int and re.fullmatch(r"[+-]?\d+(\.\d+)?[eE]\+?\d+", text):
        value = float(text)  # 1e6 is a whole number to people
        return int(value) if math.isfinite(value) and value == int(value) else text
    try:
        return kind(text)
    except ValueError:
        return text


def parse_overrides(assignments: Sequence[str]) -> dict[str, Override]:
    """`NAME=VALUE` texts as a dict; values are JSON (`30`, `true`, `[300, 300]`), else plain text.

    Raises:
        SettingError: a text without `=` or with a name that cannot be set from here.
    """
    overrides: dict[str, Override] = {}
    for text in assignments:
        name, equals, value = text.partition("=")
        name = name.strip()
        if not equals or not name or name in NOT_NUMBERS:
            raise SettingError(
                f"--set {one_line(text, MOST_SHOWN)}, allowed: NAME=VALUE with the name of a number of the environment"
            )
        read = read_value(value.strip())
        overrides[name] = tuple(read) if isinstance(read, list) else read
    return overrides


def fail(prog: str, message: object) -> int:
    """Prints a one-line error and returns the exit code 2."""
    print(f"python -m {prog}: {one_line(str(message))}", file=sys.stderr)
    return 2


def make_environment(config: TrainConfig) -> tuple[Any, Any]:
    """The environment that the settings name, and its parameters.

    Raises:
        SettingError: an unknown scenario, option or network, a value out of range, or devices that are not there.
    """
    import medjax

    return _build(medjax.make, config)


def check_environment(config: TrainConfig) -> None:
    """Refuses what `make_environment` refuses, and computes nothing.

    Raises:
        SettingError: as `make_environment`.
    """
    from medjax.scenarios import prepare

    _build(prepare, config)


def _build(build: Callable[..., Any], config: TrainConfig) -> Any:
    import jax

    from medjax.observation import OBSERVATIONS
    from medjax.wrappers.devices import environment_mesh
    from train.networks import check_network

    overrides: dict[str, Any] = dict(config.overrides)
    try:
        # An environment is compiled in part; what can be refused without it is refused before.
        check_network(config, OBSERVATIONS.get(config.observation))
        groups = config.num_envs // config.num_minibatches
        environment_mesh(groups, config.num_devices, jax.devices())
        return build(config.scenario, observation=config.observation, **overrides)
    except ValueError as error:
        raise SettingError(str(error)) from None

"""The command line of training, built from the fields of an algorithm's settings."""

import argparse
import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from medjax.commandline import (
    OneLineParser,
    add_set_option,
    as_path,
    parse_overrides,
    whole_number,
)
from medjax.errors import InputError, shown
from medjax.world.catalogue import PRESETS, KeepsLines
from train.option import RENAMED, example
from train.runs.run_directory import RunDir
from train.settings import TrainConfig, from_json, load_config, to_json

AUTO = "auto"


@dataclasses.dataclass(frozen=True)
class Processes:
    """The processes that train together; InputError for inconsistent numbers."""

    # HOST:PORT of the first process; AUTO: ask the scheduler; None: a single process
    coordinator: str | None = None
    number: int | None = None
    index: int | None = None

    def __post_init__(self) -> None:
        """Checks everything that does not require a connection."""
        numbers = (self.number, self.index)
        if self.coordinator in (None, AUTO):
            if numbers != (None, None):
                what = f"num_processes is {self.number} and process_id {self.index}"
                raise InputError(f"{what}, allowed: with --coordinator HOST:PORT")
            return
        host, _, port = self.coordinator.rpartition(":")
        if not host or not re.fullmatch(r"\d{1,5}", port, re.ASCII) or not 0 < int(port) < 2**16:
            raise InputError(
                f"coordinator is {shown(self.coordinator)}, allowed: HOST:PORT of the first process, or {AUTO}"
            )
        for name, number, low, high in (
            ("num_processes", self.number, 1, 2**16),
            ("process_id", self.index, 0, (self.number or 1) - 1),
        ):
            if not isinstance(number, int) or not low <= number <= high:
                allowed = f"a whole number from {low} to {high}"
                raise InputError(f"{name} is {shown(number)}, allowed: {allowed}")


@dataclasses.dataclass(frozen=True)
class Request:
    """A request of the command line or of `train.api.train`."""

    config: TrainConfig
    run_dir: Path | None  # None: an unused one under runs/
    resume: Path | None  # run to resume
    processes: Processes = Processes()
    quiet: bool = False  # hide the progress
    given: tuple[Any, Any] | None = None  # environment and parameters; None: those of the settings
    callback: Callable[[dict[str, Any]], object] | None = None  # called with each update's row
    from_update: int | None = None  # update whose checkpoint to resume from; None: the newest


class _Help(KeepsLines, argparse.ArgumentDefaultsHelpFormatter):
    """Shows a default only if there is one."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        says = action.default not in (None, argparse.SUPPRESS)
        return super()._get_help_string(action) if says else action.help


def build_parser(kind: type[TrainConfig]) -> OneLineParser:
    """The parser of `python -m train.ALGORITHM`; its options are the fields of the algorithm's settings."""
    command, learner = f"train.{kind.algorithm}", kind.algorithm.upper()
    parser = OneLineParser(
        prog=f"python -m {command}",
        description=f"Trains a dispatcher with {learner}, then evaluates it beside those that are not learned.",
        epilog=f"{PRESETS}\n\nExample: python -m {command} --set cooldown_s=30 --run-dir runs/slow",
        formatter_class=partial(_Help, max_help_position=32, width=100),
    )
    files = parser.add_argument_group("files").add_argument
    text = "new or empty directory for the results (default: runs/SCENARIO-N)"
    files("--run-dir", metavar="DIR", help=text)
    text = (
        "resume the run in DIR from its newest checkpoint; options given here override its settings, but for those "
        "that would change what an update or the policy is"
    )
    files("--resume", metavar="DIR", help=text)
    text = "read settings from a .json or .yaml file, such as a run's config.json; options given here override them"
    files("--config", metavar="FILE", help=text)
    text = "with --resume: start from the checkpoint of this update, not the newest; later ones are removed"
    files("--from-update", metavar="N", help=text)
    parser.add_argument("--quiet", action="store_true", help="show no progress")
    several = parser.add_argument_group("several machines").add_argument
    text = f"train with other processes: address of the first, or {AUTO} to ask Slurm, Open MPI or Kubernetes"
    several("--coordinator", metavar="HOST:PORT", help=text)
    several("--num-processes", metavar="N", help="number of processes")
    several("--process-id", metavar="N", help="index of this process, from 0")
    for old in RENAMED:
        parser.add_argument(f"--{old}", default=argparse.SUPPRESS, help=argparse.SUPPRESS)
    add_settings(parser, kind)
    return parser


def add_settings(
    parser: OneLineParser, kind: type[TrainConfig], without: Sequence[str] = ()
) -> None:
    """Adds an option for each of the settings but `without`; an option that is not given leaves no value."""
    groups: dict[str, argparse._ArgumentGroup] = {}
    fields = [field for field in dataclasses.fields(kind) if field.name not in without]
    for field in sorted(fields, key=lambda own: own.metadata["group"] == "network"):
        title = field.metadata["group"]
        if title not in groups:
            groups[title] = parser.add_argument_group(title)
        _add_option(groups[title], field)


def _add_option(group: argparse._ArgumentGroup, field: dataclasses.Field[Any]) -> None:
    """Adds one option; values stay text here, so that the settings word all errors."""
    meta, default, text = field.metadata, field.default, field.metadata["help"]
    if field.name == "overrides":
        add_set_option(group, text)
        return
    if meta["choices"]:
        text += f"; one of {', '.join(meta['choices'])}"
    values = default if isinstance(default, tuple) else (example(field),)
    how: dict[str, Any] = {"nargs": "+"} if isinstance(default, tuple) else {}
    if isinstance(default, bool):
        how, said = {"action": argparse.BooleanOptionalAction}, "on" if default else "off"
    else:
        how["metavar"] = {float: "X", str: "NAME"}.get(type(values[0]), "N")
        said = " ".join(map(str, values))
    low, high = meta["low"], meta["high"]
    allowed = [] if low is None else [f"{low:.10g} to {high:.10g}"]
    usual = [] if default is None else [f"default: {said}"]
    group.add_argument(
        "--" + field.name.replace("_", "-"),
        *meta["flags"],
        default=argparse.SUPPRESS,
        help=f"{text} ({'; '.join(allowed + usual)})",
        **how,
    )


def parse_request(kind: type[TrainConfig], argv: Sequence[str] | None = None) -> Request:
    """The checked request of `argv` (None: the command line of the process); bad input exits with code 2."""
    parser = build_parser(kind)
    given = vars(parser.parse_args(argv))
    new, old, file, update = (
        given.pop(name) for name in ("run_dir", "resume", "config", "from_update")
    )
    coordinator, quiet = given.pop("coordinator"), given.pop("quiet")
    numbers = [given.pop(name) for name in ("num_processes", "process_id")]
    try:
        processes = Processes(
            coordinator, *(text if text is None else _number(text, int) for text in numbers)
        )
        for option, text in (("--run-dir", new), ("--config", file)):
            if old is not None and text is not None:
                raise InputError(f"{option} is {text} with --resume {old}, allowed: one of the two")
        if update is not None and old is None:
            raise InputError("--from-update without --resume, allowed: with it")
        new, old, file = (
            text if text is None else as_path(option, text)
            for option, text in (("--run-dir", new), ("--resume", old), ("--config", file))
        )
        update = update if update is None else whole_number("--from-update", update)
        if old is not None:
            saved = RunDir(old).load_config(kind)
        else:
            saved = load_config(file, kind) if file is not None else kind()
        before, changes = to_json(saved), settings_from_text(kind, given)
        changes["overrides"] = {**before["overrides"], **changes["overrides"]}
        config = from_json({**before, **changes}, kind)
    except InputError as error:
        parser.error(str(error))
    return Request(config, new, old, processes, quiet, from_update=update)


def settings_from_text(kind: type[TrainConfig], given: dict[str, Any]) -> dict[str, Any]:
    """Values of settings from the text of the command line.

    Args:
        kind: class of the settings.
        given: text by name; a list of texts for `overrides` and for lists.

    Raises:
        InputError: text that is not a value of its setting's type.
    """
    fields = {field.name: field for field in dataclasses.fields(kind)}
    return {name: _value(fields[RENAMED.get(name, name)], text) for name, text in given.items()}


def _value(field: dataclasses.Field[Any], text: Any) -> Any:
    """Value of one setting; text that cannot be converted stays as it is, for the settings to refuse."""
    if field.name == "overrides":
        return parse_overrides(text)
    default = example(field)
    if isinstance(default, bool | str):
        return text
    if isinstance(default, tuple):
        return tuple(_number(item, type(default[0])) for item in text)
    return _number(text, type(default))


def _number(text: str, kind: Any) -> Any:
    """`text` as int or float, or unchanged if it is neither."""
    if not text.isascii():  # Python accepts the digits of every script
        return text
    if kind is int and re.fullmatch(r"[+-]?\d+(\.\d+)?[eE]\+?\d+", text):
        value = float(text)  # people write 1e6 for a whole number
        return int(value) if math.isfinite(value) and value == int(value) else text
    try:
        return kind(text)
    except ValueError:
        return text

"""Declares a setting with its default, range and help text, checks values, and knows former names of settings."""

import dataclasses
import functools
import math
import numbers
import sys
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from medjax.commandline import NOT_NUMBERS
from medjax.errors import InputError, shown

Override = bool | int | float | str | tuple[Any, ...] | dict[str, Any]

RENAMED = {"start": "policy_prior"}  # former names of settings, accepted for one more version
# Defaults of `rule_sharpness`; the first versions had the sharp one.
SOFT_RULE, SHARP_RULE = 1.0, 4.0
MOST_ITEMS = 32  # in a list; a deeper network would take hours to compile


def option(
    default: Any,
    group: str,
    text: str,
    *,
    flags: tuple[str, ...] = (),
    choices: tuple[str, ...] = (),
    limits: tuple[float | None, float | None] = (None, None),
) -> Any:
    """A dataclass field that carries what the command line and the checks need.

    Args:
        default: default value; None: it follows other settings, see `filled`, and its type is that of the lower limit.
        group: heading in --help.
        text: help text, with the unit.
        flags: further names of the option.
        choices: allowed values.
        limits: smallest and largest allowed value.
    """
    said: dict[str, Any] = {"group": group, "help": text, "flags": flags, "choices": choices}
    said |= {"low": limits[0], "high": limits[1]}
    return dataclasses.field(default=default, metadata=said)


def example(field: dataclasses.Field[Any]) -> Any:
    """A value of the setting's type: its default, or its lower limit if the default follows other settings."""
    return field.metadata["low"] if field.default is None else field.default


def checked(field: dataclasses.Field[Any], value: Any) -> Any:
    """The value of a setting as a built-in type; InputError if its type is wrong or it is out of range."""
    if field.name == "overrides":
        return _read_overrides(value)
    if value is None and field.default is None:
        return None
    if not isinstance(field.default, tuple):
        return _read_one(field, type(example(field)), value)
    if not isinstance(value, list | tuple) or len(value) > MOST_ITEMS:
        raise InputError(f"{field.name} is {shown(value)}, allowed: a list of at most {MOST_ITEMS}")
    return tuple(_read_one(field, type(field.default[0]), item) for item in value)


def _read_one(field: dataclasses.Field[Any], kind: type, given: Any) -> Any:
    name, meta = field.name, field.metadata
    value = _as_kind(kind, given)
    if value is None:
        words = {bool: "true or false", int: "a whole number", float: "a number", str: "a name"}
        raise InputError(f"{name} is {shown(given)}, allowed: {words[kind]}")
    if meta["choices"] and value not in meta["choices"]:
        raise InputError(f"{name} is {shown(given)}, allowed: {', '.join(meta['choices'])}")
    low, high = meta["low"], meta["high"]
    if kind in (int, float) and not low <= value <= high:
        raise InputError(f"{name} is {shown(value)}, allowed: at least {low}, at most {high}")
    return value


def _as_kind(kind: type, value: Any) -> Any:
    """The value as `kind`, or None if it is of another type; NumPy's numbers count as numbers."""
    if kind in (bool, str) or isinstance(value, bool):
        return value if type(value) is kind else None
    if kind is int and isinstance(value, numbers.Integral):
        return int(value)
    if kind is float and isinstance(value, numbers.Real):
        try:
            return float(value)
        except OverflowError:  # an integer too large for a float
            return math.inf
    return None


def _read_overrides(given: Any) -> dict[str, Override]:
    """The overrides, checked as far as possible without the environment."""
    given = {} if given is None else given
    if not isinstance(given, Mapping):
        raise InputError(f"overrides are {shown(given)}, allowed: values by name")
    for name in given:
        if not isinstance(name, str) or not name or name in NOT_NUMBERS:
            allowed = "allowed: names of numbers of the environment"
            raise InputError(f"overrides hold {shown(name)}, {allowed}")
    return {name: _plain(name, value) for name, value in given.items()}


def _plain(name: str, value: Any, nested: bool = False) -> Any:
    """The value in a form that JSON can hold: a number, text, or a list or mapping of these."""
    if isinstance(value, bool | str):
        return value
    number = _as_kind(int if isinstance(value, numbers.Integral) else float, value)
    if number is not None:
        return number
    if not nested and isinstance(value, list | tuple):
        return tuple(_plain(name, item, nested=True) for item in value)
    if not nested and isinstance(value, Mapping):
        return {str(key): _plain(name, item, nested=True) for key, item in value.items()}
    raise InputError(f"{name} is {shown(value)}, allowed: a number or a list of numbers")


Settings = TypeVar("Settings")
Kind = TypeVar("Kind", bound=type)


def filled(settings: Settings, **usual: Any) -> Settings:
    """The settings with `usual` in place of those that are None."""
    changes = {name: value for name, value in usual.items() if getattr(settings, name) is None}
    # Numbers that JAX traces cannot be checked again, so nothing is made anew without need.
    return dataclasses.replace(settings, **changes) if changes else settings  # type: ignore[type-var]


def current_names(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values under the current names of settings; a value under a former name wins."""
    current = dict(values)
    for old in RENAMED.keys() & values.keys():
        current[RENAMED[old]] = current.pop(old)
    return current


def of_a_run(values: Any) -> Any:
    """The settings of a run, as this version reads them.

    It leaves out `force`, and settings that did nothing there and would be refused today. It adds the sharpness of the
    rule where the file names none, as the first versions did.
    """
    if not isinstance(values, Mapping):
        return values
    known, idle = current_names(values), {"force"}
    if known.get("agents", "none") != "none":
        idle.add("observation")
    if known.get("network") != "sets":
        idle.add("encoder")
    sharpness, waits = known.get("rule_sharpness"), known.get("policy_prior") == "wait"
    # A run that does not wait keeps its sharpness: one's own environment may start from the rule, whatever observation
    # the settings name.
    if sharpness is None or (waits and sharpness not in (SOFT_RULE, SHARP_RULE)):
        idle.add("rule_sharpness")
    kept = {name: value for name, value in values.items() if name not in idle}
    return {"rule_sharpness": SHARP_RULE} | kept


def say_renamed(names: Iterable[str]) -> None:
    """Prints a line for each former name among `names`, once in a process."""
    for old in RENAMED.keys() & {*names}:
        _say_once(f"{old} is now {RENAMED[old]}; the old name goes with the next version")


@functools.cache
def _say_once(line: str) -> None:
    print(line, file=sys.stderr)


def takes_former_names(kind: Kind) -> Kind:
    """A decorator: a class of settings also takes the former names in `RENAMED` as arguments."""
    init: Any = kind.__init__  # type: ignore[misc]

    @functools.wraps(init)
    def takes_both(self: Any, *args: Any, **values: Any) -> None:
        init(self, *args, **current_names(values))
        say_renamed(values)  # bad values were refused before, in a line of their own

    kind.__init__ = takes_both  # type: ignore[misc]
    return kind

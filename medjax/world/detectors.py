"""Demand from detector counts."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from medjax.commandline import as_path
from medjax.errors import InputError, shown
from medjax.files import check_input

COLUMNS = ("time_s", "entry", "vehicles_per_h")
MAIN, RAMPS = "main", "12345678"
MOST = 1e12  # largest flow, or time (which may count from 1970)
Counts = dict[tuple[float, int], list[tuple[int, float]]]
"""By time, s, and entry: the line number and flow of each row."""


def read_detectors(file: str | PathLike[str]) -> dict[str, Any]:
    """Reads demand from a file of counts: `medjax.make("corridor", demand=read_detectors("counts.csv"))`.

    The file is a CSV with a header and rows in any order. `time_s` is the start of an evenly spaced interval; every
    entry needs every time. `entry` is `main` or a ramp number from 1. Rows of the same entry and time, such as several
    lanes, are added up; their number must be the same at all times. `vehicles_per_h` is the flow. Other columns, such
    as speed, are ignored. A detector in a jam counts what the jam lets through, not the demand.

    Returns:
      Numbers by name for `medjax.make`: mean flows, and a profile of factors on them, one row per interval.

    Raises:
      InputError: the file, a column or a count is missing, a row differs in length from the header, or a value is
        negative or not a number.
    """
    path = as_path("file", file)
    check_input("file", path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as lines:
            table = csv.reader(lines, strict=True)
            names = next(table, [])
            rows = [(table.line_num, row) for row in table if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    if any(names.count(name) != 1 for name in COLUMNS) or not rows:
        needed = f"columns {', '.join(COLUMNS)}, each once, and one row per count"
        raise InputError(f"{path}: allowed a CSV file with {needed}")
    counts: Counts = {}
    for line, fields in rows:
        place = f"{path}, line {line}"
        if len(fields) != len(names):
            said = f"{place}: {len(fields)} fields, {shown(','.join(fields))}"
            raise InputError(f"{said}: allowed {len(names)}, as in the header")
        row = dict(zip(names, fields, strict=True))
        time, flow = (_read(row[name], f"{place}: {name}") for name in COLUMNS[::2])
        counted = counts.setdefault((time, _entry(row["entry"], place)), [])
        counted.append((line, flow))
    return _demand(path, counts)


def _flow(counted: Sequence[tuple[int, float]]) -> float:
    """Total flow of the rows of one entry and time."""
    return sum(flow for _, flow in counted)


def _read(text: str, place: str) -> float:
    """A number from 0 to MOST."""
    text = text.strip()
    try:  # `float` also accepts digits of other scripts, and 1_000
        value = float(text) if text.isascii() and "_" not in text else -1.0
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= MOST:
        raise InputError(f"{place} = {shown(text)}: allowed a number from 0 to {MOST:g}")
    return value


def _entry(text: str, place: str) -> int:
    """0 for the main road, else the ramp number."""
    name = text.strip()
    if name not in (MAIN, *RAMPS):
        raise InputError(f"{place}: entry = {shown(text)}: allowed {MAIN}, or a ramp from 1 to 8")
    return 0 if name == MAIN else int(name)


def _demand(path: Path, counts: Counts) -> dict[str, Any]:
    """Converts counts to numbers for `medjax.make`."""
    times = sorted({time for time, _ in counts})
    entries = range(1 + max(entry for _, entry in counts))
    steps = np.diff(times)
    if len(steps) and not np.allclose(steps, steps[0], rtol=1e-6):
        raise InputError(f"{path}: time_s = {shown(times)}: allowed evenly spaced")
    for time in times:
        for entry in entries:
            name = f"ramp {entry}" if entry else MAIN
            if (time, entry) not in counts:
                raise InputError(f"{path}: no row of {name} at time_s = {time:g}: allowed all")
            counted, first = counts[time, entry], counts[times[0], entry]
            if len(counted) != len(first):
                said = f"{path}, line {counted[-1][0]}: rows of {name} at time_s = {time:g}: {len(counted)}"
                raise InputError(f"{said}; allowed {len(first)}, as at time_s = {times[0]:g}")
            if (together := _flow(counted)) > MOST:
                said = f"{path}, line {counted[-1][0]}: {together:g} vehicles_per_h together"
                raise InputError(f"{said}: allowed {MOST:g}")
    flows = np.array([[_flow(counts[time, entry]) for entry in entries] for time in times])
    means = flows.mean(axis=0)
    factors = flows / np.where(means > 0.0, means, 1.0)
    return {
        "mainline_per_h": float(means[0]),
        "ramp_per_h": means[1:].tolist(),
        "profile": factors.tolist(),
        "period_s": float(steps[0]) if len(steps) else 3600.0,
        "start_s": 0.0,
    }

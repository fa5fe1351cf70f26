"""Demand from what detectors counted."""

from __future__ import annotations

import csv
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from medjax.commandline import as_path
from medjax.errors import InputError, shown
from medjax.files import check_input

COLUMNS = ("time_s", "entry", "vehicles_per_h")
MAIN, RAMPS = "main", "12345678"
MOST = 1e12  # of a time, which may be counted from 1970, or of a count


def read_detectors(file: str | PathLike[str]) -> dict[str, Any]:
    """Demand of a file of counts: `medjax.make("corridor", demand=read_detectors("counts.csv"))`.

    A CSV file with a header and, in any order of rows, `time_s` (start of each interval, evenly spaced; all entries at
    all times), `entry` (`main`, or the number of a ramp from 1; several rows of one entry and time, as of several
    lanes, are added up) and `vehicles_per_h`. Other columns, as the speed, are not read: drivers bring their desired
    speeds. A detector in a jam counts what the jam lets through, not the demand.

    Returns:
      Numbers by name, as `medjax.make` takes them: mean flows, and a profile of factors of them, a row an interval.

    Raises:
      InputError: one line; no such file, a column or a count is missing, or a value is no number, or below 0.
    """
    path = as_path("file", file)
    check_input("file", path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as lines:
            table = csv.DictReader(lines)
            names = table.fieldnames or ()
            rows = [(table.line_num, row) for row in table]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    if any(names.count(name) != 1 for name in COLUMNS) or not rows:
        needed = f"columns {', '.join(COLUMNS)}, each once, and a row a count"
        raise InputError(f"{path}: allowed a CSV file with {needed}")
    counts: dict[tuple[float, int], float] = {}
    for line, row in rows:
        place = f"{path}, line {line}"
        time, flow = (_read(row[name], f"{place}: {name}") for name in COLUMNS[::2])
        key = time, _entry(row["entry"], place)
        counts[key] = counts.get(key, 0.0) + flow
        if counts[key] > MOST:
            raise InputError(f"{place}: {counts[key]:g} vehicles_per_h together: allowed {MOST:g}")
    return _demand(path, counts)


def _read(text: str | None, place: str) -> float:
    """A number from 0 to MOST."""
    text = (text or "").strip()
    try:  # Python also takes the digits of every script, and 1_000
        value = float(text) if text.isascii() and "_" not in text else -1.0
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= MOST:
        raise InputError(f"{place} = {shown(text)}: allowed a number from 0 to {MOST:g}")
    return value


def _entry(text: str | None, place: str) -> int:
    """0 for the main road, else the number of a ramp."""
    name = (text or "").strip()
    if name not in (MAIN, *RAMPS):
        raise InputError(f"{place}: entry = {shown(text)}: allowed {MAIN}, or a ramp from 1 to 8")
    return 0 if name == MAIN else int(name)


def _demand(path: Path, counts: dict[tuple[float, int], float]) -> dict[str, Any]:
    """Numbers for `medjax.make` from flows by time, s, and entry."""
    times = sorted({time for time, _ in counts})
    entries = range(1 + max(entry for _, entry in counts))
    steps = np.diff(times)
    if len(steps) and not np.allclose(steps, steps[0], rtol=1e-6):
        raise InputError(f"{path}: time_s = {shown(times)}: allowed evenly spaced")
    for time in times:
        for entry in entries:
            if (time, entry) not in counts:
                name = f"ramp {entry}" if entry else MAIN
                raise InputError(f"{path}: no row of {name} at time_s = {time:g}: allowed all")
    flows = np.array([[counts[time, entry] for entry in entries] for time in times])
    means = flows.mean(axis=0)
    factors = flows / np.where(means > 0.0, means, 1.0)
    return {
        "mainline_per_h": float(means[0]),
        "ramp_per_h": means[1:].tolist(),
        "profile": factors.tolist(),
        "period_s": float(steps[0]) if len(steps) else 3600.0,
        "start_s": 0.0,
    }

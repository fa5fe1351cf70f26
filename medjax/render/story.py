"""What the player says in words: who the policies are, where it opens, and how the episode ends."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from medjax.env.metrics import JOULES_PER_KWH
from medjax.episodes.recording import Recording
from medjax.errors import InputError
from medjax.policies.rules import BASELINES

LEARNED = {"ppo": "Learned by trial and error in simulation (PPO)."}
BEFORE_S = 3.0  # the first charge
MEANS = {  # rows of the verdict: metrics of an evaluation whose sum is the same
    "ran out": ("evs_depleted",),
    "kWh received": ("energy_delivered_kwh",),
    "hours of delay": ("ev_delay_h", "gas_delay_h"),
    "MEDs sent": ("meds_dispatched",),
    "return": ("return_mean",),
}


def words_for(policy: str) -> str:
    """A sentence on a policy, "" of one that is not known: of a rule the first of its documentation."""
    rule = BASELINES.get(policy)
    if rule is None:
        return LEARNED.get(policy.split("_")[0], "")
    return (rule.__doc__ or "").split("\n")[0].replace("`", "")


def first_charge_s(recordings: Sequence[Recording]) -> float:
    """Just before an EV is first charged in one of them, s; 0 where none is."""
    found = [
        np.flatnonzero(np.asarray(each.frames.ev_is_charging).any(axis=1)) for each in recordings
    ]
    first = min((int(frames[0]) for frames in found if len(frames)), default=0)
    return max(0.0, first * recordings[0].config.tick_s - BEFORE_S)


def verdict(recordings: Sequence[Recording]) -> list[dict[str, Any]]:
    """Rows on whole episodes: what, digits after the point, which way is better (-1, 1; 0: neither), and values."""

    def row(title: str, digits: int, better: int, *values: float) -> dict[str, Any]:
        return {"title": title, "digits": digits, "better": better, "values": list(values)}

    tallies = [each.decisions.tally for each in recordings]

    def totals(name: str) -> list[float]:
        return [float(np.sum(getattr(tally, name), dtype=np.float64)) for tally in tallies]

    received = [joules / JOULES_PER_KWH for joules in totals("energy_received_j")]
    delays = zip(totals("ev_delay_s"), totals("gas_delay_s"), strict=True)
    returns = [float(np.sum(each.decisions.reward, dtype=np.float64)) for each in recordings]
    return [
        row("ran out", 0, -1, *totals("depleted")),
        row("kWh received", 1, 1, *received),
        row("hours of delay", 2, -1, *(sum(each) / 3600.0 for each in delays)),
        row("MEDs sent", 0, 0, *totals("meds_dispatched")),
        row("return", 1, 1, *returns),
    ]


def read_evaluation(path: Path) -> dict[str, Any]:
    """What `python -m train.evaluate --json` wrote.

    Raises:
      InputError: one line; no such file, or another one.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        names = [name for metrics in MEANS.values() for name in metrics]
        for entry in found["policies"].values():
            ends = entry["return_ci95"]
            numbers = [*(entry[name] for name in names), *ends]
            if len(ends) != 2 or not all(isinstance(number, int | float) for number in numbers):
                raise TypeError
        sound = isinstance(found["episodes"], int) and isinstance(found["scenario"], str)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        sound = False
    if not sound:
        raise InputError(f"--evaluation {path}: allowed a file that train.evaluate --json wrote")
    return dict(found)


def means(evaluation: Mapping[str, Any], recordings: Sequence[Recording]) -> list[Any]:
    """The verdict over many episodes: of each recording's policy a row of texts, None of one that was not evaluated.

    Raises:
      InputError: it is of another world, or of none of the policies.
    """
    world, own = evaluation["scenario"], recordings[0].scenario
    if world != own:
        raise InputError(f"the evaluation is of {world}: allowed one of {own}")
    entries = [evaluation["policies"].get(each.policy) for each in recordings]
    if not any(entries):
        known = ", ".join(evaluation["policies"])
        raise InputError(f"the evaluation has {known}: allowed one with {recordings[0].policy}")
    digits = [row["digits"] for row in verdict(recordings)]
    rows: list[Any] = []
    for entry in entries:
        if entry is None:
            rows.append(None)
            continue
        sums = [sum(entry[name] for name in names) for names in MEANS.values()]
        cells = [f"{value:.{count or 1}f}" for value, count in zip(sums, digits, strict=True)]
        low, high = entry["return_ci95"]
        rows.append([*cells[:-1], f"{cells[-1]} [{low:.1f}, {high:.1f}]"])
    return rows

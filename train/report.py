"""What is left of a run: the table, the training curve and the summary."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from train.logs import MAIN, Row

COLUMNS = {  # of the table: heading, metric, format
    "depleted share": ("depleted_share", ".3f"),
    "mean range m": ("mean_range_m", ".0f"),
    "mean SoC": ("mean_soc", ".3f"),
    "MEDs sent": ("meds_dispatched", ".2f"),
}


def format_table(result: dict[str, Any]) -> str:
    """The table of an evaluation, best return first.

    Args:
        result: of `train.evaluation.summarize`.
    """
    shown = [
        heading
        for heading, (metric, _) in COLUMNS.items()
        if all(metric in entry for entry in result["policies"].values())
    ]
    rows = [["policy", "return", "95 % CI", *shown, "ppo minus it, 95 % CI"]]
    differences = result.get("paired_return_difference", {})
    order = sorted(result["policies"].items(), key=lambda item: -item[1]["return_mean"])
    for name, entry in order:
        low, high = entry["return_ci95"]
        cells = [name, _short(entry["return_mean"]), f"[{_short(low)}, {_short(high)}]"]
        cells += [format(entry[COLUMNS[heading][0]], COLUMNS[heading][1]) for heading in shown]
        rows.append([*cells, _gain(differences.get(name))])
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = [
        "  ".join(
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    lines.insert(1, "-" * max(map(len, lines)))
    title = (
        f"{result['episodes']} whole episodes of {result['scenario']}, the same for every policy"
    )
    return "\n".join([title, *lines])


def _short(value: float) -> str:
    digits = 3 if not value else max(0, 3 - max(0, math.floor(math.log10(abs(value)))))
    return f"{value:.{min(digits, 3)}f}"


def _gain(difference: dict[str, Any] | None) -> str:
    if difference is None:
        return ""
    low, high = difference["ci95"]
    return f"{_short(difference['mean'])} [{_short(low)}, {_short(high)}]"


def final_return(rows: Sequence[Row]) -> float | None:
    """Mean return of the whole episodes that ended in the last tenth of the updates; None if none did."""
    last = rows[-max(1, len(rows) // 10) :]
    pairs = [(row[MAIN], row["episodes"]) for row in last if row.get(MAIN) is not None]
    episodes = sum(count for _, count in pairs)
    return sum(value * count for value, count in pairs) / episodes if episodes else None


def plot_curve(path: Path, rows: Sequence[Row], title: str, baselines: dict[str, float]) -> None:
    """Draws returns over decisions as a PNG.

    Args:
        path: file to write; its directory is made.
        rows: of metrics.jsonl.
        title: heading.
        baselines: mean returns of other policies, drawn as level lines.

    Raises:
        ImportError: matplotlib is not installed.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    there = [row for row in rows if row.get(MAIN) is not None]
    steps = np.array([row["env_steps"] for row in there])
    figure = Figure(figsize=(8, 5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    if there and "per_seed" in there[0]:
        seeds = np.array([row["per_seed"][MAIN] for row in there], np.float64).T
        for number, values in enumerate(seeds):
            axes.plot(
                steps,
                values,
                color="C0",
                alpha=0.35,
                lw=1,
                label="one seed" if number == 0 else None,
            )
    axes.plot(steps, [row[MAIN] for row in there], color="C0", lw=2, label="PPO, while it learns")
    for number, (name, value) in enumerate(sorted(baselines.items(), key=lambda item: -item[1])):
        axes.axhline(value, color=f"C{number + 1}", ls="--", lw=1.2, label=f"{name}, {value:.4g}")
    axes.set_xlim(0, max((row["env_steps"] for row in rows), default=1))
    axes.set_xlabel("decisions in all environments")
    axes.set_ylabel("mean return of the whole episodes that ended")
    axes.set_title(title)
    axes.grid(alpha=0.3)
    axes.legend(loc="best", fontsize="small")
    if not there:
        axes.text(0.5, 0.5, "no whole episode ended", ha="center", transform=axes.transAxes)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)

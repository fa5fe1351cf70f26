"""Reports the findings as tables for readers and as numbers for JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.verification.validation.measures import Findings
from benchmarks.verification.validation.sections import FLOW_MINUTES

# Rows of the table by demand: a figure of `measures.summarise`, its title, its digits, its factor.
ROWS = (
    ("asked_main_per_h", "ask to enter at x = 0, /h", 0, 1.0),
    ("asked_ramps_per_h", "ask to enter by ramps, /h", 0, 1.0),
    ("entered_main_per_h", "entered at x = 0, /h", 0, 1.0),
    ("entered_ramps_per_h", "entered by ramps, /h", 0, 1.0),
    ("flow_last_mean", "flow behind the last ramp, /h/lane", 0, 1.0),
    ("speed_last_mean", "speed there, m/s", 1, 1.0),
    ("flow_max", "highest flow of 5 minutes, /h/lane", 0, 1.0),
    ("discharge", "while a queue stands, /h/lane", 0, 1.0),
    ("breakdown_x_m", "breakdown before x, m", 0, 1.0),
    ("flow_before_breakdown", "highest flow there before it, /h/lane", 0, 1.0),
    ("flow_after_breakdown", "flow there after it, /h/lane", 0, 1.0),
    ("capacity_drop", "capacity drop, %", 1, 100.0),
    ("travel_mean_s", "travel time, s", 0, 1.0),
    ("travel_p95_s", "travel time, 95th percentile, s", 0, 1.0),
    ("ramp_stop_share", "ramp vehicles that stop, %", 1, 100.0),
    ("ramp_standing_mean_s", "standing on the ramp, s", 1, 1.0),
    ("ramp_standing_max_s", "longest, s", 0, 1.0),
    ("merge_speed_median", "merging speed, median, m/s", 1, 1.0),
    ("merge_relative_speed_median", "by the right lane's", 2, 1.0),
    ("merge_relative_speed_p5", "5th percentile", 2, 1.0),
    ("merge_lane_used_median", "acceleration lane used", 2, 1.0),
    ("merge_accepted_gap_median_s", "accepted gap, median, s", 1, 1.0),
    ("merge_accepted_gap_min_s", "smallest, s", 2, 1.0),
    ("follower_acceleration_p5", "followers' braking, 5th percentile, m/s2", 1, 1.0),
    ("lane_changes_per_km", "lane changes a vehicle and km", 2, 1.0),
    ("undone_share", "undone in 6 s, %", 1, 100.0),
    ("lateral_acceleration_max", "largest lateral acceleration, m/s2", 1, 1.0),
    ("standing_s_per_h", "standing on the main road, s/h", 0, 1.0),
    ("idle_s_per_h", "with 60 m free ahead, s/h", 0, 1.0),
    ("collisions", "collisions, vehicles' ticks", 0, 1.0),
    ("in_one_place", "two bodies in one place, pairs and seconds", 0, 1.0),
)


def shown(value: float, digits: int) -> str:
    """Formats a number; NaN is a dash."""
    return "-" if math.isnan(value) else f"{value:,.{digits}f}"


def table_by_demand(figures: dict[str, dict[str, dict[str, Any]]]) -> list[str]:
    """Lines of a Markdown table with a row per figure and a column per demand and simulator."""
    columns = [(demand, name) for demand, of in figures.items() for name in of]
    lines = ["| | " + " | ".join(f"{demand}, {name}" for demand, name in columns) + " |"]
    lines.append("|---" + "|---:" * len(columns) + "|")
    for figure, title, digits, factor in ROWS:
        cells = [shown(factor * figures[demand][name][figure], digits) for demand, name in columns]
        lines.append(f"| {title} | " + " | ".join(cells) + " |")
    return lines


def table_of_ranges(checks: Sequence[dict[str, Any]], simulators: Sequence[str]) -> list[str]:
    """Lines of a Markdown table of measurements beside their ranges; "(outside)" marks a value outside its range."""
    lines = [f"| | {' | '.join(simulators)} | range | source |"]
    lines.append("|---" + "|---:" * len(simulators) + "|---|---|")
    for check in checks:
        cells = [_cell(check["measured"][name]) for name in simulators]
        low, high = check["low"], check["high"]
        span = f"{low:g} to {high:g}" if high < math.inf else f"{low:g} or more"
        lines.append(
            f"| {check['text']} | {' | '.join(cells)} | {'0' if low == high else span} | {check['source']} |"
        )
    return lines


def _cell(measured: dict[str, Any]) -> str:
    value, holds = measured["value"], measured["holds"]
    digits = 0 if abs(value) >= 100.0 else 3
    text = shown(value, digits)
    if not math.isnan(measured["half_width"]):
        text += f" ± {shown(measured['half_width'], digits)}"
    return f"{text} (outside)" if holds is False else text


def diagram_points(findings: Sequence[Findings]) -> dict[str, Any]:
    """The fundamental diagram: 5-minute means of each detector and lane, rounded.

    Returns lists by name: `x_m` (D,), `flow` in vehicles/h and `density` in vehicles/km, both (spans, D, lanes).
    """

    def means(values: np.ndarray) -> np.ndarray:
        """Means of successive FLOW_MINUTES, or of all minutes if there are fewer."""
        span = min(FLOW_MINUTES, len(values))
        spans = values[: len(values) // span * span].reshape(-1, span, *values.shape[1:])
        return spans.mean(axis=1)

    flow = np.concatenate([means(found.diagram.flow) for found in findings])
    density = np.concatenate([means(found.diagram.density) for found in findings])
    return {
        "x_m": findings[0].diagram.x_m.tolist(),
        "flow": flow.round(1).tolist(),
        "density": density.round(2).tolist(),
    }


def history(findings: Sequence[Findings]) -> dict[str, Any]:
    """Means over episodes by minute: flow behind the last ramp, and the lowest speed at any detector before it."""
    flow = np.mean([found.diagram.flow_per_lane()[:, -1] for found in findings], axis=0)
    speeds = np.stack([found.diagram.speed()[:, :-1] for found in findings])
    slowest = np.where(np.isnan(speeds), np.inf, speeds).min(axis=-1).mean(axis=0)
    return {"flow": flow.round(1).tolist(), "slowest_speed": slowest.round(2).tolist()}


def for_json(value: Any) -> Any:
    """Replaces NaN and infinity, which JSON lacks, by None."""
    if isinstance(value, dict):
        return {name: for_json(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [for_json(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

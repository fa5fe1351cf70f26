"""Figures over space and time: one episode on the road, and dispatches beside the need for them.

Every plot function writes a PNG, and raises ImportError without matplotlib.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from medjax.render.colors import MED_COLOR, SOC_SCALE, css, soc_color
from medjax.world.params import RoadParams
from train.reporting.figures import new_figure, save
from train.reporting.survey import Survey
from train.reporting.traces import Frame, Trace

MED, CHARGING = "#C3E3CC", css(MED_COLOR)  # the player's green, which no charge has
SENT, RAN_OUT = "#0072B2", "#D55E00"  # see COLOURS
TIME_BINS = 30  # of the maps


def plot_episode(
    path: Path, trace: Trace, road: RoadParams, every_s: tuple[float, float], title: str
) -> dict[str, int]:
    """Draws a time-space diagram: EVs coloured by charge, MEDs, dispatches, and where EVs ran out.

    Gas vehicles are left out, because there are ten for each EV.

    Args:
        path: file to write.
        trace: trace of one episode.
        road: geometry of the road.
        every_s: s per round, and s per decision of the policy.
        title: heading.

    Returns:
        Numbers of marks, `sent` and `depleted`.
    """
    figure = new_figure(12, 7.5)
    axes = figure.add_subplot()
    round_s, _ = every_s
    lines = _draw_vehicles(axes, trace.frames, round_s)
    marked = _draw_marks(axes, trace, road, every_s)
    figure.colorbar(lines, ax=axes, label="state of charge of an EV", pad=0.01)
    ramps = axes.secondary_yaxis("right")
    places = [float(x) for x in road.ramp_x_m]
    ramps.set_yticks(places, [f"ramp {number}" for number in range(1, 1 + len(places))])
    for place in places:
        axes.axhline(place, color="black", lw=0.6, ls=":")
    end_s = (len(trace.frames.ev_x) - 1) * round_s
    axes.set(xlim=(0, end_s), ylim=(0, float(road.length_m)), title=title)
    axes.set(xlabel="time (s)", ylabel="position along the road (m)")
    figure.legend(loc="outside lower center", ncols=5, frameon=False)
    save(figure, path)
    return marked


def _segments(on_road: Any, x: Any, round_s: float) -> tuple[Any, Any]:
    """Line segments `(S, 2, 2)` of (time, position) from frames `(F + 1, V)`, and which moves they are, `(F, V)`."""
    # A slot is reused one frame after it empties at the earliest, so both ends belong to the same vehicle.
    there = on_road[:-1]
    time, slot = np.nonzero(there)
    starts = np.stack([time * round_s, x[time, slot]], axis=-1)
    ends = np.stack([(time + 1) * round_s, x[time + 1, slot]], axis=-1)
    return np.stack([starts, ends], axis=1), there


def _draw_vehicles(axes: Any, frames: Frame, round_s: float) -> Any:
    """Draws MEDs as broad lines, and over them EVs as thin lines coloured by charge; returns the latter."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap

    lines, there = _segments(frames.med_on_road, frames.med_x, round_s)
    charges = (frames.med_charges[:-1] > 0)[there]
    axes.add_collection(LineCollection(lines, colors=MED, lw=4, label="MED", zorder=1))
    style: dict[str, Any] = {"colors": CHARGING, "lw": 6, "zorder": 2}
    axes.add_collection(LineCollection(lines[charges], label="MED that charges EVs", **style))
    lines, there = _segments(frames.ev_on_road, frames.ev_x, round_s)
    charge = LinearSegmentedColormap.from_list("charge", list(map(css, SOC_SCALE)))
    axes.add_collection(LineCollection(lines, colors="white", lw=2.2, zorder=2.5))  # an outline
    drawn = LineCollection(lines, cmap=charge, lw=1.2, zorder=3)
    drawn.set_array(frames.ev_soc[:-1][there])
    drawn.set_clim(0.0, 1.0)
    axes.add_collection(drawn)
    axes.plot([], [], color=css(soc_color(0.4)), lw=1.6, label="EV, coloured by its charge")
    return drawn


def _draw_marks(
    axes: Any, trace: Trace, road: RoadParams, every_s: tuple[float, float]
) -> dict[str, int]:
    """Marks where MEDs are sent and where EVs run out; returns the number of each."""
    frames, (round_s, decision_s) = trace.frames, every_s
    empty, there = frames.ev_soc <= 0.0, frames.ev_on_road
    ran_out, slot = np.nonzero((there[:-1] | there[1:]) & empty[1:] & ~(there & empty)[:-1])
    sent = np.nonzero(trace.sent)[0]
    style: dict[str, Any] = {"ls": "none", "zorder": 4, "clip_on": False}
    there, ramp = frames.ev_x[1 + ran_out, slot], np.asarray(road.ramp_x_m)[trace.sent[sent] - 1]
    cross = style | {"marker": "x", "color": RAN_OUT, "ms": 7, "mew": 2}
    axes.plot((ran_out + 1) * round_s, there, label=f"EV runs out ({len(ran_out)})", **cross)
    arrow = style | {"marker": "^", "color": SENT, "ms": 10, "mec": "white"}
    axes.plot(sent * decision_s, ramp, label=f"MED is sent ({len(sent)})", **arrow)
    return {"sent": len(sent), "depleted": len(ran_out)}


def plot_dispatch(
    path: Path,
    shown: Mapping[str, int],
    seen: Survey,
    ramp_x_m: np.ndarray,
    decision_s: float,
    choice: int,
) -> None:
    """Draws maps of when and where MEDs are sent and needed, a row of two maps per policy.

    Args:
        path: file to write.
        shown: policies, and their indices in `seen`.
        seen: survey of all episodes.
        ramp_x_m: (R,) m, at least one.
        decision_s: s per decision of the policy.
        choice: decisions per choice of the trained policy; a bin of time covers a whole number of choices.
    """
    decisions = seen.sent.shape[1]
    width = choice * -(-decisions // (TIME_BINS * choice))
    edges = np.unique([*range(0, decisions, width), decisions])
    per_minute = 60.0 / decision_s / seen.episodes
    sent = {name: _in_bins(seen.sent[index] * per_minute, edges) for name, index in shown.items()}
    needs = seen.need / seen.episodes
    need = {name: _in_bins(needs[index], edges) for name, index in shown.items()}
    figure = new_figure(13, 0.8 + 2.6 * len(shown))
    panels = figure.subplots(len(shown), 2, sharex=True, sharey=True, squeeze=False)
    ramps = np.arange(len(ramp_x_m) + 1) + 0.5
    most = max(1e-9, *(values.max() for values in sent.values()))
    extreme = max(1e-9, *(np.abs(values).max() for values in need.values()))
    grid = edges * decision_s, ramps
    labels = [f"ramp {n}\n{x:.0f} m" for n, x in enumerate(ramp_x_m, 1)]
    for row, name in zip(panels, shown, strict=True):
        left = row[0].pcolormesh(*grid, sent[name].T, cmap="Blues", vmin=0, vmax=most)
        right = row[1].pcolormesh(*grid, need[name].T, cmap="PuOr_r", vmin=-extreme, vmax=extreme)
        row[0].set_title(f"{name}: MEDs sent", fontsize="medium")
        row[1].set_title(f"{name}: need", fontsize="medium")
        row[0].set_yticks(np.arange(1, len(ramps)), labels)
    figure.colorbar(left, ax=panels[:, 0], label="MEDs per minute", aspect=30)
    figure.colorbar(right, ax=panels[:, 1], label="EVs without a slot, less free slots", aspect=30)
    figure.supxlabel("time (s)")
    save(figure, path)


def _in_bins(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Means of values `(T, R)` over time bins with edges `(bins + 1,)`, `(bins, R)`."""
    sums = np.add.reduceat(np.asarray(values, np.float64), edges[:-1], axis=0)
    return sums / np.diff(edges)[:, None]

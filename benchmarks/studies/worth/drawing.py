"""The map as a picture: a panel for each combination of further axes, and a line around the cases in which MEDs pay."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.worth.axes import Axis, points
from train.reporting.figures import new_figure, save

# Purple where MEDs cost, orange where they pay: every colour vision tells them apart.
COLOURS = "PuOr_r"
MOST_PANELS = 3  # in a row


@dataclasses.dataclass(frozen=True)
class Panel:
    """A part of the map with two axes."""

    title: str
    x: Axis
    y: Axis
    gain: np.ndarray  # (y, x) EUR an hour
    is_sure: np.ndarray  # (y, x) bool, the interval is on one side of 0


def panels_of(report: Mapping[str, Any]) -> list[Panel]:
    """The panels of a report of `benchmarks.worth`: its first axis is x, its second y."""
    axes = [Axis(name, tuple(values)) for name, values in report["axes"].items()]
    x, y = axes[0], axes[1] if len(axes) > 1 else Axis("", (0.0,))
    cells = {tuple(cell["at"].values()): cell for cell in report["cells"]}
    found = []
    for others in points(axes[2:]):
        shape = len(y.values), len(x.values)
        gain, is_sure = np.empty(shape), np.empty(shape, bool)
        for row, column in np.ndindex(*shape):
            own = (x.values[column], y.values[row])[: len(axes)]
            cell = cells[(*own, *others.values())]
            gain[row, column], is_sure[row, column] = cell["gain_mean"], cell["pays"] != "open"
        title = ", ".join(axis.label(others[axis.name]) for axis in axes[2:])
        found.append(Panel(title, x, y, gain, is_sure))
    return found


def edges(pays: np.ndarray) -> Iterator[tuple[tuple[float, float], tuple[float, float]]]:
    """Edges (x, y), (x, y) between neighbours of `(y, x)` bool of which one pays and the other does not."""
    for row, column in np.argwhere(pays[:, 1:] != pays[:, :-1]):
        yield (column + 0.5, row - 0.5), (column + 0.5, row + 0.5)
    for row, column in np.argwhere(pays[1:] != pays[:-1]):
        yield (column - 0.5, row + 0.5), (column + 0.5, row + 0.5)


def draw(path: Path, panels: Sequence[Panel]) -> None:
    """Draws the panels in one scale of colours and writes the PNG."""
    columns = min(MOST_PANELS, len(panels))
    lines = math.ceil(len(panels) / columns)
    figure = new_figure(3.2 * columns + 1.0, 2.4 * lines + 0.9)
    grid = figure.subplots(lines, columns, squeeze=False)
    most = max(float(np.abs(panel.gain).max()) for panel in panels) or 1.0
    for number, axes in enumerate(grid.flat):
        if number < len(panels):
            image = _draw_panel(axes, panels[number], most)
        else:
            axes.set_axis_off()
    figure.colorbar(image, ax=grid, label="EUR an hour on the better of none and slow", shrink=0.8)
    figure.suptitle(
        "What the best dispatcher gains; bold: sure; the line is where MEDs begin to pay"
    )
    save(figure, path)


def _draw_panel(axes: Any, panel: Panel, most: float) -> Any:
    image = axes.imshow(panel.gain, COLOURS, vmin=-most, vmax=most, origin="lower", aspect="auto")
    for (row, column), gain in np.ndenumerate(panel.gain):
        weight = "bold" if panel.is_sure[row, column] else "normal"
        ink = "white" if abs(gain) > 0.6 * most else "black"
        axes.text(
            column, row, f"{gain:+.0f}", ha="center", va="center", color=ink, weight=weight, size=8
        )
    for (x0, y0), (x1, y1) in edges(panel.gain > 0.0):
        axes.plot((x0, x1), (y0, y1), color="black", linewidth=2.0)
    for axis, ticks, name in (
        (panel.x, axes.set_xticks, axes.set_xlabel),
        (panel.y, axes.set_yticks, axes.set_ylabel),
    ):
        ticks(range(len(axis.values)), [*map(axis.number, axis.values)])
        name(axis.heading)
    axes.set_title(panel.title, fontsize=9)
    return image

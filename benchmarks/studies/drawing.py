"""Figures of studies."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from train.reporting.figures import MARKERS, colour, save


def draw_rows(
    axes: Any, rows: Sequence[Mapping[str, Any]], x: str, y: str, number: int, **style: Any
) -> None:
    """Draws means of one policy's rows, with the intervals that they have along either axis.

    Args:
      axes: of a figure.
      rows: of a report.
      x, y: keys of the rows.
      number: of the policy, for its marker.
      style: for matplotlib's `errorbar`.
    """
    for name, metric in (("xerr", x), ("yerr", y)):
        if f"{metric}_ci95" in rows[0]:
            low = [row[metric] - row[f"{metric}_ci95"][0] for row in rows]
            high = [row[f"{metric}_ci95"][1] - row[metric] for row in rows]
            style[name] = (low, high)
    style = {"color": colour(rows[0]["policy"]), **style}
    means = ([row[metric] for row in rows] for metric in (x, y))
    axes.errorbar(*means, capsize=3, marker=MARKERS[number % len(MARKERS)], **style)


def finish(
    figure: Any, panels: Mapping[Any, tuple[str, str]], title: str, columns: int, path: Path
) -> None:
    """Labels the panels, puts one legend under all of them, and writes the PNG.

    Args:
      figure: with the panels.
      panels: labels of x and y by axes; all show the same policies.
      title: of the figure.
      columns: of the legend, at most.
      path: of the PNG.
    """
    for axes, (x, y) in panels.items():
        axes.set(xlabel=x, ylabel=y)
        axes.grid(alpha=0.3)
    handles, labels = next(iter(panels)).get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(columns, len(labels)))
    figure.suptitle(title)
    save(figure, path)

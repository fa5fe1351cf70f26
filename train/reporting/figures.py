"""Figures of numbers: the training curve, the comparison of policies, and the EVs' charge.

Every plot function writes a PNG, and raises ImportError without matplotlib.
"""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from medjax.files import replacing
from train.algorithms.settings import SETTINGS
from train.evaluation.statistics import bootstrap_ci95, interquartile_mean
from train.evaluation.tables import (
    COLUMNS,
    PAPER_CLAIMS,
    PAPER_MEDS,
    SAMPLED,
    START,
    interval_of_seeds,
    short,
)
from train.reporting.survey import SOC_BINS, Survey, quantile
from train.runs.logs import MAIN, Row
from train.settings import TrainConfig

# Okabe and Ito (2008): colour-blind readers can tell these apart, too.
COLOURS = {
    **dict.fromkeys((kind.algorithm for kind in SETTINGS), "#0072B2"),
    "forecast": "#E69F00",
    "paced": "#009E73",
    "greedy": "#56B4E9",
    "periodic": "#CC79A7",
    "random": "#D55E00",
}
OTHER = "#555555"
MARKERS = "osD^vPX*<>"  # of policies in their order, so that they differ in more than colour
DASHES = {  # of the rules: some share a colour, or look alike to colour-blind readers
    "budgeted": (0, (8, 2)),
    "forecast": "--",
    "paced": "-.",
    "slow": (0, (2, 2)),
    "greedy": (0, (3, 1, 1, 1)),
    "random": ":",
    "periodic": (0, (6, 2, 1, 2, 1, 2)),
    "none": (0, (1, 3)),
    START: (0, (10, 1, 1, 1)),
    START + SAMPLED: (0, (10, 1, 1, 1, 1, 1)),
}
PANELS = {  # of the comparison, by metric: title with the unit
    "depleted_share": "share of EVs that run out",
    "mean_range_m": "mean range of an EV (m)",
    "mean_soc": "mean state of charge",
    "meds_dispatched": "MEDs sent",
}
NUM_RESAMPLES = 2000  # at every point of the curve
MOST_POINTS = 60  # of the curve; the few episodes of one update show luck rather than learning


def new_figure(width: float, height: float) -> Any:
    """An empty figure, in inches, that needs no display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Any, path: Path) -> None:
    """Writes a PNG in full or not at all, and makes its directory."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial:
        figure.savefig(partial, dpi=130)


def colour(policy: str) -> str:
    """The colour of a policy, the same in all figures and for all training seeds."""
    return COLOURS.get(policy.removesuffix(SAMPLED).split("_seed")[0], OTHER)


def look(policy: str) -> dict[str, Any]:
    """Colour and dashes of a policy's line; learned policies are solid, and dotted where they sample."""
    usual = (0, (1, 1)) if policy.endswith(SAMPLED) else "-"
    return {"color": colour(policy), "ls": DASHES.get(policy, usual)}


def plot_curve(
    path: Path, rows: Sequence[Row], config: TrainConfig, baselines: Mapping[str, float]
) -> None:
    """Draws returns over decisions; with several seeds, their interquartile mean and its interval.

    Args:
        path: file to write; its directory is made.
        rows: rows of metrics.jsonl.
        config: settings of the run.
        baselines: mean returns of other policies, drawn as horizontal lines. The legend alone has those that are so
            far away that the curve would look flat beside them.
    """
    from matplotlib.ticker import EngFormatter

    figure = new_figure(9, 5)
    axes = figure.add_subplot()
    steps, seeds = averaged(*curve_of(rows))
    num_seeds = seeds.shape[1]
    learner, own = config.algorithm.upper(), colour(config.algorithm)
    label = f"{learner} learning" + (f", {num_seeds} seeds" if num_seeds > 1 else "")
    axes.plot(steps, interquartile_mean(seeds), color=own, lw=2, label=label)
    if num_seeds > 1:
        ends = [bootstrap_ci95(place, 0, NUM_RESAMPLES, interquartile_mean) for place in seeds]
        low, high = np.reshape(ends, (-1, 2)).T
        band: dict[str, Any] = {"color": own, "alpha": 0.25, "lw": 0}
        axes.fill_between(steps, low, high, label=interval_of_seeds(num_seeds), **band)
    bottom, top = limits_of_curve(seeds, baselines.values())
    for name, value in sorted(baselines.items(), key=lambda item: -item[1]):
        place = "" if bottom <= value <= top else ", below" if value < bottom else ", above"
        axes.axhline(value, label=f"{name}, {short(value)}{place}", lw=1.6, **look(name))
    axes.set_ylim(bottom, top)
    axes.set_xlim(0, max((row["env_steps"] / num_seeds for row in rows), default=1))
    axes.xaxis.set_major_formatter(EngFormatter())
    axes.set_xlabel("decisions in all environments" + (" of a seed" if num_seeds > 1 else ""))
    axes.set_ylabel("mean return of the whole episodes that ended")
    axes.set_title(f"{learner} on {config.scenario}, {config.num_envs} environments")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", fontsize="small", frameon=False)
    if not len(steps):
        axes.text(0.5, 0.5, "no whole episode ended", ha="center", transform=axes.transAxes)
    save(figure, path)


def limits_of_curve(seeds: np.ndarray, lines: Collection[float]) -> tuple[float, float]:
    """Lowest and highest return to show.

    The picture holds the curve `(points, seeds)`, and each line that is no further from it than the curve is high.
    """
    curve = seeds if seeds.size else np.array([*lines] or [0.0])
    low, high = float(curve.min()), float(curve.max())
    far = max(high - low, 1.0)
    near = [line for line in lines if low - far <= line <= high + far]
    low, high = min([low, *near]), max([high, *near])
    margin = 0.05 * max(high - low, 1.0)
    return low - margin, high + margin


def curve_of(rows: Sequence[Row]) -> tuple[np.ndarray, np.ndarray]:
    """Decisions per seed `(updates,)` and returns `(updates, seeds)`, where every seed ended an episode."""
    returns = [row["per_seed"][MAIN] if "per_seed" in row else [row.get(MAIN)] for row in rows]
    num_seeds = len(returns[-1]) if rows else 1
    there = [number for number, values in enumerate(returns) if None not in values]
    steps = np.array([rows[number]["env_steps"] / num_seeds for number in there])
    curve = np.array([returns[number] for number in there], np.float64)
    return steps, curve.reshape(-1, num_seeds)


def averaged(steps: np.ndarray, seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A curve of `curve_of` in at most `MOST_POINTS` points, each the mean of consecutive updates."""
    updates = np.array_split(np.arange(len(steps)), max(min(len(steps), MOST_POINTS), 1))
    points = [(steps[own].mean(), seeds[own].mean(axis=0)) for own in updates if own.size]
    places, means = zip(*points, strict=True) if points else ((), ())
    return np.array(places), np.array(means).reshape(-1, seeds.shape[1])


def plot_comparison(
    path: Path, scores: Mapping[str, Mapping[str, np.ndarray]], seed: int, papers: bool
) -> None:
    """Draws Figure 8: a panel per metric, a bar per policy, with 95 % intervals of the means and the paper's claims.

    Args:
        path: file to write.
        scores: scores of `medjax.episodes.scores.evaluate_policies`.
        seed: seed of the bootstrap.
        papers: the scores are of the paper's own world, so that its claims apply and are drawn.
    """
    names = sorted(scores, key=lambda name: scores[name]["return"].mean())  # the best on top
    figure = new_figure(11, 2 + 0.45 * len(names))
    panels, forms = figure.subplots(2, 2, sharey=True), dict(COLUMNS.values())
    for axes, (metric, title) in zip(panels.flat, PANELS.items(), strict=True):
        highest = _bars(axes, {name: scores[name][metric] for name in names}, forms[metric], seed)
        if papers and (metric not in PAPER_CLAIMS or "none" in scores):
            claim, wording = PAPER_MEDS, f"{PAPER_MEDS:.0f}"
            if metric in PAPER_CLAIMS:
                claim = PAPER_CLAIMS[metric] * scores["none"][metric].mean()
                wording = f"none {PAPER_CLAIMS[metric] - 1:+.0%}"
            axes.axvline(claim, color="black", ls="--", lw=1.2)
            title, highest = f"{title}; dashed: the paper's claim, {wording}", max(highest, claim)
        axes.set_xlim(0, 1.18 * highest if highest > 0.0 else 1.0)
        axes.set_title(title, fontsize="medium")
        axes.grid(axis="x", alpha=0.3)
    save(figure, path)


def _bars(axes: Any, samples: Mapping[str, np.ndarray], form: str, seed: int) -> float:
    """Draws a bar per mean, from the bottom up, with its 95 % interval and its number; returns the highest end."""
    places = np.arange(len(samples))
    means = np.array([values.mean() for values in samples.values()])
    ends = np.array([bootstrap_ci95(values, seed) for values in samples.values()])
    axes.barh(places, means, color=[colour(name) for name in samples], height=0.7)
    errors = np.abs(ends.T - means)
    axes.errorbar(means, places, xerr=errors, fmt="none", ecolor="black", capsize=3, lw=1)
    box = {"fc": "white", "ec": "none", "pad": 1}
    beside: dict[str, Any] = {"textcoords": "offset points", "va": "center", "bbox": box}
    for place, mean, (_, high) in zip(places, means, ends, strict=True):
        axes.annotate(format(mean, form), (high, place), (6, 0), **beside)
    axes.set_yticks(places, list(samples))
    return float(ends.max())


def plot_soc(path: Path, names: Sequence[str], seen: Survey, decision_s: float) -> None:
    """Draws the charge of the EVs on the road over time: a panel per policy, with median and quantile bands.

    Args:
        path: file to write.
        names: names of the policies, in the order of `seen`.
        seen: survey of all episodes.
        decision_s: s per decision.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    columns = min(4, len(names))
    rows = -(-len(names) // columns)
    figure = new_figure(3 * columns, 0.9 + 2.4 * rows)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    times = np.arange(seen.soc.shape[1]) * decision_s
    for index, (axes, name) in enumerate(zip(panels, names, strict=False)):
        for low, alpha in ((0.05, 0.2), (0.25, 0.35)):
            ends = [100 * quantile(seen.soc[index], share) for share in (low, 1 - low)]
            axes.fill_between(times, *ends, color=colour(name), alpha=alpha, lw=0)
        axes.plot(times, 100 * quantile(seen.soc[index], 0.5), color=colour(name), lw=2)
        if "none" in names and name != "none":
            without = quantile(seen.soc[names.index("none")], 0.5)
            axes.plot(times, 100 * without, color="black", ls=":", lw=1.2)
        axes.set_title(name, fontsize="medium")
        axes.set(xlim=(0, times[-1]), ylim=(0, 100))
        axes.tick_params(labelbottom=index + columns >= len(names))
        axes.grid(alpha=0.3)
    keys = [
        Line2D([], [], color=OTHER, lw=2, label="median"),
        Patch(color=OTHER, alpha=0.55, lw=0, label="middle 50 %"),
        Patch(color=OTHER, alpha=0.2, lw=0, label="middle 90 %"),
        Line2D([], [], color="black", ls=":", lw=1.2, label="median with none"),
    ]
    figure.legend(handles=keys, loc="outside upper center", ncols=len(keys), frameon=False)
    figure.supxlabel("time (s)")
    figure.supylabel("state of charge (%)")
    save(figure, path)


def plot_exit_soc(path: Path, names: Sequence[str], seen: Survey) -> None:
    """Draws the share of EVs that end their trip below a state of charge; `names` are in the order of `seen`."""
    figure = new_figure(9, 5)
    axes = figure.add_subplot()
    edges = np.linspace(0, 100, SOC_BINS + 1)
    for index, name in enumerate(names):
        below = seen.depleted[index] + np.concatenate([[0], np.cumsum(seen.exit_soc[index])])
        share = below / max(below[-1], 1)
        axes.plot(edges, share, lw=2, label=name, **look(name))
    axes.set(xlim=(0, 100), ylim=(0, 1), ylabel="share of EVs that end below it")
    axes.set_xlabel("state of charge at the end of the road (%); at 0: EVs that ran out")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    save(figure, path)

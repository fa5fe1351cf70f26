"""The numbers of a run as tables: rows of cells, and how they are printed."""

import math
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from medjax.errors import shown
from train.evaluation.statistics import FEWEST

Table = list[list[str]]  # the first row holds the headings, the first column what a row is of

COLUMNS = {  # of the table: heading, metric, format
    "depleted share": ("depleted_share", ".3f"),
    "mean range m": ("mean_range_m", ".0f"),
    "mean SoC": ("mean_soc", ".3f"),
    "MEDs sent": ("meds_dispatched", ".2f"),
}
BALANCE = {  # what slow driving does, what charging does, and what they cost; per EV, or of an episode
    "saved kWh/EV": ("ev_saved_kwh", ".3f"),
    "received kWh/EV": ("ev_received_kwh", ".3f"),
    "EV delay h": ("ev_delay_h", ".2f"),
    "other delay h": ("gas_delay_h", ".2f"),
    "MEDs drove kWh": ("med_driving_kwh", ".1f"),
    "sent kWh": ("energy_sent_kwh", ".1f"),
    "lost kWh": ("energy_lost_kwh", ".1f"),
    "system efficiency": ("system_efficiency", ".3f"),
    # where MEDs are agents
    "told m/s": ("told_speed", ".1f"),
    "refusing": ("refusing_share", ".3f"),
    "left early": ("left_early", ".2f"),
}
START = "start"  # name of a learner's policy before any update
AGENTS = "told_speed"  # a metric that there is where MEDs are agents
TERM = "reward_"  # begins the metrics that are terms of the reward
PAPER_TABLE_2 = {  # mean and standard deviation of the episode's reward, by policy
    "random": (-332.4056918, 53.94543289),
    "none": (-521.874184, 16.52914886),
    "ppo": (0.340361448, 0.141114801),
}
PAPER_CLAIMS = {  # of its policy: metric, what no action gives times this (Figure 8)
    "depleted_share": 0.5,
    "mean_range_m": 1.25,
    "mean_soc": 1.2,
}
PAPER_MEDS = 15.0
DEPLETED_SHARE = (
    "Share of EVs that run out, or depleted share: of all EVs that were on the road in the episode."
)


def format_table(result: Mapping[str, Any], learned: Sequence[str]) -> str:
    """The tables of an evaluation: policies, best return first, and what a trained one does against no action.

    Args:
        result: of `train.evaluation.summary.summarize`.
        learned: names of the learned policies, that of the first training seed first, if there are any; so below.
    """
    parts = [f"{headline(result)}\n{format_rows(comparison_rows(result, learned))}"]
    parts += [said] if (said := unseen(result, learned)) else []
    parts += [format_rows(terms)] if len((terms := reward_rows(result))[0]) > 1 else []
    balance = balance_rows(result)
    parts += [format_rows(balance)] if len(balance[0]) > 1 else []
    if seeds := result.get("training_seeds"):
        means = ", ".join(map(short, seeds["return_means"]))
        middle = f"{short(seeds['interquartile_mean'])} {interval(seeds['ci95'])}"
        gains = seeds["paired_return_differences"]
        sure = interval_of_seeds(len(gains))
        lines = [f"training seeds: {means}; interquartile mean, {sure}: {middle}"]
        others = [name for name, _ in best_first(result) if name in gains[0]]
        for other in dict.fromkeys([*others[:1], *({START} & {*others})]):
            each = ", ".join(_gain(gain[other]) for gain in gains)
            lines.append(f"each minus {other}, 95 % CI: {each}")
        parts.append("\n".join(lines))
    if "change_against_none" in result:
        parts.append(format_rows(claim_rows(result, learned)))
    return "\n\n".join(parts)


def trained(learned: Sequence[str]) -> str:
    """What is compared with the rules: the learned policy, or with several training seeds their mean in an episode."""
    return learned[0] if len(learned) == 1 else f"mean of {len(learned)} seeds"


def interval_of_seeds(count: int) -> str:
    """What the bootstrap's interval over so many training seeds is; that of a few is little more than their range."""
    return "95 % CI" if count >= FEWEST else f"bootstrap over {count}"


def interval_of_mean(learned: Sequence[str]) -> str:
    """What the interval of `trained` is: over episodes, and with several training seeds over these, too."""
    several = len(learned) > 1
    return f"{interval_of_seeds(len(learned))} and episodes" if several else "95 % CI"


def headline(result: Mapping[str, Any]) -> str:
    """What was played."""
    changed = [f"{name} = {shown(value)}" for name, value in result.get("overrides", {}).items()]
    changed += [f"reward of {', '.join(terms)}"] if (terms := result.get("reward")) else []
    world = result["scenario"] + (f" ({', '.join(changed)})" if changed else "")
    seed = f" of seed {result['seed']}" if "seed" in result else ""
    return f"{result['episodes']} whole episodes of {world}{seed}, the same for every policy"


def is_papers(result: Mapping[str, Any]) -> bool:
    """Whether the paper's figures are of this world: its preset, as it is, with a dispatcher and its reward."""
    agents = any(AGENTS in entry for entry in result["policies"].values())
    changed = result.get("overrides") or result.get("reward") or agents
    return result["scenario"] == "paper" and not changed


def unseen(result: Mapping[str, Any], learned: Sequence[str]) -> str:
    """What the episodes, or the training seeds, are too few to tell, in words; empty where each difference has a sign.

    It is of the differences from the baseline; where there is none, of the trained policy's from the best rule.
    """
    other, differences = result.get("baseline"), result.get("difference_from_baseline", {})
    few = f"{result['episodes']} episodes"
    if other is None and (ours := result.get("paired_return_difference")):
        other = next(name for name, _ in best_first(result) if name in ours)
        differences = {trained(learned): ours[other]}
        few = f"{len(learned)} seeds and {few}" if len(learned) > 1 else few
    lines = []
    for name, difference in differences.items():
        low, high = difference["ci95"]
        if low == high == 0.0:
            each = f"each of the {result['episodes']} episodes"
            lines.append(f"{name} returned what {other} did in {each}.")
        elif low <= 0.0 <= high:
            lines.append(
                f"No difference between {name} and {other} can be seen with {few}: "
                f"{_gain(difference)}; one of {short((high - low) / 2)} could be."
            )
    return "\n".join(lines)


def format_rows(table: Table) -> str:
    """A table as text: the first column to the left, numbers to the right, a line under the headings."""
    widths = [max(len(row[column]) for row in table) for column in range(len(table[0]))]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip()
        for row in table
    ]
    lines.insert(1, "-" * max(map(len, lines)))
    return "\n".join(lines)


def comparison_rows(result: Mapping[str, Any], learned: Sequence[str]) -> Table:
    """Return and metrics of every policy, best return first; metrics that one of them lacks are left out."""
    columns = _in_all(COLUMNS, result)
    rows = [["policy", "return", "95 % CI", *columns]]
    differences: Mapping[str, Any] | None = None
    if "baseline" in result:
        rows[0].append(f"minus {result['baseline']}, 95 % CI")
        differences = result["difference_from_baseline"]
    elif learned:
        rows[0].append(f"{trained(learned)} minus it, {interval_of_mean(learned)}")
        differences = result.get("paired_return_difference", {})
    for name, entry in best_first(result):
        cells = [name, short(entry["return_mean"]), interval(entry["return_ci95"])]
        cells += [format(entry[metric], form) for metric, form in columns.values()]
        if differences is not None:
            cells.append(_gain(differences[name]) if name in differences else "")
        rows.append(cells)
    return rows


def balance_rows(result: Mapping[str, Any]) -> Table:
    """What each policy saves, gives and costs, best return first."""
    columns = _in_all(BALANCE, result)
    rows = [
        [name, *(format(entry[metric], form) for metric, form in columns.values())]
        for name, entry in best_first(result)
    ]
    return [["policy", *columns], *rows]


def reward_rows(result: Mapping[str, Any]) -> Table:
    """What each weighted term of the reward adds to the return, best return first; without those that are always 0."""
    entries = best_first(result)
    names = dict.fromkeys(name for _, entry in entries for name in entry if name.startswith(TERM))
    there = [name for name in names if any(entry.get(name) for _, entry in entries)]
    rows = [[policy, *(short(entry.get(name, 0.0)) for name in there)] for policy, entry in entries]
    return [["return from", *(name.removeprefix(TERM) for name in there)], *rows]


def _in_all(columns: Mapping[str, tuple[str, str]], result: Mapping[str, Any]) -> dict[str, Any]:
    """The columns whose metric is a number of every policy."""
    entries = result["policies"].values()
    return {
        heading: (metric, form)
        for heading, (metric, form) in columns.items()
        if all(entry.get(metric) is not None for entry in entries)
    }


def paper_rows(result: Mapping[str, Any], learned: Sequence[str]) -> Table:
    """Table 2 of the paper, in its own world, and the same numbers of every policy here; best return first."""
    rows = [["policy", "paper, mean (std)", "here, mean (std)", "95 % CI of the mean"]]
    for name, entry in best_first(result):
        theirs = PAPER_TABLE_2.get(name)
        paper = spread(*theirs) if theirs else "-"
        here = spread(entry["return_mean"], entry["return_std"])
        rows.append([name, paper, here, interval(entry["return_ci95"])])
    if seeds := result.get("training_seeds"):
        count = len(seeds["return_means"])
        what = f"{learned[0]}, interquartile mean of {count} seeds, {interval_of_seeds(count)}"
        rows.append([what, "-", short(seeds["interquartile_mean"]), interval(seeds["ci95"])])
    return rows if is_papers(result) else [[row[0], *row[2:]] for row in rows]


def claim_rows(result: Mapping[str, Any], learned: Sequence[str]) -> Table:
    """What the trained policy does against no action, and in the paper's world what the paper claims of its own."""
    rows = [["against no action", "paper", f"{trained(learned)} here, {interval_of_mean(learned)}"]]
    ours = [result["policies"][name] for name in learned]
    for heading, (metric, form) in COLUMNS.items():
        if metric in PAPER_CLAIMS:
            change = result.get("change_against_none", {}).get(metric)
            here = "-"  # where no action gives 0 there is no share of it
            if change:
                low, high = change["ci95"]
                here = f"{change['mean']:+.1%} [{low:+.1%}, {high:+.1%}]"
            rows.append([heading, f"{PAPER_CLAIMS[metric] - 1:+.0%}", here])
        elif all(entry.get(metric) is not None for entry in ours):
            mean = fmean(entry[metric] for entry in ours)
            rows.append([heading, format(PAPER_MEDS, ".0f"), format(mean, form)])
    return rows if is_papers(result) else [[row[0], row[2]] for row in rows]


def _gain(difference: Mapping[str, Any]) -> str:
    """A mean and its interval."""
    return f"{short(difference['mean'])} {interval(difference['ci95'])}"


def best_first(result: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Policies and their entries, by falling mean return."""
    return sorted(result["policies"].items(), key=lambda item: -item[1]["return_mean"])


def spread(mean: float, std: float) -> str:
    """A mean and, in brackets, its standard deviation."""
    return f"{short(mean)} ({short(std)})"


def interval(ends: Sequence[float]) -> str:
    """Lower and upper end."""
    return f"[{short(ends[0])}, {short(ends[1])}]"


def short(value: float) -> str:
    """A number with about four digits, three of them at most after the point."""
    digits = 3 if not value else max(0, 3 - max(0, math.floor(math.log10(abs(value)))))
    return f"{value:.{min(digits, 3)}f}"

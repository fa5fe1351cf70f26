"""Tables of an evaluation: rows of cells, and their layout as text."""

import math
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from medjax.errors import shown
from train.evaluation.statistics import FEWEST

Table = list[list[str]]  # the first row holds the headings, the first column names the rows

COLUMNS = {  # of the main table, by heading: metric, format
    "depleted share": ("depleted_share", ".3f"),
    "mean range m": ("mean_range_m", ".0f"),
    "mean SoC": ("mean_soc", ".3f"),
    "MEDs sent": ("meds_dispatched", ".2f"),
}
BALANCE = {  # effects of slow driving and of charging, and their costs; per EV, or per episode
    "saved kWh/EV": ("ev_saved_kwh", ".3f"),
    "received kWh/EV": ("ev_received_kwh", ".3f"),
    "EV delay h": ("ev_delay_h", ".2f"),
    "other delay h": ("gas_delay_h", ".2f"),
    "MEDs drove kWh": ("med_driving_kwh", ".1f"),
    "sent kWh": ("energy_sent_kwh", ".1f"),
    "lost kWh": ("energy_lost_kwh", ".1f"),
    "system efficiency": ("system_efficiency", ".3f"),
    # only if MEDs are agents
    "told m/s": ("told_speed", ".1f"),
    "refusing": ("refusing_share", ".3f"),
    "left early": ("left_early", ".2f"),
}
START = "start"  # name of a learner's initial policy
SAMPLED = "_sampled"  # ends the name of a policy that samples; without it, it takes the most probable action
AGENTS = "told_speed"  # a metric that exists only if MEDs are agents
TERM = "reward_"  # prefix of the metrics that are terms of the reward
PAPER_TABLE_2 = {  # mean and standard deviation of an episode's reward, by policy
    "random": (-332.4056918, 53.94543289),
    "none": (-521.874184, 16.52914886),
    "ppo": (0.340361448, 0.141114801),
}
PAPER_CLAIMS = {  # for the paper's policy: metric, as a multiple of that of no action (Figure 8)
    "depleted_share": 0.5,
    "mean_range_m": 1.25,
    "mean_soc": 1.2,
}
PAPER_MEDS = 15.0
DEPLETED_SHARE = (
    "Share of EVs that run out, or depleted share: of all EVs that were on the road in the episode."
)


def format_table(result: Mapping[str, Any], learned: Sequence[str]) -> str:
    """The tables of an evaluation: the policies, best return first, and a trained policy against no action.

    Args:
        result: result of `train.evaluation.summary.summarize`.
        learned: names of the learned policies, in the order of their training seeds; may be empty. The functions below
            take the same.
    """
    parts = [f"{headline(result)}\n{format_rows(comparison_rows(result, learned))}"]
    parts += [said] if (said := unseen(result, learned)) else []
    parts += [format_rows(terms)] if len((terms := reward_rows(result))[0]) > 1 else []
    balance = balance_rows(result)
    parts += [format_rows(balance)] if len(balance[0]) > 1 else []
    if "training_seeds" in result:
        parts.append("\n".join(_lines_of_seeds(result)))
    if "change_against_none" in result:
        parts.append(format_rows(claim_rows(result, learned)))
    return "\n\n".join(parts)


def _lines_of_seeds(result: Mapping[str, Any]) -> list[str]:
    """The training seeds on their own, and each against the best rule and the initial policy."""
    seeds = result["training_seeds"]
    means = ", ".join(map(short, seeds["return_means"]))
    middle = f"{short(seeds['interquartile_mean'])} {interval(seeds['ci95'])}"
    gains = seeds["paired_return_differences"]
    sure = interval_of_seeds(len(gains))
    lines = [f"training seeds: {means}; interquartile mean, {sure}: {middle}"]
    others = [name for name in _not_sampled(result) if name in gains[0]]
    best_rule = [name for name in others if name != START][:1]
    for other in [*best_rule, *({START} & {*others})]:
        each = ", ".join(_gain(gain[other]) for gain in gains)
        lines.append(f"each minus {other}, 95 % CI: {each}")
    return lines


def trained(learned: Sequence[str]) -> str:
    """What is compared with the rules: the learned policy, or the mean over several training seeds in an episode."""
    return learned[0] if len(learned) == 1 else f"mean of {len(learned)} seeds"


def interval_of_seeds(count: int) -> str:
    """Name of the bootstrap interval over training seeds; that of a few seeds is little more than their range."""
    return "95 % CI" if count >= FEWEST else f"bootstrap over {count}"


def interval_of_mean(learned: Sequence[str]) -> str:
    """Name of the interval of `trained`: over episodes, and with several training seeds also over these."""
    several = len(learned) > 1
    return f"{interval_of_seeds(len(learned))} and episodes" if several else "95 % CI"


def headline(result: Mapping[str, Any]) -> str:
    """The episodes and the environment of an evaluation, in words."""
    changed = [f"{name} = {shown(value)}" for name, value in result.get("overrides", {}).items()]
    changed += [f"reward of {', '.join(terms)}"] if (terms := result.get("reward")) else []
    world = result["scenario"] + (f" ({', '.join(changed)})" if changed else "")
    seed = f" of seed {result['seed']}" if "seed" in result else ""
    return f"{result['episodes']} whole episodes of {world}{seed}, the same for every policy"


def is_papers(result: Mapping[str, Any]) -> bool:
    """Whether the paper's numbers apply: its preset, unchanged, with its reward and a dispatcher."""
    agents = any(AGENTS in entry for entry in result["policies"].values())
    changed = result.get("overrides") or result.get("reward") or agents
    return result["scenario"] == "paper" and not changed


def unseen(result: Mapping[str, Any], learned: Sequence[str]) -> str:
    """Names the differences whose sign the episodes and training seeds leave open; empty if there are none.

    It covers the differences from the baseline, or without one that of the trained policy from the best rule.
    """
    other, differences = result.get("baseline"), result.get("difference_from_baseline", {})
    few = f"{result['episodes']} episodes"
    if other is None:
        ours = result.get("paired_return_difference", {})
        other = next((name for name in _not_sampled(result) if name in ours), None)
        differences = {trained(learned): ours[other]} if other is not None else {}
        few = f"{len(learned)} seeds and {few}" if len(learned) > 1 else few
    lines = []
    for name, difference in differences.items():
        low, high = difference["ci95"]
        if low is None or high is None:
            continue  # a return was not finite
        if low == high == 0.0:
            lines.append(
                f"{name} returned what {other} did in each of the {result['episodes']} episodes."
            )
        elif low <= 0.0 <= high:
            lines.append(
                f"No difference between {name} and {other} can be seen with {few}: "
                f"{_gain(difference)}; one of {short((high - low) / 2)} could be."
            )
    return "\n".join(lines)


def format_rows(table: Table) -> str:
    """A table as text: first column left-aligned, numbers right-aligned, a line under the headings."""
    widths = [max(len(row[column]) for row in table) for column in range(len(table[0]))]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip()
        for row in table
    ]
    lines.insert(1, "-" * max(map(len, lines)))
    return "\n".join(lines)


def comparison_rows(result: Mapping[str, Any], learned: Sequence[str]) -> Table:
    """Return and metrics of every policy, best return first, without metrics that a policy lacks."""
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
        cells += _cells(columns, entry)
        if differences is not None:
            cells.append(_gain(differences[name]) if name in differences else "")
        rows.append(cells)
    return rows


def balance_rows(result: Mapping[str, Any]) -> Table:
    """Savings, charge and costs of each policy, best return first."""
    columns = _in_all(BALANCE, result)
    rows = [[name, *_cells(columns, entry)] for name, entry in best_first(result)]
    return [["policy", *columns], *rows]


def reward_rows(result: Mapping[str, Any]) -> Table:
    """Contribution of each weighted reward term to the return, best return first, without terms that are always 0."""
    entries = best_first(result)
    names = dict.fromkeys(name for _, entry in entries for name in entry if name.startswith(TERM))
    there = [name for name in names if any(entry.get(name) for _, entry in entries)]
    rows = [[policy, *(short(entry.get(name, 0.0)) for name in there)] for policy, entry in entries]
    return [["return from", *(name.removeprefix(TERM) for name in there)], *rows]


def _in_all(columns: Mapping[str, tuple[str, str]], result: Mapping[str, Any]) -> dict[str, Any]:
    """The columns whose metric is a number for every policy."""
    entries = result["policies"].values()
    return {
        heading: (metric, form)
        for heading, (metric, form) in columns.items()
        if all(entry.get(metric) is not None for entry in entries)
    }


def _cells(columns: Mapping[str, tuple[str, str]], entry: Mapping[str, Any]) -> list[str]:
    return [format(entry[metric], form) for metric, form in columns.values()]


def paper_rows(result: Mapping[str, Any], learned: Sequence[str]) -> Table:
    """Mean and spread of every policy's return, best first; in the paper's own world beside its Table 2."""
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
    """The trained policy against no action; in the paper's own world beside the paper's claims."""
    rows = [["against no action", "paper", f"{trained(learned)} here, {interval_of_mean(learned)}"]]
    ours = [result["policies"][name] for name in learned]
    for heading, (metric, form) in COLUMNS.items():
        if metric in PAPER_CLAIMS:
            change = result.get("change_against_none", {}).get(metric)
            here = "-"  # undefined if the policy "none" gives 0
            if change:
                low, high = change["ci95"]
                here = f"{change['mean']:+.1%} [{low:+.1%}, {high:+.1%}]"
            rows.append([heading, f"{PAPER_CLAIMS[metric] - 1:+.0%}", here])
        elif all(entry.get(metric) is not None for entry in ours):
            mean = fmean(entry[metric] for entry in ours)
            rows.append([heading, format(PAPER_MEDS, ".0f"), format(mean, form)])
    return rows if is_papers(result) else [[row[0], row[2]] for row in rows]


def _gain(difference: Mapping[str, Any]) -> str:
    return f"{short(difference['mean'])} {interval(difference['ci95'])}"


def best_first(result: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Policies and their entries, in order of decreasing mean return; those whose mean is not finite come last."""

    def worse(item: tuple[str, Mapping[str, Any]]) -> float:
        mean = item[1]["return_mean"]
        return math.inf if mean is None else -mean

    return sorted(result["policies"].items(), key=worse)


def _not_sampled(result: Mapping[str, Any]) -> list[str]:
    """Names of the policies that do not sample, in the order of `best_first`."""
    return [name for name, _ in best_first(result) if not name.endswith(SAMPLED)]


def spread(mean: float | None, std: float | None) -> str:
    """A mean and, in brackets, the standard deviation."""
    return f"{short(mean)} ({short(std)})"


def interval(ends: Sequence[float | None]) -> str:
    """Lower and upper end, in brackets."""
    return f"[{short(ends[0])}, {short(ends[1])}]"


def short(value: float | None) -> str:
    """A number with about four digits, at most three of them after the point; "-" if it is None or not finite."""
    if value is None or not math.isfinite(value):
        return "-"
    digits = 3 if not value else max(0, 3 - max(0, math.floor(math.log10(abs(value)))))
    return f"{value:.{min(digits, 3)}f}"

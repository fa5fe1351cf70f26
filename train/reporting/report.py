"""Makes a report: plays the episodes, draws the figures, and writes the page."""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from medjax.commandline import in_words
from medjax.env.charging_env import ChargingEnv
from medjax.env.observation import NEED_WINDOW_S
from medjax.episodes.scores import Scores, evaluate_policies
from medjax.files import write_json
from medjax.policies.policy import Policy
from medjax.policies.rules import BASELINES
from medjax.world.params import EnvParams
from train.evaluation.statistics import interquartile_mean
from train.evaluation.summary import learned_names, returns_of_rules, summarize
from train.evaluation.tables import (
    DEPLETED_SHARE,
    balance_rows,
    best_first,
    claim_rows,
    comparison_rows,
    format_rows,
    headline,
    is_papers,
    paper_rows,
    short,
)
from train.reporting.conclusions import counts, difference, learning, lost, reached
from train.reporting.diagrams import plot_dispatch, plot_episode
from train.reporting.figures import (
    curve_of,
    plot_comparison,
    plot_curve,
    plot_exit_soc,
    plot_soc,
)
from train.reporting.page import Picture, Section, write_page
from train.reporting.survey import Survey, dispatch_rows, survey, total
from train.reporting.traces import Trace, record
from train.reporting.words import TERMS, policies_in_words
from train.runs.logs import read_rows
from train.runs.run_directory import PLAYS, RunDir
from train.settings import TrainConfig, to_json

SENDS_NONE = ("slow", "none")  # rules that send no MED
PICTURES = ("training_curve", "comparison", "time_space", "soc_over_time", "soc_at_end", "dispatch")


@dataclasses.dataclass(frozen=True)
class Played:
    """Results of the episodes."""

    env: ChargingEnv  # a single environment
    params: EnvParams
    seed: int  # selects the episodes
    scores: Mapping[str, Scores]  # of all policies
    result: dict[str, Any]  # of `train.evaluation.summary.summarize`
    names: list[str]  # recorded policies: the rules, and the first seed's trained policy
    seen: Survey  # of the recorded policies
    first: Trace  # the trained policy's first episode

    @property
    def best_rule(self) -> str:
        """Of the rules that send MEDs, the one with the highest mean return."""
        senders = [name for name in BASELINES if name not in SENDS_NONE]
        return next(name for name, _ in best_first(self.result) if name in senders)


def play(
    env: ChargingEnv,
    params: EnvParams,
    config: TrainConfig,
    policies: Mapping[str, Policy],
    episodes: int,
    seed: int,
) -> Played:
    """Evaluates all policies, then records the same episodes."""
    print(f"evaluating {len(policies)} policies on {episodes} episodes each", flush=True)
    scores = evaluate_policies(env, params, policies, episodes, seed)
    ours = config.algorithm
    recorded = {name: policies[name] for name in policies if name in (ours, *BASELINES)}
    print(f"recording {len(recorded)} of them on the same episodes", flush=True)
    surveys: list[Survey] = []
    for trace in record(env, params, recorded, episodes, seed):
        if not surveys:
            first = jax.tree.map(lambda leaf: leaf[0, list(recorded).index(ours)], trace)
        surveys.append(survey(trace, env.config.rounds_per_decision))
        done = sum(int(part.episodes) for part in surveys)
        print(f"recorded {done} of {episodes} episodes", flush=True)
    result = summarize(scores, config.scenario, learned_names(scores), seed, config.changes)
    return Played(env, params, seed, scores, result, list(recorded), total(surveys), first)


def draw(run_dir: RunDir, config: TrainConfig, played: Played) -> None:
    """Draws all figures."""
    path = _pictures(run_dir)
    names, seen, road = played.names, played.seen, played.params.road
    round_s, decision_s = played.env.config.round_s, played.env.config.decision_s
    step_s = decision_s * played.env.decisions_per_step
    rules = returns_of_rules(played.result)
    plot_curve(path["training_curve"], read_rows(run_dir.metrics), config, rules)
    plot_comparison(path["comparison"], played.scores, played.seed, is_papers(played.result))
    ours = config.algorithm
    title = f"{ours}, first episode of seed {played.seed}, return {short(float(played.first.reward.sum()))}"
    plot_episode(path["time_space"], played.first, road, (round_s, step_s), title)
    plot_soc(path["soc_over_time"], names, seen, decision_s)
    plot_exit_soc(path["soc_at_end"], names, seen)
    shown = {name: names.index(name) for name in (ours, played.best_rule)}
    ramps = np.asarray(road.ramp_x_m)
    plot_dispatch(path["dispatch"], shown, seen, ramps, step_s, config.decide_every)


def write(run_dir: RunDir, config: TrainConfig, played: Played) -> None:
    """Prints conclusion and tables, writes the page with them and the figures, and the numbers to evaluation.json."""
    title = headline(played.result)
    conclusion = conclude(config, played)
    print("", *conclusion, sep="\n")
    parts = sections(run_dir, config, played)
    for part in parts:
        if part.tables:
            print("", part.title, *map(format_rows, part.tables), sep="\n")
    print(f"\n{title}; {config.algorithm} takes {PLAYS}")
    write_json(run_dir.report / "evaluation.json", played.result)
    write_page(
        run_dir.report / "report.html",
        f"Report of {run_dir.path.resolve().name}",
        conclusion,
        parts,
    )


def _pictures(run_dir: RunDir) -> dict[str, Path]:
    return {name: run_dir.report / f"{name}.png" for name in PICTURES}


def conclude(config: TrainConfig, played: Played) -> list[str]:
    """What the page begins with: EVs that reach their exit, and what that costs others; of the first seed."""
    ours, best, seen, scores = config.algorithm, played.best_rule, played.seen, played.scores
    first = f", the first of {config.num_seeds} seeds" if config.num_seeds > 1 else ""
    done = {
        ours: f"with the trained policy ({ours}{first})",
        best: f"with the best rule ({best})",
        "slow": "if EVs low on charge drive slowly, without any charging truck (slow)",
        "none": "if nothing is done (none)",
    }
    index = [played.names.index(name) for name in done]
    left, ran_out, stopped = (
        seen.exit_soc[index].sum(axis=1),
        seen.depleted[index],
        seen.stops[index],
    )
    all_of_them = np.maximum(left + ran_out, 1)
    shares, stops = (left - stopped) / all_of_them, stopped / all_of_them
    minutes = {name: 60.0 * scores[name]["gas_delay_h"] for name in done}
    means = [float(np.mean(minutes[name])) for name in done]
    decisions = int(played.params.episode_decisions)
    duration = in_words(decisions * played.env.config.decision_s)
    fewer = 100.0 * (scores[ours]["depleted_share"] - scores[best]["depleted_share"])
    more = minutes[ours] - minutes["none"]
    reach, leave = (dict(zip(done.values(), each, strict=True)) for each in (shares, stops))
    return [
        reached(reach, leave)
        + " "
        + difference("EVs of 100 that run out", (ours, best), fewer, played.seed),
        lost(dict(zip(done.values(), means, strict=True)), duration)
        + " "
        + difference("Minutes lost by others", (ours, "none"), more, played.seed),
    ]


def concluded(run_dir: RunDir, config: TrainConfig, played: Played) -> dict[str, str]:
    """A sentence on what each figure shows, by its name; it covers the first training seed only."""
    scores, ours, best = played.scores, config.algorithm, played.best_rule

    def against(other: str, what: str, metric: str) -> str:
        """Compares a metric of the trained policy with another policy's."""
        gains = scores[ours][metric] - scores[other][metric]
        return difference(what, (ours, other), gains, played.seed)

    def beside(what: str, metric: str) -> str:
        """Compares the trained policy's first episode with the mean of all."""
        samples = scores[ours][metric]
        return counts(what, samples[0], samples, played.seed)

    _, returns = curve_of(read_rows(run_dir.metrics))
    return {
        "training_curve": learning(interquartile_mean(returns)),
        "comparison": against(best, "Return", "return")
        + " "
        + against(best, "Share of EVs that run out", "depleted_share"),
        "time_space": beside("EVs that run out", "evs_depleted")
        + " "
        + beside("MEDs sent", "meds_dispatched"),
        "soc_over_time": against("none", "Mean charge of the EVs on the road, 0 to 1", "mean_soc"),
        "soc_at_end": against("none", "Mean charge where an EV's way ends, 0 to 1", "exit_soc"),
        "dispatch": against(best, "MEDs sent in an episode", "meds_dispatched"),
    }


def sections(run_dir: RunDir, config: TrainConfig, played: Played) -> list[Section]:
    """The sections of the page, with the figures from `draw`."""
    result, learned = played.result, learned_names(played.scores)
    said = concluded(run_dir, config, played)
    path = {name: Picture(path, said[name]) for name, path in _pictures(run_dir).items()}
    theirs = "; the paper's are of ten" if is_papers(result) else ""
    return [
        _words(config, played),
        Section(
            "Figure 7: the training curve",
            "Mean return of the whole episodes that ended in an update. With several seeds the line is their "
            "interquartile mean, and the band its bootstrap interval. Dashed: mean returns of the rules, and of "
            "the policy that learning starts from, on the episodes of this report. The paper trained for 400,000 "
            "decisions.",
            pictures=[path["training_curve"]],
        ),
        Section(
            "Table 2: reward of an episode",
            f"Mean and standard deviation over episodes{theirs}.",
            tables=[paper_rows(result, learned)],
        ),
        Section(
            "Figure 8: comparison of the policies",
            "EVs that run out, the distance that an EV covers on the road, the mean charge of the EVs on it, and the "
            f"MEDs sent. Bars: means; whiskers: 95 % intervals. {DEPLETED_SHARE}",
            tables=[claim_rows(result, learned), comparison_rows(result, learned)],
            pictures=[path["comparison"]],
        ),
        Section(
            "Driving slowly, and charging",
            "EVs behind a MED drive slowly, and what that saves comes without any charge: energy saved against the "
            "EVs' own desired speeds beside energy received, what both cost in time, and what the fleet takes from "
            "its depots.",
            tables=[balance_rows(result)],
        ),
        Section(
            "One episode of the trained policy",
            "Each line is a vehicle. Vehicles with combustion engines are left out.",
            pictures=[path["time_space"]],
        ),
        Section(
            "State of charge of the EVs",
            "First: of the EVs on the road; line: median, bands: the middle 50 % and 90 %, dotted: median with no "
            "MEDs. Second: of EVs when they come to the end of the road or run out; the share at 0 is of these, and so "
            "above the depleted share, which is of those still on the road, too.",
            pictures=[path["soc_over_time"], path["soc_at_end"]],
        ),
        Section(
            "Where and when MEDs are sent, and needed",
            f"Need of a ramp: EVs that will need a MED from there within {NEED_WINDOW_S:.0f} s and have no slot, less "
            "the free slots near by, as the policy sees it. Maps: means over episodes, of the trained policy and of "
            "the best rule.",
            tables=[dispatch_rows(played.names, played.seen)],
            pictures=[path["dispatch"]],
        ),
        Section("Settings", "Of the run.", verbatim=json.dumps(to_json(config), indent=2)),
    ]


def _words(config: TrainConfig, played: Played) -> Section:
    """What was played, and what the page's terms and names mean."""
    names = [name for name, _ in best_first(played.result)]
    return Section(
        "What the words mean",
        f"{headline(played.result)}. The trained policy, {config.algorithm}, takes {PLAYS}. Brackets hold the 95 % "
        "interval of a mean, by the bootstrap over episodes, and over training seeds where it is their mean.",
        terms=TERMS | policies_in_words(names),
    )

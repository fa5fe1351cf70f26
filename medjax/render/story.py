"""The player's texts on policies and the episode's end, and the time at which it opens."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from medjax.env.metrics import episode_metrics
from medjax.episodes.recording import Recording
from medjax.episodes.verdict import COUNTED, LINES, NAMES
from medjax.errors import InputError
from medjax.files import check_input
from medjax.policies.given import RUN
from medjax.policies.pretrained import PRETRAINED, PRETRAINED_SAMPLED
from medjax.policies.rules import BASELINES

LEARNED = {
    "ppo": "Learned by trial and error in simulation (PPO).",
    PRETRAINED: "Comes with medjax, learned by trial and error in simulation (PPO).",
    PRETRAINED_SAMPLED: "Comes with medjax, learned in simulation (PPO); draws each action by its probability.",
}
BEFORE_S = 3.0  # the player opens this long before the first charge
KNOWN = Path(__file__).parent / "known"  # evaluations of presets, by name


def words_for(policy: str) -> str:
    """A sentence on a policy, for a rule the first line of its docstring; "" if the policy is unknown."""
    rule = BASELINES.get(policy)
    if rule is None:
        of_seed = "ppo" if policy.startswith(RUN) else policy.split("_")[0]
        return LEARNED.get(policy, LEARNED.get(of_seed, ""))
    first = (rule.__doc__ or "").split("\n")[0]
    # Functions and units of arguments are for programmers only.
    plain = re.sub(r" \(`[^`]*`\)|_s\b", "", first)
    return plain.replace("`", "")


def first_charge_s(recordings: Sequence[Recording]) -> float:
    """A time just before any recording's first charge, s; 0 if nobody is charged."""
    found = [
        np.flatnonzero(np.asarray(each.frames.ev_is_charging).any(axis=1)) for each in recordings
    ]
    first = min((int(frames[0]) for frames in found if len(frames)), default=0)
    return max(0.0, first * recordings[0].config.tick_s - BEFORE_S)


def verdict(recordings: Sequence[Recording]) -> list[dict[str, Any]]:
    """Rows that compare whole episodes; `better` is 1 if more is better, -1 if less, 0 if neither."""
    found = [_metrics(each) for each in recordings]
    names = ("title", "about", "digits", "better")
    return [
        {name: getattr(line, name) for name in names}
        | {"values": [line.of(metrics) for metrics in found]}
        for line in LINES
    ]


def _metrics(recording: Recording) -> dict[str, float]:
    """Metrics, return and terms of the reward of the whole episode, by the names of its scores."""
    decisions = recording.decisions
    total = jax.tree.map(lambda each: np.sum(each, axis=0, dtype=np.float64), decisions.stats)
    metrics = {name: float(value) for name, value in episode_metrics(total).items()}
    for name, values in decisions.reward_terms.items():
        metrics[f"reward_{name}"] = float(np.sum(values, dtype=np.float64))
    return {**metrics, "return_mean": float(np.sum(decisions.reward, dtype=np.float64))}


def ending(recordings: Sequence[Recording], evaluation: Mapping[str, Any] | None) -> str:
    """A line on how many EVs run out with each policy, beside the mean of many episodes if that is known."""
    crosses = [_metrics(each)["evs_depleted"] for each in recordings]
    names = [each.policy for each in recordings]
    if len(names) == 1:
        said = f"{crosses[0]:.0f} EVs run out"
    else:
        said = f"{crosses[0]:.0f} EVs run out with {names[0]}, {crosses[1]:.0f} with {names[1]}"
    known = evaluation["policies"] if evaluation else {}
    if evaluation is None or not all(name in known for name in names):
        return f"{said} in this episode (one is luck as much as skill)"
    many = " and ".join(f"{known[name]['evs_depleted']:.1f}" for name in names)
    return f"{said} in this episode; {many} in the mean of {evaluation['episodes']}"


def known_evaluation(scenario: str, policies: Sequence[str]) -> dict[str, Any] | None:
    """Means of many episodes of an unchanged preset; None unless they cover all of the policies.

    The episodes are those of the leaderboard: `python -m benchmarks.leaderboard --again` writes both.
    """
    path = KNOWN / f"{scenario}.json"
    if not path.is_file():
        return None
    found = read_evaluation(path)
    return found if all(name in found["policies"] for name in policies) else None


def own_evaluation(path: Path, scenario: str, policies: Sequence[str]) -> dict[str, Any] | None:
    """A run's closing evaluation; None if there is none for this scenario and any of the policies."""
    try:
        found = read_evaluation(path)
    except InputError:  # no error: the user did not name this file
        return None
    known = any(name in found["policies"] for name in policies)
    # An episode that is rendered has the preset's reward.
    same = found["scenario"] == scenario and "reward" not in found
    return found if same and known else None


def read_evaluation(path: Path) -> dict[str, Any]:
    """Reads what `python -m train.evaluate --json` wrote.

    Raises:
      InputError: one line; there is no such file, or it is not an evaluation.
    """
    check_input("--evaluation", path)
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        for entry in found["policies"].values():
            pairs = [entry["return_ci95"], *entry.get("verdict_ci95", {}).values()]
            numbers = [
                *(entry[name] for name in NAMES),
                *(entry[name] for name in COUNTED if name in entry),
                *(end for low, high in pairs for end in (low, high)),
            ]
            if not all(isinstance(number, int | float) for number in numbers):
                raise TypeError
        sound = (
            isinstance(found["episodes"], int)
            and isinstance(found["scenario"], str)
            and isinstance(found.get("overrides", {}), dict)
            and all(isinstance(name, str) for name in found.get("reward", []))
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        sound = False
    if not sound:
        allowed = "allowed a file that train.evaluate --json wrote, with finite numbers"
        raise InputError(f"--evaluation {path}: {allowed}")
    return dict(found)


def means(evaluation: Mapping[str, Any], recordings: Sequence[Recording]) -> list[Any]:
    """The verdict over many episodes: a row of texts for each recording's policy, None if it was not evaluated.

    Raises:
      InputError: the evaluation is of another preset, or of none of the policies.
    """
    names = [each.policy for each in recordings]
    check_evaluation(evaluation, recordings[0].scenario, names)
    entries = [evaluation["policies"].get(name) for name in names]
    return [entry and _cells(entry) for entry in entries]


def check_evaluation(
    evaluation: Mapping[str, Any],
    scenario: str,
    policies: Sequence[str],
    overrides: Mapping[str, Any] | None = None,
) -> None:
    """Checks that an evaluation is of one of the policies in this world.

    Args:
      evaluation: as `read_evaluation` returns it.
      scenario: preset that is rendered; policies: by name.
      overrides: changes to the preset, whose reward is its own; None leaves both unchecked.

    Raises:
      InputError: it is not.
    """
    if evaluation["scenario"] != scenario:
        raise InputError(
            f"the evaluation is of {evaluation['scenario']}: allowed one of {scenario}"
        )
    if overrides is not None:
        changed, own = evaluation.get("overrides", {}), dict(overrides)
        if changed != own:
            raise InputError(
                f"the evaluation's changes to {scenario} are {json.dumps(changed)}: allowed {json.dumps(own)}"
            )
        if "reward" in evaluation:
            terms = ", ".join(evaluation["reward"])
            raise InputError(f"the evaluation's reward is {terms}: allowed that of {scenario}")
    if not any(name in evaluation["policies"] for name in policies):
        known = ", ".join(evaluation["policies"])
        raise InputError(f"the evaluation has {known}: allowed one with {policies[0]}")


def _cells(entry: Mapping[str, Any]) -> list[str]:
    """The means of a policy, with their 95 % intervals where these are known."""
    intervals = {"return": entry["return_ci95"], **entry.get("verdict_ci95", {})}
    cells = []
    for line in LINES:
        numbers = [f"{x:.{line.mean_digits}f}" for x in intervals.get(line.title, ())]
        interval = f" [{', '.join(numbers)}]" if numbers else ""
        cells.append(f"{line.of(entry):.{line.mean_digits}f}{interval}")
    return cells

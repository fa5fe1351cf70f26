"""Plays the worlds of a map, and keeps what was played in a file from which an interrupted map goes on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks.studies.worth.axes import Axis, Point, points, world_at
from medjax.episodes.scores import Evaluation, Scores
from medjax.errors import InputError
from medjax.files import write_text
from medjax.policies.policy import Policy

METRICS = ("return", "energy_delivered_kwh", "low_exits", "ev_delay_h", "gas_delay_h")


def fingerprint(params: Any, policies: Mapping[str, Policy]) -> str:
    """Tells worlds and policies apart whose names are the same: of all their numbers."""
    weights = {name: policy.weights for name, policy in policies.items()}
    leaves = jax.tree.leaves((params, weights))
    return hashlib.sha256(b"".join(np.asarray(leaf).tobytes() for leaf in leaves)).hexdigest()[:16]


class Kept:
    """Scores by key, also in a file if there is one, which is whole at any time.

    Args:
      path: of the file; None keeps them in memory only.
      about: what is played, in JSON types.

    Raises:
      InputError: the file holds another map, or is no such file.
    """

    def __init__(self, path: Path | None, about: Mapping[str, Any]) -> None:
        self.path, self.about = path, json.loads(json.dumps(about))
        self.found: dict[str, dict[str, Scores]] = {}
        if path is None or not path.exists():
            return
        try:
            held = json.loads(path.read_text(encoding="utf-8"))
            about_held, played = held["about"], held["played"]
            self.found = {key: _scores(played[key], np.array) for key in played}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            allowed = "allowed a new file, or one that --keep wrote"
            raise InputError(f"--keep {path}: {allowed}") from None
        if about_held != self.about:
            allowed = "allowed a new file, or the options and the version with which it began"
            raise InputError(f"--keep {path} holds another map: {allowed}")

    def put(self, key: str, scores: dict[str, Scores]) -> None:
        """Adds what was played."""
        self.found[key] = scores
        if self.path is not None:
            played = {key: _scores(self.found[key], np.ndarray.tolist) for key in self.found}
            write_text(self.path, json.dumps({"about": self.about, "played": played}) + "\n")


def _scores(scores: Mapping[str, Any], convert: Callable[[Any], Any]) -> dict[str, Any]:
    """Scores by policy and metric, converted to arrays or to lists."""
    return {
        name: {metric: convert(values) for metric, values in score.items()}
        for name, score in scores.items()
    }


class Player:
    """Plays policies in worlds that differ in numbers of `EnvParams`: one program, compiled at the first world.

    Args:
      env, params: of the preset.
      policies: by name.
      axes: those that make a difference to these policies.
      options: with `episodes` and `seed`.
    """

    def __init__(
        self,
        env: Any,
        params: Any,
        policies: Mapping[str, Policy],
        axes: Sequence[Axis],
        options: Any,
    ) -> None:
        self.env, self.params, self.policies = env, params, policies
        self.axes, self.options = axes, options
        self.evaluation: Evaluation | None = None

    @property
    def worlds(self) -> int:
        """Number of different worlds."""
        return len([*points(self.axes)])

    def play(self, point: Point, kept: Kept) -> dict[str, Scores]:
        """Scores of every policy at a point of the map, METRICS and weighted terms, `(episodes,)` each."""
        own = {axis.name: point[axis.name] for axis in self.axes}
        key = json.dumps([own, [*self.policies]])
        if key in kept.found:
            return kept.found[key]
        if self.evaluation is None:
            episodes = self.options.episodes
            self.evaluation = Evaluation(self.env, self.params, self.policies, episodes)
        world = world_at(self.env.config, self.params, own)
        played = self.evaluation.play(self.policies, self.options.seed, world)
        scores: dict[str, Scores] = {
            name: {
                metric: values
                for metric, values in score.items()
                if metric in METRICS or metric.startswith("reward_")
            }
            for name, score in played.items()
        }
        kept.put(key, scores)
        return scores

"""Plays the worlds of a map, and keeps what was played in a file from which an interrupted map goes on."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.worth.axes import Axis, Point, points, world_at
from medjax.episodes.scores import Evaluation, Scores
from medjax.errors import InputError
from medjax.files import write_text
from medjax.policies.policy import Policy

METRICS = ("return", "energy_delivered_kwh", "low_exits", "ev_delay_h", "gas_delay_h")


class Kept:
    """Scores by key, also in a file of JSON lines if there is one, whose first line says what is played.

    Args:
      path: of the file; None keeps them in memory only.
      about: what is played, in JSON types.

    Raises:
      InputError: the file holds another map, or is no such file.
    """

    def __init__(self, path: Path | None, about: Mapping[str, Any]) -> None:
        self.path = path
        self.found: dict[str, dict[str, Scores]] = {}
        if path is None:
            return
        if not path.exists():
            write_text(path, json.dumps(about) + "\n")
            return
        try:
            first, *lines = path.read_text(encoding="utf-8").splitlines()
            held = json.loads(first)
            # The last line is cut short where the command was killed as it wrote.
            for row in map(json.loads, (line for line in lines if line.endswith("}}}"))):
                self.found[row["key"]] = {
                    name: {metric: np.array(values) for metric, values in score.items()}
                    for name, score in row["scores"].items()
                }
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            allowed = "allowed a new file, or one that --keep wrote"
            raise InputError(f"--keep {path}: {allowed}") from None
        if held != json.loads(json.dumps(about)):
            allowed = "allowed a new file, or the options with which it began"
            raise InputError(f"--keep {path} holds another map: {allowed}")

    def put(self, key: str, scores: dict[str, Scores]) -> None:
        """Adds what was played; every line is written at once."""
        self.found[key] = scores
        if self.path is not None:
            plain = {
                name: {metric: values.tolist() for metric, values in score.items()}
                for name, score in scores.items()
            }
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"key": key, "scores": plain}) + "\n")


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

"""A comparison of policies as one object: its numbers, its rows for pandas, and the table that commands print."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from medjax.episodes.scores import Scores
from train.evaluation.tables import format_table


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Policies on the same episodes; it prints as the table of `train.evaluate`.

    Attributes:
        result: result of `train.evaluation.summary.summarize`, as `--json` writes it.
        scores: by policy, arrays `(episodes,)` of `return`, `length` and the environment's metrics.
        learned: names of the learned policies, one per training seed of one algorithm.
    """

    result: dict[str, Any]
    scores: Mapping[str, Scores]
    learned: Sequence[str] = ()

    def rows(self) -> list[dict[str, Any]]:
        """One flat row per policy, for `pandas.DataFrame(comparison.rows())`.

        An interval takes two columns, `_low` and `_high`. With a baseline, `minus_NAME` is the mean difference of
        returns in the same episode.
        """
        differences = self.result.get("difference_from_baseline", {})
        rows = []
        for name, entry in self.result["policies"].items():
            row = {"policy": name, **entry}
            del row["verdict_ci95"]  # its means are not among the columns
            if name in differences:
                minus = f"minus_{self.result['baseline']}"
                row |= {
                    minus: differences[name]["mean"],
                    f"{minus}_ci95": differences[name]["ci95"],
                }
            flat: dict[str, Any] = {}
            for column, value in row.items():
                if isinstance(value, list):
                    flat[f"{column}_low"], flat[f"{column}_high"] = value
                else:
                    flat[column] = value
            rows.append(flat)
        return rows

    def episodes(self) -> list[dict[str, Any]]:
        """One row per policy and episode."""
        return [
            {"policy": name, "episode": episode}
            | {column: float(values[episode]) for column, values in score.items()}
            for name, score in self.scores.items()
            for episode in range(self.result["episodes"])
        ]

    def __str__(self) -> str:
        return format_table(self.result, self.learned)

    __repr__ = __str__  # for notebooks

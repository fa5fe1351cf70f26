"""The rows of docs/parameters.md, so that tests cover new numbers automatically."""

import dataclasses
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs/parameters.md").read_text(encoding="utf-8")


@dataclasses.dataclass(frozen=True)
class Documented:
    """A row of docs/parameters.md."""

    name: str
    value: str
    low: float
    high: float

    @property
    def whole(self):
        """Sizes, counts and lanes."""
        leaf = self.name.rpartition(".")[2]
        return leaf.startswith("num_") or leaf in WHOLE


WHOLE = (
    *("ticks_per_round", "rounds_per_decision", "size", "service_lane", "depleted_blocks"),
    *("has_detectors", "episode_decisions", "incident_lane"),
)
NUMBERS = {
    name: Documented(name, value, *(float(end) for end in allowed.split(" to ")))
    for name, value, allowed in re.findall(
        r"^\| `([\w.]+)` \| ([^|]+?) \| ([^|]+?) \|", PAGE, re.MULTILINE
    )
}
COILS = [name for name in NUMBERS if "_coil_" in name]

"""Ranges observed on real roads and goals of this simulator, each with its source."""

from __future__ import annotations

import dataclasses
import math
from typing import Any


@dataclasses.dataclass(frozen=True)
class Range:
    """The range in which a figure under a demand should lie, both ends included."""

    figure: str  # of `measures.summarise`
    demand: str  # a name in `demands.DEMANDS`
    low: float
    high: float
    text: str
    source: str

    @property
    def is_goal(self) -> bool:
        """Whether this project set the range itself."""
        return self.source.startswith("a goal")

    def holds(self, value: float) -> bool | None:
        """Whether a value lies in the range; None if it is NaN."""
        return None if math.isnan(value) else self.low <= value <= self.high


ANY, GOAL = math.inf, "a goal of this project"
# Of each source we read the abstract or a quoted table; of those marked "from memory" we read nothing.
MERGING = (
    ("paper", "at the preset's demand"),
    ("merging", "4,500 and 4 x 300 vehicles/h"),
)
RANGES = (
    *(
        Range("ramp_stop_share", demand, 0.0, 0.005, f"ramp vehicles that stop, {where}", GOAL)
        for demand, where in MERGING
    ),
    *(
        Range(
            "merge_relative_speed_median",
            demand,
            0.85,
            1.1,
            f"merging speed by the right lane's, median, {where}",
            "a goal; AASHTO's Green Book designs acceleration lanes for merging within 8 km/h of traffic's "
            "speed, some 0.92 (from memory)",
        )
        for demand, where in MERGING
    ),
    *(
        Range(
            "follower_acceleration_p5",
            demand,
            -3.0,
            ANY,
            f"new follower's strongest braking in 5 s, 5th percentile, m/s2, {where}",
            "a goal; 90 % of drivers brake by 3.4 or more for what they did not expect: Fambro et al. 1997",
        )
        for demand, where in MERGING
    ),
    Range(
        "merge_lane_used_median",
        "paper",
        0.0,
        0.5,
        "acceleration lane used before the merge, median, in free traffic",
        "most merge in its first half: Daamen, Loot, Hoogendoorn 2010 (704 merges)",
    ),
    Range(
        "merge_lane_used_median",
        "merging",
        0.1,
        0.75,
        "the same, 4,500 and 4 x 300 vehicles/h",
        "mainly near its middle: Li, Wang, Chen, Li 2007 (China); later in denser traffic: Daamen et al. 2010",
    ),
    Range(
        "merge_accepted_gap_min_s",
        "merging",
        0.75,
        ANY,
        "smallest gap accepted, of leader and follower, s",
        "0.75 to 1.0: Daamen, Loot, Hoogendoorn 2010",
    ),
    *(
        Range(
            "lane_changes_per_km",
            demand,
            0.2,
            0.6,
            f"lane changes a vehicle and km, {where}",
            "0.5: Knoop, Hoogendoorn, Shiomi, Buisson 2012; 0.23: Lee, Olsen, Wierwille 2004 (8,667 on 38,542 km)",
        )
        for demand, where in MERGING
    ),
    *(
        Range("undone_share", demand, 0.0, 0.02, f"changes undone within 6 s, {where}", GOAL)
        for demand, where in MERGING
    ),
    Range(
        "lateral_acceleration_max",
        "merging",
        0.0,
        2.0,
        "largest lateral acceleration, m/s2",
        "a goal; a lane in 6.3 s with a deviation of 2.0 (Lee, Olsen, Wierwille 2004) is 0.6 to 1.4 as a sine",
    ),
    *(
        Range(
            "idle_s_per_h", demand, 0.0, 0.0, f"standing with 60 m free ahead, s/h, {demand}", GOAL
        )
        for demand in ("paper", "overload")
    ),
    *(
        Range("collisions", demand, 0.0, 0.0, f"collisions, vehicles' ticks, {demand}", GOAL)
        for demand in ("paper", "merging", "overload", "rising")
    ),
    Range(
        "travel_mean_s",
        "paper",
        133.0,
        147.0,
        "4 km at the preset's demand, s",
        "free speed up to 1,300 pc/h/lane: HCM 1997, ch. 3; 133 s at 30 m/s",
    ),
    Range(
        "flow_max",
        "rising",
        1900.0,
        2400.0,
        "highest flow of 5 minutes, vehicles/h/lane",
        "2,400 pc/h/lane at 110 km/h: HCM 1997 and since; bottlenecks some hundreds less: Defining, Measuring, and "
        "Modeling Capacity for the HCM, 2016",
    ),
    Range(
        "density_at_flow_max",
        "rising",
        17.0,
        30.0,
        "density then, vehicles/km/lane",
        "28 (45 pc/mi/lane) at capacity, 22 (35) at 2,115 pc/h/lane: HCM 2000, levels E and D",
    ),
    *(
        Range(
            figure,
            demand,
            1900.0,
            2225.0,
            f"discharge behind the last ramp, vehicles/h/lane, {demand}",
            "2,225 on average: An evaluation of freeway capacity in Texas (TTI); 2,024 (6,071 on three lanes): Hall, "
            "Agyemang-Duah 1991",
        )
        for figure, demand in (("flow_last_mean", "overload"), ("discharge", "rising"))
    ),
    Range(
        "capacity_drop",
        "rising",
        0.05,
        0.15,
        "capacity drop at the bottleneck that breaks down first",
        "10 %: Cassidy, Bertini 1999; 6 %: Hall, Agyemang-Duah 1991; 5 to 30 %: Treiber, Helbing 2002, a review",
    ),
)


def checks(
    figures: dict[str, dict[str, dict[str, Any]]], widths: dict[str, dict[str, dict[str, float]]]
) -> list[dict[str, Any]]:
    """Compares measurements with every range.

    The project's own goals apply only to medjax's default car following.

    Args:
      figures: of `measures.summarise`, by demand, by simulator.
      widths: of `measures.half_widths`, likewise.

    Returns:
      An entry for each range whose demand was measured: the range, and by simulator `value`, `half_width` and `holds`.
    """
    found = []
    for each in RANGES:
        if each.demand not in figures:
            continue
        measured = {}
        for name, values in figures[each.demand].items():
            value, is_ours = values[each.figure], name == "medjax"
            measured[name] = {
                "value": value,
                "half_width": widths[each.demand][name][each.figure],
                "holds": each.holds(value) if is_ours or not each.is_goal else None,
            }
        found.append(dataclasses.asdict(each) | {"measured": measured})
    return found

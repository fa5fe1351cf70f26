"""The ranges to compare with: some come from observations of real roads, others are our goals. Each has its source."""

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


WHERE = {"paper": "at the preset's demand", "merging": "4,500 and 4 x 300 vehicles/h"}
# We read each source's abstract or a table quoted from it. We read nothing of the sources marked "from memory".
GOAL = "a goal of this project"
AASHTO = (
    "a goal; AASHTO's Green Book designs acceleration lanes for merging within 8 km/h of traffic's "
    "speed, some 0.92 (from memory)"
)
FAMBRO = (
    "a goal; 90 % of drivers brake by 3.4 or more for what they did not expect: Fambro et al. 1997"
)
DAAMEN = "most merge in its first half: Daamen, Loot, Hoogendoorn 2010 (704 merges)"
LI = "mainly near its middle: Li, Wang, Chen, Li 2007 (China); later in denser traffic: Daamen et al. 2010"
GAPS = "0.75 to 1.0: Daamen, Loot, Hoogendoorn 2010"
KNOOP = "0.5: Knoop, Hoogendoorn, Shiomi, Buisson 2012; 0.23: Lee, Olsen, Wierwille 2004 (8,667 on 38,542 km)"
LEE = "a goal; a lane in 6.3 s with a deviation of 2.0 (Lee, Olsen, Wierwille 2004) is 0.6 to 1.4 as a sine"
HCM_SPEED = "free speed up to 1,300 pc/h/lane: HCM 1997, ch. 3; 133 s at 30 m/s"
HCM_FLOW = (
    "2,400 pc/h/lane at 110 km/h: HCM 1997 and since; bottlenecks some hundreds less: Defining, Measuring, and "
    "Modeling Capacity for the HCM, 2016"
)
HCM_DENSITY = "28 (45 pc/mi/lane) at capacity, 22 (35) at 2,115 pc/h/lane: HCM 2000, levels E and D"
TEXAS = (
    "2,225 on average: An evaluation of freeway capacity in Texas (TTI); 2,024 (6,071 on three lanes): Hall, "
    "Agyemang-Duah 1991"
)
CASSIDY = "10 %: Cassidy, Bertini 1999; 6 %: Hall, Agyemang-Duah 1991; 5 to 30 %: Treiber, Helbing 2002, a review"
# Each row holds a figure, its demands, the lowest and the highest value, the source, and the text.
ROWS = (
    ("ramp_stop_share", "paper merging", 0.0, 0.005, GOAL,
     "ramp vehicles that stop, {where}"),
    ("merge_relative_speed_median", "paper merging", 0.85, 1.1, AASHTO,
     "merging speed by the right lane's, median, {where}"),
    ("follower_acceleration_p5", "paper merging", -3.0, math.inf, FAMBRO,
     "new follower's strongest braking in 5 s, 5th percentile, m/s2, {where}"),
    ("merge_lane_used_median", "paper", 0.0, 0.5, DAAMEN,
     "acceleration lane used before the merge, median, in free traffic"),
    ("merge_lane_used_median", "merging", 0.1, 0.75, LI,
     "the same, {where}"),
    ("merge_accepted_gap_min_s", "merging", 0.75, math.inf, GAPS,
     "smallest gap accepted, of leader and follower, s"),
    ("lane_changes_per_km", "paper merging", 0.2, 0.6, KNOOP,
     "lane changes a vehicle and km, {where}"),
    ("undone_share", "paper merging", 0.0, 0.02, GOAL,
     "changes undone within 6 s, {where}"),
    ("lateral_acceleration_max", "merging", 0.0, 2.0, LEE,
     "largest lateral acceleration, m/s2"),
    ("idle_s_per_h", "paper overload", 0.0, 0.0, GOAL,
     "standing with 60 m free ahead, s/h, {demand}"),
    ("collisions", "paper merging overload rising", 0.0, 0.0, GOAL,
     "collisions, vehicles' ticks, {demand}"),
    ("travel_mean_s", "paper", 133.0, 147.0, HCM_SPEED,
     "4 km at the preset's demand, s"),
    ("flow_max", "rising", 1900.0, 2400.0, HCM_FLOW,
     "highest flow of 5 minutes, vehicles/h/lane"),
    ("density_at_flow_max", "rising", 17.0, 30.0, HCM_DENSITY,
     "density then, vehicles/km/lane"),
    ("flow_last_mean", "overload", 1900.0, 2225.0, TEXAS,
     "discharge behind the last ramp, vehicles/h/lane, {demand}"),
    ("discharge", "rising", 1900.0, 2225.0, TEXAS,
     "discharge behind the last ramp, vehicles/h/lane, {demand}"),
    ("capacity_drop", "rising", 0.05, 0.15, CASSIDY,
     "capacity drop at the bottleneck that breaks down first"),
)  # fmt: skip
RANGES = tuple(
    Range(figure, name, low, high, text.format(where=WHERE.get(name), demand=name), source)
    for figure, demands, low, high, source, text in ROWS
    for name in demands.split()
)


def checks(
    figures: dict[str, dict[str, dict[str, Any]]], widths: dict[str, dict[str, dict[str, float]]]
) -> list[dict[str, Any]]:
    """Compares measurements with the ranges for their demands. Only medjax's default has to reach the goals.

    By demand and simulator, `figures` come from `measures.summarise` and `widths` from `measures.half_widths`. Each
    entry of the result holds a range, and by simulator `value`, `half_width` and `holds`.
    """

    def measured(each: Range, name: str) -> dict[str, Any]:
        value, width = (of[each.demand][name][each.figure] for of in (figures, widths))
        holds = each.holds(value) if name == "medjax" or not each.is_goal else None
        return {"value": value, "half_width": width, "holds": holds}

    return [
        dataclasses.asdict(each)
        | {"measured": {name: measured(each, name) for name in figures[each.demand]}}
        for each in RANGES
        if each.demand in figures
    ]

"""Highway traffic: IDM and MOBIL on discrete lanes. Independent of charging and learning."""

from medjax.traffic.idm import idm_acceleration
from medjax.traffic.mobil import mobil_incentive
from medjax.traffic.motion import ballistic_step
from medjax.traffic.neighbours import find_neighbours, sort_by_road

__all__ = [
    "ballistic_step",
    "find_neighbours",
    "idm_acceleration",
    "mobil_incentive",
    "sort_by_road",
]

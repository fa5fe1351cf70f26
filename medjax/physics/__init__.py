"""Formulas for the wireless link and the battery, as functions of arrays only.

They cover coils (`mutual_inductance`, tabulated by `tabulate_inductance`), the link between them (`link_efficiency`,
`input_resistance`), driving energy (`tractive_energy`, `battery_energy`, `change_battery`), and elliptic integrals
(`ellipk`, `ellipe`). All units are SI; float64 in gives float64 out.
"""

from medjax.physics.circuit import input_resistance, link_efficiency
from medjax.physics.coil import VACUUM_PERMEABILITY, mutual_inductance
from medjax.physics.coil_table import InductanceTable, interpolate_inductance, tabulate_inductance
from medjax.physics.driving_energy import battery_energy, change_battery, tractive_energy
from medjax.physics.elliptic import ellipe, ellipk

__all__ = [
    "VACUUM_PERMEABILITY",
    "InductanceTable",
    "battery_energy",
    "change_battery",
    "ellipe",
    "ellipk",
    "input_resistance",
    "interpolate_inductance",
    "link_efficiency",
    "mutual_inductance",
    "tabulate_inductance",
    "tractive_energy",
]

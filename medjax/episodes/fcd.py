"""A recording as SUMO's floating-car data: what `sumo --fcd-output` writes, for the tools that read it.

The road is one edge, `highway`, straight along x from 0; SUMO counts its lanes from the right, so `highway_0` is the
acceleration lanes and `highway_1` the rightmost of the others, and measures sideways to the left. Positions are those
of an edge of `num_lanes + 1` lanes that netconvert draws from (0, 0) to (length, 0).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO

import numpy as np

from medjax.episodes.recording import Recording
from medjax.episodes.table import Table, vehicle_table

EDGE = "highway"

HEAD = """<?xml version="1.0" encoding="UTF-8"?>

<fcd-export xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:noNamespaceSchemaLocation="http://sumo.dlr.de/xsd/fcd_file.xsd">
"""


def write_fcd(recording: Recording, file: IO[bytes]) -> int:
    """Writes the recording, a timestep a physics tick; lengths to the millimetre, angles to a thousandth of a degree.

    A vehicle's first acceleration is 0, as SUMO writes it: its tools take the first row for the head of the table. The
    schema has no place for charge and booking: `vehicle_id` of Parquet and CSV is `id` here and joins the two.

    Returns:
      Rows written.
    """
    table = vehicle_table(recording)
    vehicles = list(_vehicles(table, recording))
    ends = np.searchsorted(table["time_s"].data, recording.time_s, side="right")
    file.write(HEAD.encode())
    first = 0
    for time, end in zip(recording.time_s, ends, strict=True):
        block = "".join(vehicles[first:end])
        file.write(f'    <timestep time="{time:.3f}">\n{block}    </timestep>\n'.encode())
        first = end
    file.write(b"</fcd-export>\n")
    return len(vehicles)


def _vehicles(table: Table, recording: Recording) -> Iterator[str]:
    """The element of each row of the table."""
    lane_width = float(recording.params.road.lane_width_m)
    speed, sideways = table["speed_m_per_s"].data, table["lateral_speed_m_per_s"].data
    columns = (
        table["vehicle_id"],
        table["x_m"],
        -(table["lateral_m"] + 0.5 * lane_width),
        90.0 + np.degrees(np.arctan2(sideways, speed)),
        table["kind"],
        speed,
        recording.config.num_lanes - table["lane"],
        table["acceleration_m_per_s2"].filled(0.0),
        -table["lane_offset_m"],
        -sideways,
    )
    for number, x, y, angle, kind, v, lane, acceleration, offset, v_left in zip(
        *(column.tolist() for column in columns), strict=True
    ):
        yield (
            f'        <vehicle id="{number}" x="{x:.3f}" y="{y:.3f}" angle="{angle:.3f}" type="{kind}"'
            f' speed="{v:.3f}" pos="{x:.3f}" lane="{EDGE}_{lane}" slope="0.000"'
            f' acceleration="{acceleration:.3f}" posLat="{offset:.3f}" speedLat="{v_left:.3f}"/>\n'
        )

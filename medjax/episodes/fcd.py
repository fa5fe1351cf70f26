"""Exports a recording as SUMO's floating-car data, the format of `sumo --fcd-output`.

The road is one edge, `highway`, straight along x from 0. SUMO counts lanes from the right: `highway_0` is the
acceleration lanes, and `highway_1` is the rightmost main lane. Lateral positions grow to the left. A vehicle's lane is
the one beneath its centre, because SUMO switches lanes halfway through a change. medjax itself reports the target lane
at once. Positions match an edge of `num_lanes + 1` lanes that netconvert draws from (0, 0) to (length, 0).
"""

from collections.abc import Iterable, Iterator
from typing import IO

import numpy as np

from medjax.episodes.recording import Recording
from medjax.episodes.table import vehicle_table

HEAD = """<?xml version="1.0" encoding="UTF-8"?>

<fcd-export xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:noNamespaceSchemaLocation="http://sumo.dlr.de/xsd/fcd_file.xsd">
"""
ROW = (
    '        <vehicle id="{}" x="{:.3f}" y="{:.3f}" angle="{:.3f}" type="{}" speed="{:.3f}" pos="{:.3f}"'
    ' lane="highway_{}" slope="{:.3f}" acceleration="{:.3f}" posLat="{:.3f}" speedLat="{:.3f}"/>\n'
)


def write_fcd(pieces: Iterable[Recording], file: IO[bytes]) -> Iterator[int]:
    """Writes one timestep per physics tick, to the mm and the thousandth of a degree. Yields each piece's row count.

    A vehicle's first acceleration is 0, as in SUMO. It must not be missing, because SUMO's tools take column names from
    the first row. The schema has no fields for charge and booking. Join them from Parquet or CSV, where `vehicle_id` is
    the `id` of this format.
    """
    file.write(HEAD.encode())
    for piece in pieces:
        vehicles, starts, times = _rows(piece)
        for time, start, end in zip(times, starts, [*starts[1:], None], strict=True):
            block = "".join(vehicles[start:end])
            file.write(f'    <timestep time="{time:.3f}">\n{block}    </timestep>\n'.encode())
        yield len(vehicles)
    file.write(b"</fcd-export>\n")


def _rows(recording: Recording) -> tuple[list[str], np.ndarray, np.ndarray]:
    """XML lines of vehicles in order of time, the index of each frame's first line, and the frames' times."""
    table = vehicle_table(recording)
    lane_width = float(recording.params.road.lane_width_m)
    x, speed = table["x_m"], table["speed_m_per_s"].data
    sideways = table["lateral_speed_m_per_s"].data
    lateral = table["lateral_m"].data
    lane = np.clip(np.rint(lateral / lane_width), 0, recording.config.num_lanes).astype(int)
    columns = (
        table["vehicle_id"],
        x,
        -(lateral + 0.5 * lane_width),
        90.0 + np.degrees(np.arctan2(sideways, speed)),
        table["kind"],
        speed,
        x,
        recording.config.num_lanes - lane,
        np.full(len(lane), np.degrees(float(recording.params.road.slope))),
        table["acceleration_m_per_s2"].filled(0.0),
        lane * lane_width - lateral,
        -sideways,
    )
    vehicles = list(map(ROW.format, *(column.tolist() for column in columns)))
    times = recording.time_s[recording.first_frame > 0 :]
    return vehicles, np.searchsorted(table["time_s"].data, times), times

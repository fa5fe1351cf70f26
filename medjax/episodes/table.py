"""A recording as one table: a row for each vehicle on the road at each physics tick."""

from __future__ import annotations

import numpy as np

from medjax.episodes.recording import Recording
from medjax.traffic.road import lateral_position
from medjax.world.kinds import KINDS
from medjax.world.params import PANELS

Table = dict[str, np.ma.MaskedArray]


def vehicle_table(recording: Recording) -> Table:
    """Columns of the table; rows by time, then by slot.

    Returns:
      By name, each `(rows,)`, masked where there is no such thing:
        time_s: float64, since the reset.
        vehicle_id: int64, one number a vehicle (`Recording.vehicle_ids`).
        kind: "med", "human_ev", "autonomous_ev" or "gas".
        x_m: float32, front bumper, from the left end of the road.
        lane: int32, 0 leftmost; num_lanes is an acceleration lane.
        lateral_m: float32, right of the leftmost lane's centre.
        lane_offset_m: float32, right of its own lane's centre.
        speed_m_per_s, lateral_speed_m_per_s: float32; lateral is positive to the right.
        acceleration_m_per_s2: float32, mean over the tick that led here; masked in a vehicle's first row.
        soc: float32, state of charge, 0 to 1; masked for gas vehicles.
        booked_med_id: int64, vehicle_id of the MED that an EV is booked on.
        panel: of that MED, "left", "right", "rear" or "front".
        is_charging: bool.
    """
    frames, ids = recording.frames, recording.vehicle_ids()
    time, slot = rows = np.nonzero(ids >= 0)
    lane_width = float(recording.params.road.lane_width_m)
    soc, med, panel, charging = _of_evs_and_meds(recording)
    booked = med[rows] >= 0
    acceleration, known = _acceleration(recording, ids)
    lane, offset = frames.lane[rows], frames.lateral_offset[rows]
    return {
        "time_s": _all(recording.time_s[time]),
        "vehicle_id": _all(ids[rows]),
        "kind": _all(np.asarray([kind.column for kind in KINDS])[frames.kind[rows]]),
        "x_m": _all(frames.x[rows]),
        "lane": _all(lane),
        "lateral_m": _all(np.asarray(lateral_position(lane, offset, lane_width), np.float32)),
        "lane_offset_m": _all(offset),
        "speed_m_per_s": _all(frames.speed[rows]),
        "lateral_speed_m_per_s": _all(frames.lateral_speed[rows]),
        "acceleration_m_per_s2": _where(known[rows], acceleration[rows]),
        "soc": _where(slot < recording.config.ev_slots.stop, soc[rows]),
        "booked_med_id": _where(booked, ids[time, np.maximum(med[rows], 0)]),
        "panel": _where(booked, np.asarray(PANELS)[np.maximum(panel[rows], 0)]),
        "is_charging": _all(charging[rows]),
    }


def _of_evs_and_meds(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """State of charge, booked MED, its panel (-1 for none) and whether it charges, each (F, V)."""
    config, frames = recording.config, recording.frames
    soc = np.zeros(frames.x.shape, np.float32)
    soc[:, config.med_slots], soc[:, config.ev_slots] = frames.med_soc, frames.ev_soc
    med, panel = np.full((2, *frames.x.shape), -1)
    med[:, config.ev_slots], panel[:, config.ev_slots] = frames.ev_med, frames.ev_panel
    charging = np.zeros(frames.x.shape, bool)
    charging[:, config.ev_slots] = frames.ev_is_charging
    return soc, med, panel, charging


def _acceleration(recording: Recording, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """m/s^2 over the last tick, (F, V), and where the vehicle was there before it."""
    speed = recording.frames.speed
    acceleration, known = np.zeros_like(speed), np.zeros(speed.shape, bool)
    acceleration[1:] = (speed[1:] - speed[:-1]) / np.float32(recording.config.tick_s)
    known[1:] = ids[1:] == ids[:-1]
    return acceleration, known


def _all(values: np.ndarray) -> np.ma.MaskedArray:
    """A column that every row has."""
    return np.ma.masked_array(values)


def _where(has: np.ndarray, values: np.ndarray) -> np.ma.MaskedArray:
    """A column that some rows have."""
    return np.ma.masked_array(values, mask=~has)

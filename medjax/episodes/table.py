"""Makes a table of a recording, with one row for each vehicle on the road at each physics tick."""

import numpy as np

from medjax.episodes.recording import Recording
from medjax.traffic.road import lateral_position
from medjax.world.kinds import KINDS
from medjax.world.params import CHARGING_SLOTS
from medjax.world.state import IN_SERVICE

Table = dict[str, np.ma.MaskedArray]


def vehicle_table(recording: Recording) -> Table:
    """Columns of the table; rows by time, then by slot. A later piece omits its first frame: the piece before has it.

    Returns:
      By name, each `(rows,)`, masked where a value does not apply:
        time_s: float64, since the reset.
        vehicle_id: int64, unique per vehicle (`Recording.vehicle_ids`).
        kind: "med", "human_ev", "autonomous_ev", "gas" or "lorry".
        x_m: float32, front bumper, from the left end of the road.
        lane: int32, 0 leftmost; num_lanes is an acceleration lane.
        lateral_m: float32, right of the leftmost lane's centre.
        lane_offset_m: float32, right of its own lane's centre.
        speed_m_per_s, lateral_speed_m_per_s: float32; lateral is positive to the right.
        acceleration_m_per_s2: float32, mean over the preceding tick; masked in a vehicle's first row.
        soc: float32, state of charge, 0 to 1; masked for gas vehicles.
        booked_med_id: int64, vehicle_id of the MED that an EV is booked on.
        panel: charging slot of that MED, "left", "right", "rear" or "front".
        is_charging: bool.
        told_speed_m_per_s, told_lane: float32 and int32, ordered speed and lane of a MED in service.
        accepts: bool, whether a MED in service accepts new bookings.
    """
    config, frames, ids = recording.config, recording.frames, recording.vehicle_ids()
    present = ids >= 0
    present[: recording.first_frame > 0] = False
    time, slot = rows = np.nonzero(present)
    soc, booked, charging_slot, charging = (each[rows] for each in _of_evs_and_meds(recording))
    change = np.diff(frames.speed, axis=0, prepend=frames.speed[:1]) / np.float32(config.tick_s)
    is_new = np.diff(ids, axis=0, prepend=-2) != 0  # every vehicle is new in the first frame
    lane, offset = frames.lane[rows], frames.lateral_offset[rows]
    lateral = lateral_position(lane, offset, float(recording.params.road.lane_width_m))
    columns = {
        "time_s": recording.time_s[time],
        "vehicle_id": ids[rows],
        "kind": np.asarray([kind.column for kind in KINDS])[frames.kind[rows]],
        "x_m": frames.x[rows],
        "lane": lane,
        "lateral_m": np.asarray(lateral, np.float32),
        "lane_offset_m": offset,
        "speed_m_per_s": frames.speed[rows],
        "lateral_speed_m_per_s": frames.lateral_speed[rows],
        "acceleration_m_per_s2": change[rows],
        "soc": soc,
        "booked_med_id": ids[time, np.maximum(booked, 0)],
        "panel": np.asarray(CHARGING_SLOTS)[np.maximum(charging_slot, 0)],
        "is_charging": charging,
    }
    med = np.where(slot < config.num_meds, slot, 0)
    told = {
        "told_speed_m_per_s": frames.med_service_speed[time, med],
        "told_lane": frames.med_service_lane[time, med],
        "accepts": frames.med_accepts[time, med],
    }
    missing = {"acceleration_m_per_s2": is_new[rows], "soc": slot >= config.ev_slots.stop}
    missing |= dict.fromkeys(("booked_med_id", "panel"), booked < 0)
    serves = (slot < config.num_meds) & (frames.med_status[time, med] == IN_SERVICE)
    missing |= dict.fromkeys(told, ~serves)
    return {
        name: np.ma.masked_array(values, missing.get(name, np.ma.nomask))
        for name, values in (columns | told).items()
    }


def _of_evs_and_meds(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """State of charge, booked MED and its charging slot (-1 for none), and whether it is charging, each (F, V)."""
    config, frames = recording.config, recording.frames
    soc = np.zeros(frames.x.shape, np.float32)
    soc[:, config.med_slots], soc[:, config.ev_slots] = frames.med_soc, frames.ev_soc
    med, charging_slot = np.full((2, *frames.x.shape), -1)
    med[:, config.ev_slots], charging_slot[:, config.ev_slots] = (
        frames.ev_med,
        frames.ev_charging_slot,
    )
    charging = np.zeros(frames.x.shape, bool)
    charging[:, config.ev_slots] = frames.ev_is_charging
    return soc, med, charging_slot, charging

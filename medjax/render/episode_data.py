"""Packs a recording for the player's page, where `web/episode.js` reads it."""

import warnings
from typing import Any, NamedTuple

import numpy as np

from medjax.env.dispatch import action_names
from medjax.env.metrics import JOULES_PER_KWH
from medjax.episodes.recording import Recording
from medjax.render.layout import EXAGGERATION
from medjax.render.packing import Packer
from medjax.render.roadway import Roadway
from medjax.render.scene import Timeline
from medjax.render.tracks import broken_down
from medjax.traffic.road import lateral_position
from medjax.world.kinds import HUMAN_EV, KINDS
from medjax.world.params import CHARGING_SLOTS, EnvParams
from medjax.world.state import IN_SERVICE, LEAVING, STATUS_NAMES


def pack_episode(timeline: Timeline, camera: np.ndarray) -> tuple[dict[str, Any], str]:
    """The episode's facts for JSON, and its arrays as text (`Packer`); `camera` is the page's `auto_path`, `(F,)` m."""
    recording, road = timeline.recording, timeline.roadway
    config, params, decisions = recording.config, recording.params, recording.decisions
    charts, fleet = charts_of(recording), params.fleet
    packer = Packer()
    _add_frames(packer, timeline)
    packer.add("camera", camera[None], 0.01, 2)
    _add_decisions(packer, recording)
    for number, chart in enumerate(charts):
        packer.add(f"chart{number}", chart.values, _fine(chart.values))
    kinds = np.asarray(recording.frames.kind)
    bodies = [
        {"name": kind.name, "length": length, "width": width}
        for kind, length, width in zip(
            KINDS, road.vehicle_length_m, road.vehicle_width_m, strict=True
        )
    ]
    meta = {
        "scenario": recording.scenario,
        "policy": recording.policy,
        "seed": recording.seed,
        "episode": recording.episode,
        "tickSeconds": config.tick_s,
        "ticksPerDecision": recording.ticks_per_decision,
        "numMeds": config.num_meds,
        "numDepots": config.num_depots,
        "numEvs": config.num_evs,
        "numVehicles": config.num_vehicles,
        "fleet": int(fleet.size),
        "evKwh": float(params.ev_capacity_j) / JOULES_PER_KWH,
        "medKwh": float(params.med_capacity_j) / JOULES_PER_KWH,
        "road": _road(road, params),
        "kinds": bodies,
        "slotBody": bodies[HUMAN_EV],
        "statuses": STATUS_NAMES,
        "inService": IN_SERVICE,
        "leaving": LEAVING,
        "fleetOrder": {"speed": float(fleet.service_speed), "lane": int(fleet.service_lane)},
        "actions": action_names(config, params),
        "panels": CHARGING_SLOTS,
        "slots": road.slots_m,
        "rewardTerms": list(decisions.reward_terms),
        "tracks": [
            [t.slot, t.first, t.last, t.number, int(kinds[t.first, t.slot])]
            for t in timeline.tracks
        ],
        "ranOut": [
            [stop.slot, stop.frame, stop.gone, round(stop.x_m, 2)] for stop in timeline.ran_out
        ],
        "brokenDown": broken_down(recording),
        "charts": [
            {name: value for name, value in chart._asdict().items() if name != "values"}
            for chart in charts
        ],
        "arrays": packer.index,
    }
    return meta, packer.text()


def _road(road: Roadway, params: EnvParams) -> dict[str, Any]:
    """Geometry of the road, m."""
    return {
        "length": road.length_m,
        "lanes": road.num_lanes,
        "laneWidth": road.lane_width_m,
        "ramps": road.ramp_x_m,
        "exits": np.asarray(params.road.exit_x_m, float).tolist(),
        "exitLane": float(params.road.exit_lane_m),
        "mergeLength": road.acceleration_lane_m,
        "shoulder": road.shoulder_m,
        "exaggeration": EXAGGERATION,
    }


def _add_frames(packer: Packer, timeline: Timeline) -> None:
    """Adds values per frame, `(slots, F)` each; empty slots are 0."""
    frames, road = timeline.recording.frames, timeline.roadway
    active = np.asarray(frames.active)
    y = lateral_position(frames.lane, frames.lateral_offset, road.lane_width_m)
    packer.add("x", np.where(active, frames.x, 0).T, 0.01, 2)
    packer.add("y", np.where(active, y, 0).T, 0.01)
    packer.add("speed", np.where(active, frames.speed, 0).T, 0.01)
    packer.add("lane", np.where(active, frames.lane, 0).T)
    packer.add("evSoc", frames.ev_soc.T, 1e-4)
    packer.add("evMed", frames.ev_med.T)
    packer.add("evPanel", frames.ev_charging_slot.T)
    packer.add("evCharging", frames.ev_is_charging.T)
    packer.add("medSoc", frames.med_soc.T, 1e-4)
    packer.add("medStatus", frames.med_status.T)
    packer.add("medDepot", frames.med_depot.T)
    packer.add("medSpeedTold", frames.med_service_speed.T, 0.1)
    packer.add("medLaneTold", frames.med_service_lane.T)
    packer.add("medAccepts", frames.med_accepts.T)


def _add_decisions(packer: Packer, recording: Recording) -> None:
    """Adds values per decision, `(rows, T)` each."""
    decisions = recording.decisions
    packer.add("action", decisions.action[None])
    packer.add("sent", decisions.sent[None])
    packer.add("mask", decisions.mask.T)
    packer.add("probability", decisions.probabilities.T, 1e-4)
    packer.add("reward", decisions.reward[None], _fine(decisions.reward), 0)
    terms = np.array([*decisions.reward_terms.values()])
    terms = terms.reshape(len(terms), len(decisions.action))
    packer.add("terms", terms, _fine(terms), 0)
    packer.add("queue", decisions.queue.T)
    packer.add("cooldown", decisions.cooldown_s[None], 0.01)


def _fine(values: np.ndarray) -> float:
    """A step of 1e-4, or a coarser one with which a packer holds the largest of the values, NaN left out."""
    return max(1e-4, float(np.nanmax(np.abs(values), initial=0.0)) / 2**30)


class Chart(NamedTuple):
    """A chart of one or two lines over T decisions."""

    title: str
    unit: str
    digits: int  # after the point
    labels: tuple[str, ...]
    values: np.ndarray  # (lines, T + 1), NaN where there is nothing to average
    least: float  # least range of the axis, so that small changes look small


def charts_of(recording: Recording) -> list[Chart]:
    """Charts of an episode. The first point is the reset, the second follows the first decision."""
    config, frames, decisions = recording.config, recording.frames, recording.decisions
    now = recording.decision_frames
    active, speed = np.asarray(frames.active)[now], np.asarray(frames.speed)[now]
    evs, gas = config.ev_slots, config.gas_slots
    stats = decisions.stats
    received = np.asarray(stats.energy_received_j) / JOULES_PER_KWH
    lost = np.asarray(stats.energy_sent_j) / JOULES_PER_KWH - received
    energy = np.stack([_so_far(received), _so_far(lost)])
    queue = np.concatenate([[0.0], np.asarray(decisions.queue).sum(axis=1)])
    charge = 100.0 * _mean(np.asarray(frames.ev_soc)[now], active[:, evs])
    speeds = [_mean(speed[:, slots], active[:, slots]) for slots in (evs, gas)]
    return [
        Chart("Mean charge of EVs", "%", 1, ("",), charge[None], 20.0),
        Chart("EVs that ran out", "", 0, ("",), _so_far(stats.depleted)[None], 5.0),
        Chart("Mean speed", "m/s", 1, ("EVs", "gas"), np.stack(speeds), 5.0),
        Chart("Energy through the coils", "kWh", 2, ("delivered", "lost"), energy, 1.0),
        Chart("Vehicles waiting to enter", "", 0, ("",), queue[None], 5.0),
        Chart("Return so far", "", 1, ("",), _so_far(decisions.reward)[None], 10.0),
    ]


def _so_far(values: Any) -> np.ndarray:
    """Cumulative sums `(T + 1,)`, from 0, of values per decision `(T,)`."""
    return np.concatenate([[0.0], np.cumsum(np.asarray(values, np.float64))])


def _mean(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Means over the second axis where `there` is true; NaN if it is nowhere."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmean(np.where(there, np.asarray(values, np.float64), np.nan), axis=1)

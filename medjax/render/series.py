"""What the player's charts show, at every decision."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np

from medjax.env.metrics import JOULES_PER_KWH
from medjax.episodes.recording import Recording


@dataclasses.dataclass(frozen=True)
class Chart:
    """A chart of one or two lines; T decisions."""

    title: str
    unit: str
    digits: int  # after the point
    labels: tuple[str, ...]
    values: np.ndarray  # (lines, T + 1), NaN where there is nothing to average


def charts_of(recording: Recording) -> list[Chart]:
    """Charts of an episode; their first point is the reset, the next one follows the first decision."""
    config, frames, decisions = recording.config, recording.frames, recording.decisions
    now = recording.decision_frames
    active, speed = np.asarray(frames.active)[now], np.asarray(frames.speed)[now]
    evs, gas = config.ev_slots, config.gas_slots
    tally = decisions.tally
    received = np.asarray(tally.energy_received_j) / JOULES_PER_KWH
    lost = np.asarray(tally.energy_sent_j) / JOULES_PER_KWH - received
    energy = np.stack([_so_far(received), _so_far(lost)])
    queue = np.concatenate([[0.0], np.asarray(decisions.queue).sum(axis=1)])
    charge = 100.0 * _mean(np.asarray(frames.ev_soc)[now], active[:, evs])
    speeds = [_mean(speed[:, slots], active[:, slots]) for slots in (evs, gas)]
    return [
        Chart("Mean charge of EVs", "%", 1, ("",), charge[None]),
        Chart("EVs that ran out", "", 0, ("",), _so_far(tally.depleted)[None]),
        Chart("Mean speed", "m/s", 1, ("EVs", "gas"), np.stack(speeds)),
        Chart("Energy through the coils", "kWh", 2, ("delivered", "lost"), energy),
        Chart("Vehicles waiting to enter", "", 0, ("",), queue[None]),
        Chart("Return so far", "", 1, ("",), _so_far(decisions.reward)[None]),
    ]


def _so_far(values: np.ndarray) -> np.ndarray:
    """Sums `(T + 1,)` of what happened in each decision, `(T,)`."""
    return np.concatenate([[0.0], np.cumsum(np.asarray(values, np.float64))])


def _mean(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Means over the second axis of those that are there; NaN of none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmean(np.where(there, np.asarray(values, np.float64), np.nan), axis=1)

"""Vehicles through time: who was in which slot for how long, and where EVs ran out."""

import dataclasses
from collections import Counter

import numpy as np

from medjax.episodes.recording import Recording
from medjax.world.params import EnvConfig


@dataclasses.dataclass(frozen=True)
class Track:
    """One vehicle's stay on the road."""

    slot: int
    first: int  # frame that it is first seen in
    last: int  # and last seen in
    kind: str  # of `medjax.world.kinds.CLASSES`
    number: int  # of its class, from 1, in the order of entry

    @property
    def name(self) -> str:
        """`MED 3`, `EV 27`."""
        return f"{self.kind} {self.number}"


@dataclasses.dataclass(frozen=True)
class RanOut:
    """An EV that came to a stop without energy."""

    slot: int
    frame: int  # the first without it
    x_m: float


def class_of(slot: int, config: EnvConfig) -> str:
    """Class of a slot, of `medjax.world.kinds.CLASSES`."""
    slots = config.class_slots.items()
    return next(name for name, where in slots if where.start <= slot < where.stop)


def tracks_of(recording: Recording) -> list[Track]:
    """All vehicles in the order of entry, by slot among those that enter at once."""
    ids = recording.vehicle_ids()
    frames, slots = np.nonzero(ids >= 0)
    # Rows are in the order of time, and a vehicle keeps its slot and leaves no gap.
    _, entry, stay = np.unique(ids[frames, slots], return_index=True, return_counts=True)
    seen: Counter[str] = Counter()
    tracks = []
    for slot, first, count in np.stack([slots[entry], frames[entry], stay], axis=1).tolist():
        kind = class_of(slot, recording.config)
        seen[kind] += 1
        tracks.append(Track(slot, first, first + count - 1, kind, seen[kind]))
    return tracks


def ran_out(recording: Recording) -> list[RanOut]:
    """EVs that ran out, in the order of time."""
    frames, slots = recording.frames, recording.config.ev_slots
    on_road, x = np.asarray(frames.active)[:, slots], np.asarray(frames.x)[:, slots]
    gone = on_road[:-1] & ~on_road[1:] & (np.asarray(frames.ev_soc)[1:] <= 0.0)
    before, ev = np.nonzero(gone & (x[1:] <= float(recording.params.road.length_m)))
    return [
        RanOut(slots.start + int(e), int(f) + 1, float(x[f + 1, e]))
        for f, e in zip(before, ev, strict=True)
    ]

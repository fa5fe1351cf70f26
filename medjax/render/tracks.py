"""Vehicles over time: which one held which slot and when, where EVs ran out, and who broke down."""

import dataclasses
from collections import Counter

import numpy as np

from medjax.episodes.recording import Recording
from medjax.world.params import EnvConfig


@dataclasses.dataclass(frozen=True)
class Track:
    """One vehicle's stay on the road."""

    slot: int
    first: int  # first frame with it
    last: int  # last frame with it
    kind: str  # of `medjax.world.kinds.CLASSES`
    number: int  # within its class, from 1, in the order of entry

    @property
    def name(self) -> str:
        """A name such as `MED 3` or `EV 27`."""
        return f"{self.kind} {self.number}"


@dataclasses.dataclass(frozen=True)
class RanOut:
    """An EV that ran out of energy."""

    slot: int
    frame: int  # the first without energy
    gone: int  # the first after it left the road; the number of frames if it never does
    x_m: float  # its last position


def class_of(slot: int, config: EnvConfig) -> str:
    """Class of a slot, of `medjax.world.kinds.CLASSES`."""
    slots = config.class_slots.items()
    return next(name for name, where in slots if where.start <= slot < where.stop)


def tracks_of(recording: Recording) -> list[Track]:
    """All vehicles in the order of entry, and by slot among those that enter together."""
    ids = recording.vehicle_ids()
    frames, slots = np.nonzero(ids >= 0)
    # Frames ascend, and a vehicle keeps its slot without gaps, so the count is its stay.
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
    empty = np.asarray(frames.active)[:, slots] & (np.asarray(frames.ev_soc) <= 0.0)
    found = [  # an empty EV stays empty until it is gone
        RanOut(slots.start + e, first, gone, float(frames.x[gone - 1, slots.start + e]))
        for e, first, gone in _spells(empty)
    ]
    return sorted(found, key=lambda stop: stop.frame)


def broken_down(recording: Recording) -> list[tuple[int, int, int]]:
    """Slot, first frame and first frame after it of each time that a gas vehicle is broken down."""
    start = recording.config.gas_slots.start
    told = np.asarray(recording.frames.gas_is_broken_down)
    return [(start + gas, first, after) for gas, first, after in _spells(told)]


def _spells(holds: np.ndarray) -> list[tuple[int, int, int]]:
    """Column, first row and first row after it of each unbroken run of true values in a column."""
    change = np.diff(holds, axis=0, prepend=False, append=False)
    # Changes in a column alternate between the begin and the end of a run.
    column, row = np.nonzero(change.T)
    return list(zip(column[::2].tolist(), row[::2].tolist(), row[1::2].tolist(), strict=True))

"""Sums over recorded episodes: charge of EVs, dispatches and need."""

import math
from collections.abc import Sequence

import jax
import numpy as np
from flax import struct

from train.evaluation.tables import Table, short
from train.reporting.traces import Trace

SOC_BINS = 100  # of equal width, from 0 to 1


class Survey(struct.PyTreeNode):
    """Sums over episodes as NumPy arrays, so that surveys can be added.

    P policies, D decisions of the highway, T decisions of the policy, R ramps, B = SOC_BINS.
    """

    episodes: np.ndarray  # ()
    soc: np.ndarray  # (P, D + 1, B) EVs on the road, by state of charge
    # Left the road with some charge, at their exit or to charge.
    exit_soc: np.ndarray  # (P, B) EVs
    depleted: np.ndarray  # (P,) EVs that ran out
    stops: np.ndarray  # (P,) EVs that broke off their trip to charge
    sent: np.ndarray  # (P, T, R) MEDs
    need: np.ndarray  # (P, T, R) need of each ramp
    need_there: np.ndarray  # (P,) need of the ramps that MEDs were sent from, summed over MEDs
    to_greatest: np.ndarray  # (P,) MEDs sent from the ramp with the greatest need


def survey(trace: Trace, rounds: int = 1) -> Survey:
    """Sums of traces `(episodes, policies, ...)`; `rounds` is the number per decision of the highway."""
    frames, need = trace.frames, np.asarray(trace.need, np.float64)
    on_road, soc = np.asarray(frames.ev_on_road), np.asarray(frames.ev_soc)
    ended = on_road[:, :, :-1] & ~on_road[:, :, 1:]
    ran_out = ended & (soc[:, :, 1:] <= 0.0)
    sent = np.asarray(trace.sent)[..., None] == 1 + np.arange(need.shape[-1])
    greatest = need == need.max(axis=-1, keepdims=True, initial=-np.inf)
    return Survey(
        episodes=np.asarray(len(need)),
        soc=_histogram(soc[:, :, ::rounds], on_road[:, :, ::rounds], 2),
        exit_soc=_histogram(soc[:, :, 1:], ended & ~ran_out, 1),
        depleted=np.sum(trace.depleted, axis=(0, 2)),
        stops=np.sum(trace.charging_stops, axis=(0, 2)),
        sent=sent.sum(axis=0),
        need=need.sum(axis=0),
        need_there=np.sum(need, axis=(0, 2, 3), where=sent),
        to_greatest=np.sum(sent & greatest, axis=(0, 2, 3)),
    )


def total(surveys: Sequence[Survey]) -> Survey:
    """The sum of surveys."""
    return jax.tree.map(lambda *parts: np.sum(np.stack(parts), axis=0), *surveys)


def dispatch_rows(names: Sequence[str], seen: Survey) -> Table:
    """The ramps that every policy sends MEDs from, and the need there; `names` are in the order of `seen`."""
    ramps = [f"ramp {number}" for number in range(1, 1 + seen.sent.shape[-1])]
    rows = [["policy", "MEDs sent", *ramps, "from the neediest ramp", "need there", "mean need"]]
    for index, name in enumerate(names):
        per_ramp = seen.sent[index].sum(axis=0) / seen.episodes
        count = seen.sent[index].sum()
        cells = [name, *(format(value, ".2f") for value in (per_ramp.sum(), *per_ramp))]
        there = (seen.to_greatest[index], seen.need_there[index]) / np.maximum(count, 1)
        cells += [f"{there[0]:.0%}", short(there[1])] if count else ["-", "-"]
        rows.append([*cells, short(seen.need[index].mean() / seen.episodes) if ramps else "-"])
    return rows


def _histogram(soc: np.ndarray, counted: np.ndarray, kept: int) -> np.ndarray:
    """Counts of charges `(episodes, P, T, E)`: `(P, SOC_BINS)` for `kept` = 1, `(P, T, SOC_BINS)` for 2."""
    shape = soc.shape[1 : 1 + kept]
    bins = np.clip((soc[counted] * SOC_BINS).astype(np.int64), 0, SOC_BINS - 1)
    cell = np.ravel_multi_index(np.nonzero(counted)[1 : 1 + kept], shape)
    counts = np.bincount(cell * SOC_BINS + bins, minlength=math.prod(shape) * SOC_BINS)
    return counts.reshape(*shape, SOC_BINS)


def quantile(counts: np.ndarray, share: float) -> np.ndarray:
    """Quantile of the state of charge of the counted EVs; NaN if none was counted.

    Args:
        counts: (..., SOC_BINS).
        share: in (0, 1).

    Returns:
        `(...)`, interpolated within a bin.
    """
    below = np.cumsum(counts, axis=-1)
    wanted = share * below[..., -1:]
    index = np.argmax(below >= wanted, axis=-1)[..., None]
    here = np.take_along_axis(counts, index, axis=-1)
    into = (wanted - np.take_along_axis(below, index, axis=-1) + here) / np.maximum(here, 1)
    value = ((index + into) / SOC_BINS)[..., 0]
    return np.where(below[..., -1] > 0, value, np.nan)

"""What the player says in words: who the policies are, where it opens, and how the episode ends."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from medjax.env.metrics import JOULES_PER_KWH
from medjax.episodes.recording import Recording
from medjax.policies.rules import BASELINES

LEARNED = {"ppo": "Learned by trial and error in simulation (PPO)."}
BEFORE_S = 3.0  # the first charge


def words_for(policy: str) -> str:
    """A sentence on a policy, "" of one that is not known: of a rule the first of its documentation."""
    rule = BASELINES.get(policy)
    if rule is None:
        return LEARNED.get(policy.split("_")[0], "")
    return (rule.__doc__ or "").split("\n")[0].replace("`", "")


def first_charge_s(recordings: Sequence[Recording]) -> float:
    """Just before an EV is first charged in one of them, s; 0 where none is."""
    found = [
        np.flatnonzero(np.asarray(each.frames.ev_is_charging).any(axis=1)) for each in recordings
    ]
    first = min((int(frames[0]) for frames in found if len(frames)), default=0)
    return max(0.0, first * recordings[0].config.tick_s - BEFORE_S)


def verdict(recordings: Sequence[Recording]) -> list[dict[str, Any]]:
    """Rows on whole episodes: what, digits after the point, which way is better (-1, 1; 0: neither), and values."""

    def row(title: str, digits: int, better: int, *values: float) -> dict[str, Any]:
        return {"title": title, "digits": digits, "better": better, "values": list(values)}

    tallies = [each.decisions.tally for each in recordings]

    def totals(name: str) -> list[float]:
        return [float(np.sum(getattr(tally, name), dtype=np.float64)) for tally in tallies]

    received = [joules / JOULES_PER_KWH for joules in totals("energy_received_j")]
    delays = zip(totals("ev_delay_s"), totals("gas_delay_s"), strict=True)
    returns = [float(np.sum(each.decisions.reward, dtype=np.float64)) for each in recordings]
    return [
        row("ran out", 0, -1, *totals("depleted")),
        row("kWh received", 1, 1, *received),
        row("hours of delay", 2, -1, *(sum(each) / 3600.0 for each in delays)),
        row("MEDs sent", 0, 0, *totals("meds_dispatched")),
        row("return", 1, 1, *returns),
    ]

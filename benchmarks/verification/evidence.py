"""Explains a violation tick by tick: which check failed, and the numbers of the vehicles concerned."""

import operator
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from benchmarks.verification.books import Books
from benchmarks.verification.decisions import Decision, check_closing
from benchmarks.verification.invariants import (
    Flags,
    check_entry,
    check_lanes,
    check_state,
    check_tick,
    lengths_of,
)
from medjax.env.charging_env import ChargingEnv
from medjax.world.kinds import KINDS
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState

MOST_SHOWN = 4  # of each check


def explain(
    env: ChargingEnv, params: EnvParams, key: jax.Array, before: EnvState, action: Any
) -> Iterator[str]:
    """Lines on what goes wrong in a decision of one environment, whose probe must report the whole state."""
    config = env.config
    obs, after, reward, _, _, info = jax.jit(env.step_env)(key, before, action, params)
    last, books = before, []
    for tick in range(config.ticks_per_decision):
        if tick % config.ticks_per_round == 0:
            begun = jax.tree.map(operator.itemgetter(tick // config.ticks_per_round), info["begun"])
            flags, more = check_entry(last, begun, config, params)
            books.append(more)
            standing = check_lanes(begun.vehicles, begun.vehicles, lengths_of(begun, params))
            begins = flags, standing, check_state(begun, config, params)
            yield from _lines(f"before tick {tick}", last, begun, config, params, *begins)
            last = begun
        state = jax.tree.map(operator.itemgetter(tick), info["ticks"])
        flags, more = check_tick(last, state, config, params)
        books.append(more)
        checks = flags, check_state(state, config, params)
        yield from _lines(f"tick {tick}", last, state, config, params, *checks)
        last = state
    decision = Decision(before, after, obs, reward, info)
    total = jax.tree.map(lambda *each: sum(each), *books)
    closing = check_closing(last, decision, total, config, params)
    for line in _lines("whole decision", last, after, config, params, closing):
        yield line
        yield from _sums(total, info)


def _lines(
    when: str,
    before: EnvState,
    after: EnvState,
    config: EnvConfig,
    params: EnvParams,
    *checks: Flags,
) -> Iterator[str]:
    """Lines on the findings of each failed check."""
    vehicles = after.vehicles
    lane = np.where(vehicles.active, vehicles.lane, np.iinfo(np.int32).max)
    order = np.lexsort((vehicles.x, lane))
    for check in checks:
        for invariant, parts in check.items():
            for what, flags in parts.items():
                places = np.argwhere(np.asarray(flags))
                if not len(places):
                    continue
                yield f"{when}: {invariant}: {what}: {len(places)}"
                for place in places[:MOST_SHOWN]:
                    for slot in _slots(invariant, np.shape(flags), place, order, config):
                        yield "    " + _vehicle(slot, before, after, config, params)


def _slots(
    invariant: str, shape: tuple[int, ...], place: np.ndarray, order: np.ndarray, config: EnvConfig
) -> list[int]:
    """Slots of the vehicles that a flag at this place concerns, if any."""
    if invariant in ("overlap", "passed"):
        return order[place[0] : place[0] + 2].tolist()
    if shape == (config.num_evs,):
        return [config.num_meds + int(place[0])]
    return [int(place[0])] if shape in ((config.num_vehicles,), (config.num_meds,)) else []


def _vehicle(
    slot: int, before: EnvState, after: EnvState, config: EnvConfig, params: EnvParams
) -> str:
    """A line on a vehicle before and after."""
    kind = int(after.vehicles.kind[slot])
    length = float(params.drivers.vehicle_length[kind])
    texts = []
    for state in (before, after):
        v = state.vehicles
        text = f"lane {v.lane[slot]} x {v.x[slot]:.3f} v {v.speed[slot]:.3f}"
        ev = slot - config.num_meds
        if slot < config.num_meds:
            text += f" status {state.meds.status[slot]} {state.meds.energy_j[slot]:.1f} J"
        elif ev < config.num_evs:
            text += f" {state.evs.energy_j[ev]:.1f} J MED {state.evs.med[ev]}.{state.evs.panel[ev]}"
        texts.append(text if v.active[slot] else f"({text})")
    return f"slot {slot}, {KINDS[kind].name}, {length:.2f} m: {texts[0]} -> {texts[1]}"


# Names in the books that differ in the tally.
TALLY_NAMES = {"sent_j": "energy_sent_j", "received_j": "energy_received_j"}


def _sums(books: Books, info: Any) -> Iterator[str]:
    """Lines with the books beside the tally."""
    for name in Books.__dataclass_fields__:
        theirs = getattr(info["tally"], TALLY_NAMES.get(name, name))
        yield f"    {name}: {np.asarray(getattr(books, name))}, tally {np.asarray(theirs)}"

"""Explains a violation tick by tick: which check failed, and the numbers of the vehicles concerned."""

import operator
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from benchmarks.verification.decisions import Decision, by_round, check_results, with_means
from benchmarks.verification.invariants import (
    Flags,
    check_entry,
    check_instant,
    check_state,
    check_tick,
)
from medjax.env.charging_env import ChargingEnv
from medjax.world.kinds import KINDS
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState, Vehicles

MOST_SHOWN = 4  # findings shown of each check


def _at(tree: Any, index: int) -> Any:
    return jax.tree.map(operator.itemgetter(index), tree)


def _sum(trees: list[Any]) -> Any:
    return jax.tree.map(lambda *each: sum(each), *trees)


def explain(
    env: ChargingEnv, params: EnvParams, key: jax.Array, before: EnvState, action: Any
) -> Iterator[str]:
    """Yields lines on what goes wrong in one environment's decision. Its probe must report the whole state."""
    world = env.config, params
    obs, after, reward, _, _, info = jax.jit(env.step_env)(key, before, action, params)
    rounds, last, all_ledgers = by_round(info["ticks"], env.config), before, []
    for number in range(env.config.rounds_per_decision):
        begun = _at(info["begun"], number)
        flags, ledger = check_entry(last, begun, *world)
        when = f"round {number}"
        for found in (flags, check_instant(begun, *world)):
            yield from _lines(f"{when}, entries", last, begun, world, found)
        last, of_ticks = begun, []
        for tick in range(env.config.ticks_per_round):
            state = _at(_at(rounds, number), tick)
            flags, more = check_tick(last, state, *world)
            of_ticks.append(more)
            for found in (flags, check_state(state, *world)):
                yield from _lines(f"{when}, tick {tick}", last, state, world, found)
            last = state
        all_ledgers.append(ledger | with_means(_sum(of_ticks), last, *world))
    ledger, decision = _sum(all_ledgers), Decision(before, after, obs, reward, info)
    lines = [*_lines("decision", last, after, world, check_results(last, decision, ledger, *world))]
    yield from lines
    for name, ours in ledger.items() if lines else ():
        yield f"    {name}: {np.asarray(ours)}, tally {np.asarray(getattr(info['step_stats'], name))}"


def _lines(
    when: str, before: EnvState, after: EnvState, world: tuple[EnvConfig, EnvParams], check: Flags
) -> Iterator[str]:
    """Lines on the findings of a failed check."""
    for invariant, parts in check.items():
        for what, flags in parts.items():
            indices = np.argwhere(np.asarray(flags))
            if len(indices):
                yield f"{when}: {invariant}: {what}: {len(indices)}"
            for index in indices[:MOST_SHOWN]:
                for slot in _slots(invariant, np.shape(flags), index, after.vehicles, world[0]):
                    yield "    " + _vehicle(slot, before, after, *world)


def _slots(
    invariant: str, shape: tuple[int, ...], index: Any, vehicles: Vehicles, config: EnvConfig
) -> list[int]:
    """Slots of the vehicles that a flag at this index concerns, if any."""
    if invariant in ("overlap", "passed"):
        lane = np.where(vehicles.active, vehicles.lane, np.iinfo(np.int32).max)
        return np.lexsort((vehicles.x, lane))[index[0] : index[0] + 2].tolist()
    if invariant == "boxes":
        return index.tolist()
    if shape == (config.num_evs,):
        return [config.num_meds + int(index[0])]
    return [int(index[0])] if shape in ((config.num_vehicles,), (config.num_meds,)) else []


def _vehicle(
    slot: int, before: EnvState, after: EnvState, config: EnvConfig, params: EnvParams
) -> str:
    """A line on a vehicle before and after."""
    kind, ev = int(after.vehicles.kind[slot]), slot - config.num_meds
    texts = []
    for state in (before, after):
        v = state.vehicles
        text = f"lane {v.lane[slot]} x {v.x[slot]:.3f} v {v.speed[slot]:.3f}"
        if slot < config.num_meds:
            text += f" status {state.meds.status[slot]} {state.meds.energy_j[slot]:.1f} J"
        elif ev < config.num_evs:
            text += f" {state.evs.energy_j[ev]:.1f} J MED {state.evs.med[ev]}.{state.evs.charging_slot[ev]}"
        texts.append(text if v.active[slot] else f"({text})")
    length = float(params.drivers.vehicle_length[kind])
    return f"slot {slot}, {KINDS[kind].name}, {length:.2f} m: {texts[0]} -> {texts[1]}"

"""Checks a whole decision against the invariants: its entries, every tick, and its results."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from benchmarks.verification.flows import FLOW_RTOL, total
from benchmarks.verification.invariants import (
    Flags,
    check_entry,
    check_instant,
    check_state,
    check_tick,
    count,
    not_finite,
    with_finite_waits,
)
from benchmarks.verification.ledger import Ledger, home_trip_energy, sums_by_class
from medjax.world.kinds import GAS_KINDS, by_class
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import AT_DEPOT, RETIRED, EnvState

ROUNDING = 2e-5  # relative, of sums over a decision
SHARES = ("depleted_share", "mean_soc", "exit_soc", "system_efficiency")  # metrics in [0, 1]


class Decision(NamedTuple):
    """Input and results of `env.step_env`, where the environment's probe reports the whole state."""

    before: EnvState
    after: EnvState
    obs: jax.Array
    reward: jax.Array
    info: Mapping[str, Any]


def check_decision(decision: Decision, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Violations of each of INVARIANTS in one decision, (K,) int32."""

    def look(last: EnvState, state: EnvState) -> tuple[EnvState, tuple[jax.Array, Ledger]]:
        """Checks a tick."""
        flags, ledger = check_tick(last, state, config, params)
        return state, (count(flags, check_state(state, config, params)), ledger)

    def play(last: EnvState, seen: tuple[EnvState, EnvState]) -> tuple[EnvState, Any]:
        """Checks a round of entries and its ticks."""
        begun, ticks = seen
        entered, ledger = check_entry(last, begun, config, params)
        counts = count(entered, check_instant(begun, config, params))
        last, found = jax.lax.scan(look, begun, ticks)
        of_ticks, more = jax.tree.map(lambda each: each.sum(axis=0), found)
        return last, (counts + of_ticks, ledger | with_means(more, last, config, params))

    seen = decision.info["begun"], by_round(decision.info["ticks"], config)
    last, found = jax.lax.scan(play, decision.before, seen)
    counts, ledger = jax.tree.map(lambda each: each.sum(axis=0), found)
    return counts + count(check_results(last, decision, ledger, config, params))


def with_means(ledger: Ledger, last: EnvState, config: EnvConfig, params: EnvParams) -> Ledger:
    """Adds to a round's ledger the time integrals of mean SoC, taken from the last state, and of mean EV speed."""
    on_road = last.vehicles.active[config.ev_slots]
    charge = jnp.where(on_road, last.evs.energy_j / params.ev_capacity_j, 0.0)
    soc = jnp.sum(charge) / jnp.maximum(jnp.sum(on_road), 1)
    seconds = ledger["ev_seconds"]
    speed = ledger["ev_distance_m"] / jnp.where(seconds > 0.0, seconds, 1.0)
    return ledger | {"mean_soc_s": soc * config.round_s, "mean_speed_m": speed * config.round_s}


def by_round(ticks: Any, config: EnvConfig) -> Any:
    """Splits the probe's report on a decision's ticks by entry rounds: (ticks, ...) to (rounds, ticks, ...)."""
    shape = config.rounds_per_decision, config.ticks_per_round
    return jax.tree.map(lambda each: each.reshape(*shape, *each.shape[1:]), ticks)


def check_results(
    last: EnvState, decision: Decision, ledger: Ledger, config: EnvConfig, params: EnvParams
) -> Flags:
    """Checks the results of a decision against the state after its last tick and the ledger of its ticks."""
    after, info = decision.after, decision.info
    # After the last tick the clock advances. MEDs may then reach their depots, which recharge them.
    home = (last.meds.status == RETIRED) & (after.meds.status == AT_DEPOT)
    refilled = jnp.where(home, params.med_capacity_j, last.meds.energy_j)
    # EVs that left at an exit to charge have then reached their plugs.
    vehicles, slots = last.vehicles, config.ev_slots
    gone = ~vehicles.active[slots] & ~last.evs.is_depleted & (config.num_plugs > 0)
    gone &= vehicles.x[slots] <= params.road.length_m
    evs = last.evs.replace(stops=last.evs.stops & ~gone)
    same = jax.tree.map(lambda a, b: a != b, (last.vehicles, evs), (after.vehicles, after.evs))
    numbers = (
        decision.obs,
        decision.reward,
        info["step_stats"],
        info["metrics"],
        info["reward_terms"],
    )
    home_j = jnp.sum(jnp.where(home, home_trip_energy(last, config, params), 0.0))
    ledger = ledger | {
        "med_driving_j": ledger["med_driving_j"] + home_j,
        "plug_charging_s": seconds_at_plugs(decision, config),
    }
    flags = tally_mistakes(ledger, decision, config, params)
    flags["energy"]["refill"] = after.meds.energy_j != refilled
    given_j = jnp.sum(jnp.where(home, refilled - last.meds.energy_j - last.meds.rest_j, 0.0))
    flags["energy"]["depots"] = differs(given_j + home_j, info["step_stats"].depot_energy_j, 1.0)
    return {
        **flags,
        "motion": {"between decisions": jnp.stack([x.any() for x in jax.tree.leaves(same)])},
        "finite": not_finite((numbers, with_finite_waits(after))),
    }


def seconds_at_plugs(decision: Decision, config: EnvConfig) -> jax.Array:
    """Seconds for which EVs took plugs, from how much later the plugs are free at the end of each round, () s."""
    begun, after = decision.info["begun"].plugs_free_in_s, decision.after.plugs_free_in_s
    if after is None:
        return jnp.zeros(())
    ends, left = jnp.concatenate([begun[1:], after[None]]), begun - config.round_s
    # Clocks take a rest below a hundredth of a round for rounding.
    return total(ends - jnp.where(left > 0.01 * config.round_s, left, 0.0))


def differs(ours: jax.Array, theirs: jax.Array, scale: Any = 0.0) -> jax.Array:
    """Whether numbers differ by more than rounding, relative to the larger one or to `scale`."""
    most = jnp.maximum(jnp.maximum(jnp.abs(ours), jnp.abs(theirs)), scale)
    return ~(jnp.abs(ours - theirs) <= ROUNDING * most)


def outside(bounds: jax.Array, value: jax.Array) -> jax.Array:
    """Whether an energy flow is outside its bounds (2,)."""
    slack = FLOW_RTOL * jnp.abs(value)
    return ~((bounds[0] - slack <= value) & (value <= bounds[1] + slack))


def distance_resolution(ledger: Ledger, config: EnvConfig, params: EnvParams) -> jax.Array:
    """The scale with which `differs` lets distances differ by the rounding of positions, half a unit in the last place.

    It covers sums over all vehicles. It also covers a mean to which one vehicle contributes in one tick of a round.
    """
    ticks = ledger["vehicle_ticks"] + config.ticks_per_round
    return ticks * 1e-7 * params.road.length_m / ROUNDING


def tally_mistakes(
    ledger: Ledger, decision: Decision, config: EnvConfig, params: EnvParams
) -> dict[str, dict[str, jax.Array]]:
    """Flags where the tally, the reward or the number of vehicles differs from the ledger, by invariant and name."""
    stats, resolution = decision.info["step_stats"], distance_resolution(ledger, config, params)
    scales = {name: resolution if name.endswith("_m") else 1e-3 for name in ledger}
    # Delays are small differences of times on the road, so they are only as exact as those times. As desired speeds are
    # at least 1 m/s, an error in distance, in m, becomes at most the same error in time, in s.
    ticks = ledger["vehicle_ticks"] + jnp.sum(ledger["left"])  # a vehicle's last tick counts, too
    scales |= dict.fromkeys(("ev_delay_s", "gas_delay_s"), ticks * config.tick_s + resolution)
    flows, counted = {}, {}
    for name, ours in ledger.items():
        if name.endswith("_j"):
            flows[name] = outside(ours, getattr(stats, name))
        else:
            counted[name] = differs(ours, getattr(stats, name), scales[name])
    shares = jnp.stack([decision.info["metrics"][name] for name in SHARES])
    after, sums = decision.after, decision.after.stats
    added = jax.tree.map(lambda a, b, c: differs(a + b, c), decision.before.stats, stats, sums)
    # The tally counts a depleted EV at once, but it stays on the road until it is on the shoulder or towed.
    stranded = total(after.vehicles.active[config.ev_slots] & after.evs.is_depleted)
    there = by_class(sums.entered - sums.left).at[1].add(stranded - sums.depleted)
    return {
        "tally": {
            **counted,
            "collisions": stats.collisions > 0.0,
            "sums": jnp.stack([x.any() for x in jax.tree.leaves(added)]),
            "shares": ~((shares >= 0.0) & (shares <= 1.0 + ROUNDING)),
        },
        "energy": flows,
        "vehicles": {
            "entered less left and depleted": there != sums_by_class(after.vehicles.active, config)
        },
        "reward": reward_mistakes(ledger, decision, config, params),
    }


def reward_mistakes(
    ledger: Ledger, decision: Decision, config: EnvConfig, params: EnvParams
) -> dict[str, jax.Array]:
    """Flags where the reward is not the sum of its terms, or a term differs from the ledger."""
    stats = decision.info["step_stats"]
    resolution = distance_resolution(ledger, config, params)
    weights, terms = params.reward_weights, decision.info["reward_terms"]
    added, size = (sum(map(of, terms.values()), jnp.zeros(())) for of in (jnp.asarray, jnp.abs))
    cruise = params.drivers.desired_speed[jnp.array(GAS_KINDS)]
    lost_j = stats.energy_sent_j - stats.energy_received_j
    seconds, distance_m = ledger["gas_seconds"], ledger["gas_distance_m"]
    expected = {
        "depleted": (ledger["depleted"], 0.0),
        "soc": (ledger["mean_soc_s"], 0.0),
        "distance": (ledger["ev_distance_m"] / 1000.0, resolution / 1000.0),
        "speed": (ledger["mean_speed_m"] / 30.0, resolution / 30.0),
        "dispatches": (ledger["meds_dispatched"], 0.0),
        "gas_delay": (
            jnp.sum(seconds - distance_m / cruise),
            jnp.sum(seconds + (distance_m + resolution) / cruise),
        ),
        "lane_changes": (ledger["lane_changes"], 0.0),
        "collisions": (jnp.zeros(()), 0.0),
        "transfer_loss": (lost_j / 3.6e6, stats.energy_sent_j / 3.6e6),
    }
    named = {
        name: differs(weights[name] * value, terms[name], jnp.abs(weights[name]) * scale + 1e-30)
        for name, (value, scale) in expected.items()
    }
    return {"sum": differs(decision.reward, added, size), **named}

"""Checks a whole decision against the invariants: its entries, every tick, and its results."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from benchmarks.verification.books import Books, sums_by_class, ways_home
from benchmarks.verification.flows import OF_FLOW
from benchmarks.verification.flows import total as total_of
from benchmarks.verification.invariants import (
    Counts,
    Flags,
    check_entry,
    check_standing,
    check_state,
    check_tick,
    count,
    not_finite,
    with_finite_waits,
)
from medjax.world.kinds import GAS_KINDS, by_class
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import AT_DEPOT, RETIRED, EnvState

ROUNDING = 2e-5  # relative, of sums over a decision
DRIVING = ("ev_driving_j", "ev_cruising_j", "med_driving_j")
SHARES = ("depleted_share", "mean_soc", "exit_soc", "system_efficiency")  # metrics in [0, 1]


class Decision(NamedTuple):
    """Input and results of `env.step_env`, where the environment's probe reports the whole state."""

    before: EnvState
    after: EnvState
    obs: jax.Array
    reward: jax.Array
    info: Mapping[str, Any]


def check_decision(decision: Decision, config: EnvConfig, params: EnvParams) -> Counts:
    """Violations in one decision by invariant, `()` int32 each."""

    def look(carry: tuple[EnvState, Counts, Books], state: EnvState) -> tuple[Any, None]:
        last, counts, books = carry
        flags, more = check_tick(last, state, config, params)
        found = count(flags, check_state(state, config, params))
        return (state, *jax.tree.map(jnp.add, (counts, books), (found, more))), None

    def play(
        last: EnvState, seen: tuple[EnvState, EnvState]
    ) -> tuple[EnvState, tuple[Counts, Books]]:
        """Checks a round of entries and its ticks."""
        begun, ticks = seen
        entered, books = check_entry(last, begun, config, params)
        counts = count(entered, check_standing(begun, config, params))
        (last, counts, books), _ = jax.lax.scan(look, (begun, counts, books), ticks)
        return last, (counts, with_means(books, last, config, params))

    seen = decision.info["begun"], by_round(decision.info["ticks"], config)
    last, found = jax.lax.scan(play, decision.before, seen)
    counts, books = jax.tree.map(lambda each: each.sum(axis=0), found)
    closing = check_closing(last, decision, books, config, params)
    return jax.tree.map(jnp.add, counts, count(closing))


def with_means(books: Books, last: EnvState, config: EnvConfig, params: EnvParams) -> Books:
    """Adds a round's time integrals of EVs' mean charge, by its last state, and mean speed."""
    on_road = last.vehicles.active[config.ev_slots]
    charge = jnp.where(on_road, last.evs.energy_j / params.ev_capacity_j, 0.0)
    soc = jnp.sum(charge) / jnp.maximum(jnp.sum(on_road), 1)
    there = books.ev_seconds > 0.0
    speed = jnp.where(there, books.ev_distance_m / jnp.where(there, books.ev_seconds, 1.0), 0.0)
    return books.replace(mean_soc_s=soc * config.round_s, mean_speed_m=speed * config.round_s)


def by_round(ticks: Any, config: EnvConfig) -> Any:
    """Splits what a probe reports of a decision's ticks by entry rounds: (ticks, ...) to (rounds, ticks, ...)."""
    return jax.tree.map(
        lambda each: each.reshape(-1, config.ticks_per_round, *each.shape[1:]), ticks
    )


def check_closing(
    last: EnvState, decision: Decision, books: Books, config: EnvConfig, params: EnvParams
) -> Flags:
    """Checks the results of a decision against the state after its last tick and the books of its ticks."""
    after, info = decision.after, decision.info
    # After the last tick the clock advances, and MEDs may reach their depots and be recharged.
    home = (last.meds.status == RETIRED) & (after.meds.status == AT_DEPOT)
    refilled = jnp.where(home, params.med_capacity_j, last.meds.energy_j)
    same = jax.tree.map(lambda a, b: a != b, (last.vehicles, last.evs), (after.vehicles, after.evs))
    numbers = decision.obs, decision.reward, info["tally"], info["metrics"], info["reward_terms"]
    home_j = jnp.sum(jnp.where(home, ways_home(last, config, params), 0.0))
    books = books.replace(med_driving_j=books.med_driving_j + home_j)
    flags = tally_mistakes(books, decision, config, params)
    flags["energy"]["refill"] = after.meds.energy_j != refilled
    given_j = jnp.sum(jnp.where(home, refilled - last.meds.energy_j - last.meds.rest_j, 0.0))
    flags["energy"]["depots"] = differs(given_j + home_j, info["tally"].depot_energy_j, 1.0)
    return {
        **flags,
        "motion": {"between decisions": jnp.stack([x.any() for x in jax.tree.leaves(same)])},
        "finite": not_finite((numbers, with_finite_waits(after))),
    }


def differs(ours: jax.Array, theirs: jax.Array, scale: Any = 0.0) -> jax.Array:
    """Whether numbers differ by more than rounding, relative to the larger one or to `scale`."""
    most = jnp.maximum(jnp.maximum(jnp.abs(ours), jnp.abs(theirs)), scale)
    return ~(jnp.abs(ours - theirs) <= ROUNDING * most)


def outside(bounds: jax.Array, value: jax.Array) -> jax.Array:
    """Whether an energy flow is outside its bounds (2,)."""
    slack = OF_FLOW * jnp.abs(value)
    return ~((bounds[0] - slack <= value) & (value <= bounds[1] + slack))


def resolved_way(books: Books, config: EnvConfig, params: EnvParams) -> jax.Array:
    """The scale for `differs` of distances that allows for rounding of positions to half a unit in the last place.

    It covers all vehicles, and a vehicle present in a single tick of a round, which is then the round's mean.
    """
    ticks = books.vehicle_ticks + config.ticks_per_round
    return ticks * 1e-7 * params.road.length_m / ROUNDING


def tally_mistakes(
    books: Books, decision: Decision, config: EnvConfig, params: EnvParams
) -> dict[str, dict[str, jax.Array]]:
    """Flags where the tally, the reward or the number of vehicles differs from the books, by invariant and name."""
    tally, way = decision.info["tally"], resolved_way(books, config, params)
    scales = {name: way if name.endswith("_m") else 1e-3 for name in Books.__dataclass_fields__}
    # Delays are small differences, only as exact as the times on the road. Desired speeds of at least 1 m/s turn an
    # error in distance into at most that error in time.
    ticks = books.vehicle_ticks + jnp.sum(books.left)  # leavers were there, too
    scales |= dict.fromkeys(("ev_delay_s", "gas_delay_s"), ticks * config.tick_s + way)
    counted = {
        name: differs(getattr(books, name), getattr(tally, name), scale)
        for name, scale in scales.items()
        if not name.endswith("_j")
    }
    shares = jnp.stack([decision.info["metrics"][name] for name in SHARES])
    total = decision.after.tally
    sums = jax.tree.map(lambda a, b, c: differs(a + b, c), decision.before.tally, tally, total)
    lost = by_class(total.entered - total.left) - jnp.zeros((3,)).at[1].set(total.depleted)
    after = decision.after
    stranded = total_of(after.vehicles.active[config.ev_slots] & after.evs.is_depleted)
    lost += jnp.zeros((3,)).at[1].set(stranded)  # counted as depleted but still on the road
    lost = lost != sums_by_class(after.vehicles.active, config)
    return {
        "tally": {
            **counted,
            "collisions": tally.collisions > 0.0,
            "sums": jnp.stack([x.any() for x in jax.tree.leaves(sums)]),
            "shares": ~((shares >= 0.0) & (shares <= 1.0 + ROUNDING)),
        },
        "energy": {
            "sent": outside(books.sent_j, tally.energy_sent_j),
            "received": outside(books.received_j, tally.energy_received_j),
            **{name: outside(getattr(books, name), getattr(tally, name)) for name in DRIVING},
        },
        "vehicles": {"entered less left and depleted": lost},
        "reward": reward_mistakes(books, decision, config, params),
    }


def reward_mistakes(
    books: Books, decision: Decision, config: EnvConfig, params: EnvParams
) -> dict[str, jax.Array]:
    """Flags where the reward is not the sum of its terms, or a term differs from the books."""
    tally = decision.info["tally"]
    way = resolved_way(books, config, params)
    weights, terms = params.reward_weights, decision.info["reward_terms"]
    added = sum(terms.values(), jnp.zeros(()))
    size = sum((jnp.abs(term) for term in terms.values()), jnp.zeros(()))
    cruise = params.drivers.desired_speed[jnp.array(GAS_KINDS)]
    lost_j = tally.energy_sent_j - tally.energy_received_j
    expected = {
        "depleted": (books.depleted, 0.0),
        "soc": (books.mean_soc_s, 0.0),
        "distance": (books.ev_distance_m / 1000.0, way / 1000.0),
        "speed": (books.mean_speed_m / 30.0, way / 30.0),
        "dispatches": (books.meds_dispatched, 0.0),
        "gas_delay": (
            jnp.sum(books.gas_seconds - books.gas_distance_m / cruise),
            jnp.sum(books.gas_seconds + (books.gas_distance_m + way) / cruise),
        ),
        "lane_changes": (books.lane_changes, 0.0),
        "collisions": (jnp.zeros(()), 0.0),
        "transfer_loss": (lost_j / 3.6e6, tally.energy_sent_j / 3.6e6),
    }
    named = {
        name: differs(weights[name] * value, terms[name], jnp.abs(weights[name]) * scale + 1e-30)
        for name, (value, scale) in expected.items()
    }
    return {"sum": differs(decision.reward, added, size), **named}

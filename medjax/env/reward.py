"""The reward: a weighted sum of named terms, either eq (10) of the paper (`TERMS`) or the cost in money (`MONEY`).

A term is a function of `Outcome` that returns a float32 scalar. Each is a count or a time integral, so the total does
not depend on the length of a decision. Pass your own with `medjax.make(..., reward={**TERMS, "mine": my_term})`.
Weights are leaves of `EnvParams.reward_weights`, by the same names; those of `MONEY` are prices.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from medjax.errors import InputError, renamed, shown
from medjax.world.kinds import GAS_KINDS
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState, EpisodeStats


class Outcome(struct.PyTreeNode):
    """Outcome of one decision: everything that a reward term may read."""

    before: EnvState
    after: EnvState
    step_stats: EpisodeStats  # sums over the ticks of this decision
    params: EnvParams
    config: EnvConfig = struct.field(pytree_node=False)

    @property
    def happened(self) -> EpisodeStats:
        """Former name of `step_stats`, for one more version."""
        return renamed("Outcome.happened", "step_stats", self.step_stats)


RewardTerm = Callable[[Outcome], jax.Array]


def depleted(outcome: Outcome) -> jax.Array:
    """EVs that ran out in this decision: the paper's P_depleted; its weight should be negative."""
    return outcome.step_stats.depleted


def soc(outcome: Outcome) -> jax.Array:
    """Mean state of charge of the EVs on the road, R_SoC, times the decision's seconds; 0 on a road without EVs."""
    return outcome.step_stats.mean_soc_s


def distance(outcome: Outcome) -> jax.Array:
    """Kilometres covered by all EVs in this decision, R_d."""
    return outcome.step_stats.ev_distance_m * 1e-3


def speed(outcome: Outcome) -> jax.Array:
    """Mean speed of the EVs, R_v, in 30 m/s, times the decision's seconds; 0 on a road without EVs."""
    return outcome.step_stats.mean_speed_m / 30.0


def dispatches(outcome: Outcome) -> jax.Array:
    """MEDs sent in this decision."""
    return outcome.step_stats.meds_dispatched


def gas_delay(outcome: Outcome) -> jax.Array:
    """Delay of gas vehicles relative to the mean desired speed of their kind, vehicle-seconds; negative: a gain."""
    step_stats = outcome.step_stats
    cruise = outcome.params.drivers.desired_speed[jnp.array(GAS_KINDS)]
    return jnp.sum(step_stats.gas_seconds - step_stats.gas_distance_m / cruise)


def lane_changes(outcome: Outcome) -> jax.Array:
    """Lane changes of all vehicles in this decision."""
    return outcome.step_stats.lane_changes


def collisions(outcome: Outcome) -> jax.Array:
    """Vehicles that overlap their leader, summed over ticks; 0 in a sound simulation."""
    return outcome.step_stats.collisions


def transfer_loss(outcome: Outcome) -> jax.Array:
    """Energy lost in transfer from MEDs to EVs in this decision, kWh."""
    return (outcome.step_stats.energy_sent_j - outcome.step_stats.energy_received_j) / 3.6e6


def delay_h(outcome: Outcome) -> jax.Array:
    """Delay of EVs and gas vehicles relative to desired speeds, plus everyone's wait to enter, vehicle-hours."""
    step_stats = outcome.step_stats
    return (step_stats.ev_delay_s + step_stats.gas_delay_s + step_stats.queue_seconds) / 3600.0


def depot_kwh(outcome: Outcome) -> jax.Array:
    """Energy that MEDs used to drive and sent to EVs, kWh, which depots replace, times the hour's price factor."""
    return _out_of_meds_kwh(outcome) * hourly_price(outcome)


def hourly_price(outcome: Outcome) -> jax.Array:
    """Factor of the price of electricity in the hour of the day in which the decision begins."""
    time_s = outcome.params.demand.start_s + outcome.before.time * outcome.config.decision_s
    prices = outcome.params.market.hourly_price
    return prices[jnp.floor(time_s / 3600.0).astype(jnp.int32) % prices.shape[0]]


def med_wear_kwh(outcome: Outcome) -> jax.Array:
    """Energy out of MEDs' batteries, to drive and to EVs, kWh."""
    return _out_of_meds_kwh(outcome)


def _out_of_meds_kwh(outcome: Outcome) -> jax.Array:
    return (outcome.step_stats.med_driving_j + outcome.step_stats.energy_sent_j) / 3.6e6


def ev_wear_kwh(outcome: Outcome) -> jax.Array:
    """Energy out of EVs' batteries, kWh."""
    return outcome.step_stats.ev_driving_j / 3.6e6


def ev_kwh(outcome: Outcome) -> jax.Array:
    """Energy that EVs used to drive minus what they received from MEDs, kWh; they buy it at their next long stop."""
    return (outcome.step_stats.ev_driving_j - outcome.step_stats.energy_received_j) / 3.6e6


def med_h(outcome: Outcome) -> jax.Array:
    """MED and driver hours, from dispatch until the MED leaves at an exit or the end of the road."""
    return outcome.step_stats.med_seconds / 3600.0


def tows(outcome: Outcome) -> jax.Array:
    """EVs that ran out."""
    return outcome.step_stats.depleted


def charging_stops(outcome: Outcome) -> jax.Array:
    """EVs that left for a charger without simulated plugs, or passed the road's end with less than `request_soc`."""
    return outcome.step_stats.low_exits - outcome.step_stats.plug_stops


def plug_h(outcome: Outcome) -> jax.Array:
    """Time that EVs wait for plugs at exits and charge there, hours, booked when they arrive."""
    return (outcome.step_stats.plug_wait_s + outcome.step_stats.plug_charging_s) / 3600.0


def plug_kwh(outcome: Outcome) -> jax.Array:
    """Energy that EVs take at plugs, kWh; its price is what it costs more than at home."""
    return outcome.step_stats.plug_energy_j / 3.6e6


_PAPER = (
    *(depleted, soc, distance, speed),
    *(dispatches, gas_delay, lane_changes, collisions, transfer_loss),
)
TERMS: Mapping[str, RewardTerm] = {term.__name__: term for term in _PAPER}
_MONEY = (
    *(delay_h, depot_kwh, ev_kwh, med_h, tows, charging_stops),
    *(plug_h, plug_kwh, med_wear_kwh, ev_wear_kwh),
)
MONEY: Mapping[str, RewardTerm] = {term.__name__: term for term in _MONEY}
REWARDS: Mapping[str, Mapping[str, RewardTerm]] = {"paper": TERMS, "money": MONEY}
"""The sets that `medjax.make` knows by name."""


def check_terms(reward: Any) -> None:
    """Raises InputError unless reward maps names to functions."""
    if not isinstance(reward, Mapping):
        raise InputError(f"reward = {shown(reward)}: allowed functions by name")
    for name, term in reward.items():
        if not isinstance(name, str) or not callable(term):
            raise InputError(f"reward[{shown(name)}] = {shown(term)}: allowed a function")


def total_reward(
    outcome: Outcome, terms: Mapping[str, RewardTerm]
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Weighted sum of the terms, and each weighted term by name; float32 scalars.

    Raises:
      InputError: while tracing, if a term has no weight or does not return a scalar.
    """
    weights, given = outcome.params.reward_weights, {}
    for name, term in terms.items():
        if name not in weights:
            every = ", ".join(terms)
            raise InputError(
                f"reward_weights have no {shown(name)}: allowed a weight for each of {every}"
            )
        given[name] = term(outcome)
        if shape := jnp.shape(given[name]):
            what = f"reward term {shown(name)} returns shape {shape}"
            raise InputError(f"{what}: allowed (), a scalar")
    # Without the barrier, XLA would multiply scalar weights with a term's constants first, so that a single environment
    # would round differently from the same one in a batch.
    values = jax.lax.optimization_barrier(given)
    parts = {
        name: jnp.asarray(weights[name] * value, jnp.float32) for name, value in values.items()
    }
    return sum(parts.values(), jnp.zeros((), jnp.float32)), parts

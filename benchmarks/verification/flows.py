"""Energy that flowed in a tick, from states alone.

What a battery took in is what it holds more than before, plus what driving cost it. That cost is worked out here by the
work of eqs (7)-(8) in another form: forces times the way, and the change of kinetic energy. A battery that is
full or empty hides a part of what flowed, so flows are intervals, `Flow`. What driving is said to have cost is held
against the batteries, too: a formula alone would agree with a simulator that pays for energy that nothing took.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from medjax.world.params import BodyParams, EnvConfig, EnvParams, RoadParams
from medjax.world.state import NOT_BOOKED, EnvState, Vehicles

GRAVITY = 9.81  # m/s^2
# Energies are float32 numbers of up to a full battery and change twice a tick: each change rounds by at most half a
# unit in the last place, 6e-8 of the capacity. Ten times that is a twentieth of what a tick of driving costs.
OF_CAPACITY = 1e-6
# What flows in a tick is the result of a dozen float32 operations.
OF_FLOW = 1e-5


class Flow(NamedTuple):
    """At least and at most so much, J."""

    low: jax.Array
    high: jax.Array


def total(values: jax.Array) -> jax.Array:
    """Sum, () float32."""
    return jnp.sum(values, dtype=jnp.float32)


def driving(
    before: Vehicles,
    after: Vehicles,
    slots: slice,
    body: BodyParams,
    road: RoadParams,
    dt: float,
) -> tuple[jax.Array, jax.Array]:
    """Energy that a tick of driving takes from each battery, and how far float32 may be off it, (C,) J each."""
    v0, v1 = before.speed[slots], after.speed[slots]
    way = 0.5 * (v0 + v1) * dt
    rolling = body.mass_kg * GRAVITY * body.rolling_resistance * way
    climbing = body.mass_kg * GRAVITY * jnp.sin(road.slope) * way
    drag = (
        road.air_density * body.drag_coefficient * body.frontal_area_m2 * (v0 + v1) ** 2 * way / 8.0
    )
    inertia = body.mass_kg * body.rotational_inertia_factor
    kinetic = 0.5 * inertia * (v1 - v0) * (v1 + v0)
    wheels = rolling + climbing + drag + kinetic
    auxiliary = body.auxiliary_w * dt
    used, regained = wheels / body.drivetrain_efficiency, wheels * body.regeneration_efficiency
    battery = jnp.where(wheels > 0.0, used, regained) + auxiliary
    # The difference of two speeds is as exact as they are.
    gross = (
        rolling
        + jnp.abs(climbing)
        + drag
        + jnp.abs(kinetic)
        + 2e-2 * inertia * OF_FLOW * (v0 + v1) ** 2
    )
    off = OF_FLOW * (gross / body.drivetrain_efficiency + auxiliary)
    on_road = before.active[slots]
    return jnp.where(on_road, battery, 0.0), jnp.where(on_road, off, 0.0)


Change = tuple[jax.Array, jax.Array, jax.Array, jax.Array]


def _change(
    before_j: jax.Array, after_j: jax.Array, driven: tuple[jax.Array, jax.Array], capacity: Any
) -> Change:
    """What batteries gained but for driving, how far float32 may be off it, J, and who is full and empty; (C,) each."""
    gain = after_j - before_j + driven[0]
    slack = OF_CAPACITY * capacity + driven[1] + OF_FLOW * jnp.abs(gain)
    return gain, slack, after_j >= capacity, after_j <= 0.0


def _received(change: Change, most: jax.Array) -> Flow:
    """What came into EVs' batteries, (E,) each, `most` at most."""
    gain, slack, full, empty = change
    # A full battery takes no charge beyond its room, so a lack there is braking energy that found none. An empty one
    # may have got something, and spent it.
    low = jnp.where(full, jnp.maximum(gain, 0.0), jnp.where(empty, jnp.minimum(gain, 0.0), gain))
    high = jnp.where(full, jnp.maximum(gain, 0.0), jnp.where(empty, jnp.minimum(gain, most), gain))
    return Flow(low - slack, high + slack)


def _sent(change: Change, most: jax.Array) -> Flow:
    """What MEDs gave, (M,) each, `most` at most."""
    gain, slack, full, empty = change
    # A full one may have lost braking energy that found no room; an empty one drives on what it does not have.
    low = jnp.where(full, jnp.minimum(-gain, 0.0), -gain)
    high = jnp.where(empty, jnp.maximum(-gain, most), -gain)
    return Flow(low - slack, high + slack)


def cruising(
    before: Vehicles, after: Vehicles, slots: slice, body: BodyParams, road: RoadParams
) -> tuple[jax.Array, jax.Array]:
    """As `driving`, what the way of a tick takes at everyone's own desired speed, (C,) J each."""
    steady = before.replace(speed=before.desired_speed)
    seconds = (after.x - before.x)[slots] / before.desired_speed[slots]
    power, off = driving(steady, steady, slots, body, road, 1.0)
    return power * seconds, off * seconds


class Held(NamedTuple):
    """What a battery lost, whatever went in or out besides, and where the formula need not agree; (C,) each."""

    lost: Flow
    slack: jax.Array  # J, how far it may be off
    less: jax.Array  # bool, driving may have taken less than the formula says
    more: jax.Array  # bool, or more


def _held(driven: tuple[jax.Array, jax.Array], held: Held) -> Flow:
    """What driving took: as the formula says (`driving`), as far as batteries lost it; (C,) J each."""
    (value, off), slack = driven, held.slack
    low, high = held.lost.low - slack, held.lost.high + slack
    least = jnp.clip(value - off, low, high - 2.0 * slack)
    most = jnp.clip(value + off, low + 2.0 * slack, high)
    return Flow(jnp.where(held.less, low, least), jnp.where(held.more, high, most))


def tick_flows(
    before: EnvState, after: EnvState, config: EnvConfig, params: EnvParams
) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
    """Energy that flowed in one tick: flags for what cannot be, and (2,) J at least and at most, by name."""
    old, new, dt = before.vehicles, after.vehicles, config.tick_s
    evs, was, link = after.evs, before.evs, params.link
    slot = params.charging.slot_power_w * dt
    # Losses in the EV's own coil remain however strong the coupling.
    best = link.load_ohm / (link.load_ohm + link.ev_resistance_ohm)
    charges = (was.med != NOT_BOOKED) & evs.served
    takes = jnp.where(charges, best * slot, 0.0)
    partner = charges[:, None] & (was.med[:, None] == jnp.arange(config.num_meds))
    gives = slot * jnp.sum(partner, axis=0)

    road, capacity = params.road, params.med_capacity_j
    of_evs, at_cruise = (
        jax.tree.map(lambda each: jnp.where(was.is_depleted, 0.0, each), energy)  # without motor
        for energy in (
            driving(old, new, config.ev_slots, params.ev, road, dt),
            cruising(old, new, config.ev_slots, params.ev, road),
        )
    )
    change = _change(was.energy_j, evs.energy_j, of_evs, params.ev_capacity_j)
    received, (_, slack, full, empty) = _received(change, takes), change
    lost = was.energy_j - evs.energy_j
    # Who runs out is driven by what there was; braking energy that finds no room is nobody's.
    taken = _held(of_evs, Held(Flow(lost, lost + takes), slack, empty, full))
    least = was.energy_j - params.ev_capacity_j
    value, off = at_cruise
    steady = Flow(jnp.maximum(value - off, least), jnp.maximum(value + off, least))
    of_meds = driving(old, new, config.med_slots, params.med, road, dt)
    change = _change(before.meds.energy_j, after.meds.energy_j, of_meds, capacity)
    sent, (_, slack, full, empty) = _sent(change, gives), change
    lost = before.meds.energy_j - after.meds.energy_j
    # An empty one drives on what it does not have, and that counts.
    most = jnp.where(empty, jnp.maximum(of_meds[0], lost), lost)
    given = _held(of_meds, Held(Flow(lost - gives, most), slack, jnp.zeros_like(empty), full))
    driven = {"ev_driving_j": taken, "ev_cruising_j": steady, "med_driving_j": given}
    above_reserve = before.meds.energy_j - params.fleet.reserve_soc * capacity
    arrived = jnp.sum(jnp.where(partner, received.low[:, None], 0.0), axis=0)
    too_much = partner.any(axis=0) & (arrived > best * sent.high)
    wrong = {
        "EV loses": received.high < 0.0,
        "EV gains from nowhere": received.low > takes * (1.0 + OF_FLOW),
        "MED gains": sent.high < 0.0,
        "MED loses": sent.low > gives * (1.0 + OF_FLOW),
        "MED below its reserve": (gives > 0.0) & (sent.low > jnp.maximum(above_reserve, 0.0)),
        "more arrives than the link lets through": too_much,
    }

    def both(flow: Flow, concerned: jax.Array) -> jax.Array:
        return jnp.stack([total(jnp.where(concerned, bound, 0.0)) for bound in flow])

    flows = {"sent_j": both(sent, gives > 0.0), "received_j": both(received, charges)}
    return wrong, flows | {name: jnp.stack([*map(total, flow)]) for name, flow in driven.items()}

"""Energy flows of a tick, from states alone.

The intake of a battery is its gain plus the energy that driving took. The driving energy follows from another form of
eqs (7)-(8): forces times distance, plus the change of kinetic energy. A full or empty battery hides part of a flow, so
the functions here return bounds of a flow (`EnergyBounds`). They also limit the driving energy to what the batteries
lost, since the formula alone would accept a simulator that counts energy without taking it from a battery.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from medjax.world.params import BodyParams, EnvConfig, EnvParams, RoadParams
from medjax.world.state import NOT_BOOKED, EnvState, Vehicles

GRAVITY = 9.81  # m/s^2
# Relative to the capacity. Energies are float32 numbers of up to a full battery and change twice per tick. Each change
# rounds by at most half a unit in the last place, 6e-8 of the capacity. This tolerance is some ten times the sum of
# both, and still only a twentieth of the energy that a tick of driving takes.
CAPACITY_RTOL = 1e-6
# Relative to the flow. A dozen float32 operations lead to the flow of a tick.
FLOW_RTOL = 1e-5


class EnergyBounds(NamedTuple):
    """Lower and upper bound of an energy flow, J."""

    low: jax.Array
    high: jax.Array


def total(values: jax.Array) -> jax.Array:
    """Sum as () float32."""
    return jnp.sum(values, dtype=jnp.float32)


def driving(
    before: Vehicles, after: Vehicles, slots: slice, body: BodyParams, road: RoadParams, dt: float
) -> tuple[jax.Array, jax.Array]:
    """Energy that a tick of driving takes from each battery, and its float32 error bound, (C,) J each."""
    v0, v1 = before.speed[slots], after.speed[slots]
    distance, weight = 0.5 * (v0 + v1) * dt, body.mass_kg * GRAVITY
    rolling, climbing = (
        weight * body.rolling_resistance * distance,
        weight * jnp.sin(road.slope) * distance,
    )
    air = road.air_density * body.drag_coefficient * body.frontal_area_m2
    drag = air * (v0 + v1) ** 2 * distance / 8.0
    inertia = body.mass_kg * body.rotational_inertia_factor
    kinetic = 0.5 * inertia * (v1 - v0) * (v1 + v0)
    wheels = rolling + climbing + drag + kinetic
    auxiliary = body.auxiliary_w * dt
    used, regained = wheels / body.drivetrain_efficiency, wheels * body.regeneration_efficiency
    battery = jnp.where(wheels > 0.0, used, regained) + auxiliary
    gross = rolling + jnp.abs(climbing) + drag + jnp.abs(kinetic)
    gross += 2e-2 * inertia * FLOW_RTOL * (v0 + v1) ** 2  # rounding of the difference of two speeds
    off = FLOW_RTOL * (gross / body.drivetrain_efficiency + auxiliary)
    on_road = before.active[slots]
    return jnp.where(on_road, battery, 0.0), jnp.where(on_road, off, 0.0)


def cruising(
    before: Vehicles, after: Vehicles, slots: slice, body: BodyParams, road: RoadParams
) -> tuple[jax.Array, jax.Array]:
    """Like `driving`, but for the tick's distance at the desired speed, (C,) J each."""
    steady = before.replace(speed=before.desired_speed)
    seconds = (after.x - before.x)[slots] / before.desired_speed[slots]
    power, off = driving(steady, steady, slots, body, road, 1.0)
    return power * seconds, off * seconds


class _Change(NamedTuple):
    """Change of batteries in a tick, (C,) each."""

    gain: jax.Array  # J, apart from driving
    slack: jax.Array  # J, float32 error bound of the gain
    full: jax.Array  # bool
    empty: jax.Array  # bool


def _change(
    before_j: jax.Array, after_j: jax.Array, driven: tuple[jax.Array, jax.Array], capacity: Any
) -> _Change:
    gain = after_j - before_j + driven[0]
    slack = CAPACITY_RTOL * capacity + driven[1] + FLOW_RTOL * jnp.abs(gain)
    return _Change(gain, slack, after_j >= capacity, after_j <= 0.0)


def _received(change: _Change, most: jax.Array) -> EnergyBounds:
    """Energy that EVs' batteries received, (E,) each, at most `most`."""
    gain, slack, full, empty = change
    # A negative gain of a full battery is braking energy that found no room. An empty battery may have received energy
    # and spent it.
    kept = jnp.where(full, jnp.maximum(gain, 0.0), gain)
    low = jnp.where(empty & ~full, jnp.minimum(gain, 0.0), kept)
    high = jnp.where(empty & ~full, jnp.minimum(gain, most), kept)
    return EnergyBounds(low - slack, high + slack)


def _sent(change: _Change, most: jax.Array) -> EnergyBounds:
    """Energy that MEDs sent, (M,) each, at most `most`."""
    gain, slack, full, empty = change
    # A full MED may have lost braking energy that found no room. An empty MED drives on without energy.
    low = jnp.where(full, jnp.minimum(-gain, 0.0), -gain)
    high = jnp.where(empty, jnp.maximum(-gain, most), -gain)
    return EnergyBounds(low - slack, high + slack)


def _limited_driving(
    driven: tuple[jax.Array, jax.Array], lost: EnergyBounds, slack: jax.Array, less: Any, more: Any
) -> EnergyBounds:
    """Energy of driving by the formula (`driving`), limited to what batteries lost; (C,) J each.

    Where `less` (`more`) is set, driving may have taken less (more) than by the formula.
    """
    (value, off), low, high = driven, lost.low - slack, lost.high + slack
    least = jnp.clip(value - off, low, high - 2.0 * slack)
    most = jnp.clip(value + off, low + 2.0 * slack, high)
    return EnergyBounds(jnp.where(less, low, least), jnp.where(more, high, most))


def tick_flows(
    before: EnvState, after: EnvState, config: EnvConfig, params: EnvParams
) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
    """Energy flows of one tick, by name: flags of impossible flows, and the bounds (2,) J of each sum of flows."""
    old, new, dt = before.vehicles, after.vehicles, config.tick_s
    evs, was, link, road = after.evs, before.evs, params.link, params.road
    slot = params.charging.slot_power_w * dt
    # The EV's own coil has losses however strong the coupling is.
    best = link.load_ohm / (link.load_ohm + link.ev_resistance_ohm)
    charges = (was.med != NOT_BOOKED) & evs.served
    takes = jnp.where(charges, best * slot, 0.0)
    partner = charges[:, None] & (was.med[:, None] == jnp.arange(config.num_meds))
    gives = slot * jnp.sum(partner, axis=0)

    of_evs, (value, off) = jax.tree.map(
        lambda each: jnp.where(was.is_depleted, 0.0, each),  # without motor
        (
            driving(old, new, config.ev_slots, params.ev, road, dt),
            cruising(old, new, config.ev_slots, params.ev, road),
        ),
    )
    change = _change(was.energy_j, evs.energy_j, of_evs, params.ev_capacity_j)
    received, lost = _received(change, takes), was.energy_j - evs.energy_j
    # An EV that runs out spends only what it had. A full EV loses braking energy that finds no room.
    taken = _limited_driving(
        of_evs, EnergyBounds(lost, lost + takes), change.slack, change.empty, change.full
    )
    least = was.energy_j - params.ev_capacity_j
    steady = EnergyBounds(jnp.maximum(value - off, least), jnp.maximum(value + off, least))

    meds, capacity = before.meds, params.med_capacity_j
    of_meds = driving(old, new, config.med_slots, params.med, road, dt)
    change = _change(meds.energy_j, after.meds.energy_j, of_meds, capacity)
    sent, lost = _sent(change, gives), meds.energy_j - after.meds.energy_j
    # An empty MED drives on without energy. The tally counts the energy that it would have used.
    most = jnp.where(change.empty, jnp.maximum(of_meds[0], lost), lost)
    given = _limited_driving(
        of_meds, EnergyBounds(lost - gives, most), change.slack, False, change.full
    )
    above_reserve = meds.energy_j - params.fleet.reserve_soc * capacity
    arrived = jnp.sum(jnp.where(partner, received.low[:, None], 0.0), axis=0)

    def both(bounds: EnergyBounds, concerned: Any = True) -> jax.Array:
        return jnp.stack([total(jnp.where(concerned, bound, 0.0)) for bound in bounds])

    return {
        "EV loses": received.high < 0.0,
        "EV gains from nowhere": received.low > takes * (1.0 + FLOW_RTOL),
        "MED gains": sent.high < 0.0,
        "MED loses": sent.low > gives * (1.0 + FLOW_RTOL),
        "MED below its reserve": (gives > 0.0) & (sent.low > jnp.maximum(above_reserve, 0.0)),
        "more arrives than the link lets through": partner.any(axis=0)
        & (arrived > best * sent.high),
    }, {
        "energy_sent_j": both(sent, gives > 0.0),
        "energy_received_j": both(received, charges),
        "ev_driving_j": both(taken),
        "ev_cruising_j": both(steady),
        "med_driving_j": both(given),
    }

"""One physics tick: everyone looks, accelerates, changes lanes, moves, and energy flows."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.charging.booking import can_serve
from medjax.charging.docking import is_docked, misalignment, panel_lane, panel_x
from medjax.charging.exchange import coupling_efficiency, transfer
from medjax.numerics.gathers import read
from medjax.numerics.sums import count_down, in_units, rounded, sum_pairwise
from medjax.physics import battery_energy, change_battery, tractive_energy
from medjax.traffic.following import Drivers
from medjax.traffic.motion import turn_between
from medjax.traffic.step import move, partners
from medjax.world.params import BodyParams, EnvConfig, EnvParams
from medjax.world.state import (
    IN_SERVICE,
    MERGING,
    NOT_BOOKED,
    RETIRED,
    EnvState,
    EVs,
    MEDs,
    Tally,
    Vehicles,
)


def drive_energy(before: jax.Array, after: jax.Array, body: BodyParams, dt: float) -> jax.Array:
    """Energy that a tick of driving takes from the battery, J; eqs (7)-(8) and the drivetrain."""
    wheels = tractive_energy(
        before,
        after,
        dt,
        mass=body.mass_kg,
        drag_coefficient=body.drag_coefficient,
        frontal_area=body.frontal_area_m2,
        rolling_resistance=body.rolling_resistance,
        rotational_inertia_factor=body.rotational_inertia_factor,
    )
    return battery_energy(
        wheels,
        dt,
        drivetrain_efficiency=body.drivetrain_efficiency,
        regeneration_efficiency=body.regeneration_efficiency,
        auxiliary_power=body.auxiliary_w,
    )


def _driven(
    before: Vehicles, after: Vehicles, slots: slice, body: BodyParams, tick_s: float
) -> jax.Array:
    """Energy that driving takes from each battery in a tick, J; 0 off the road."""
    energy = drive_energy(before.speed[slots], after.speed[slots], body, tick_s)
    return jnp.where(before.active[slots], energy, 0.0)


def _links(
    after: Vehicles, evs: EVs, length: jax.Array, config: EnvConfig, params: EnvParams
) -> tuple[jax.Array, jax.Array]:
    """Whether each EV charges, and how efficient its coils are where they stand, `(E,)` each."""
    ev_slots, med_slots = config.ev_slots, config.med_slots
    med = partners(after, evs, length, config)
    with jax.named_scope("misalignment"):
        goal = panel_x(evs.panel, med, length[ev_slots], params.charging.dock_gap_m)
        error = after.x[ev_slots] - goal
        in_lane = after.lane[ev_slots] == panel_lane(evs.panel, med.lane)
        med_offset, med_lateral_speed = read(
            (after.lateral_offset[med_slots], after.lateral_speed[med_slots]),
            jnp.maximum(evs.med, 0),
        )
        across = after.lateral_offset[ev_slots] - med_offset
        turn = turn_between(
            med.speed, med_lateral_speed, after.speed[ev_slots], after.lateral_speed[ev_slots]
        )
        is_charging = (evs.med != NOT_BOOKED) & is_docked(
            error,
            after.speed[ev_slots] - med.speed,
            in_lane & (jnp.abs(across) < 0.25 * params.road.lane_width_m),
            evs.is_charging,
            params.charging,
        )
        seen = params.link.misalignment_scale
        geometry = misalignment(
            evs.panel,
            seen * error,
            seen * across,
            seen * turn,
            params.link.panel_gap_m,
        )
        return is_charging, coupling_efficiency(geometry, params.link)


def _exchange(
    before: Vehicles,
    after: Vehicles,
    state: EnvState,
    length: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> tuple[EVs, MEDs, Tally]:
    """Docking, transfer and driving energy of one tick."""
    evs, meds = state.evs, state.meds
    is_charging, efficiency = _links(after, evs, length, config, params)
    with jax.named_scope("energy"):
        med_use = _driven(before, after, config.med_slots, params.med, config.tick_s)
        ev_use = _driven(before, after, config.ev_slots, params.ev, config.tick_s)
        flow = transfer(
            efficiency,
            is_charging,
            evs.med,
            meds.energy_j - params.fleet.reserve_soc * params.med_capacity_j,
            params.ev_capacity_j - (evs.energy_j - ev_use),
            params.charging.slot_power_w * config.tick_s,
        )
        ev_energy, ev_rest = change_battery(
            evs.energy_j, evs.rest_j, flow.received_j - ev_use, params.ev_capacity_j
        )
        med_energy, med_rest = change_battery(
            meds.energy_j, meds.rest_j, -med_use - flow.drawn_j, params.med_capacity_j
        )

    first = is_charging & ~evs.served
    tally = Tally.zeros().replace(
        energy_sent_j=sum_pairwise(flow.sent_j),
        energy_received_j=sum_pairwise(flow.received_j),
        evs_served=jnp.sum(first, dtype=jnp.float32),
    )
    evs = evs.replace(
        energy_j=ev_energy,
        rest_j=ev_rest,
        is_charging=is_charging,
        served=evs.served | is_charging,
    )
    return evs, meds.replace(energy_j=med_energy, rest_j=med_rest), tally


def _release(vehicles: Vehicles, evs: EVs, meds: MEDs, config: EnvConfig, params: EnvParams) -> EVs:
    """Ends bookings: charged, gone, out of time, or the MED is gone or empty."""
    booked = evs.med != NOT_BOOKED
    partner = jnp.maximum(evs.med, 0)
    serves = can_serve(meds, params)
    timer = jnp.where(
        booked,
        jnp.where(evs.is_charging, 0.0, evs.timer_s + config.tick_s),
        count_down(evs.timer_s, config.tick_s),
    )
    late = booked & (timer > params.charging.patience_s)
    done = evs.energy_j >= params.charging.target_soc * params.ev_capacity_j
    ends = booked & (late | done | ~read(serves, partner) | ~vehicles.active[config.ev_slots])
    return evs.replace(
        med=jnp.where(ends, NOT_BOOKED, evs.med),
        panel=jnp.where(ends, NOT_BOOKED, evs.panel),
        is_charging=evs.is_charging & ~ends,
        timer_s=jnp.where(ends, jnp.where(late, params.charging.retry_s, 0.0), timer),
    )


def by_class(flags: jax.Array, config: EnvConfig) -> jax.Array:
    """Counts of `(N,)` flags over MEDs, EVs and gas vehicles, `(3,)` float32."""
    slices = (config.med_slots, config.ev_slots, config.gas_slots)
    return jnp.stack([jnp.sum(flags[s], dtype=jnp.float32) for s in slices])


def physics_tick(
    state: EnvState, drivers: Drivers, tick: jax.Array, config: EnvConfig, params: EnvParams
) -> tuple[EnvState, Tally]:
    """Advances one environment by `config.tick_s`.

    Args:
      state: of one environment.
      drivers: of its vehicles; they stay the same between two rounds of entries.
      tick: () int32, ticks since reset; its parity says which way drivers look.

    Returns:
      (state after the tick, what happened in it). `state.tally` is left as it was.
    """
    before = state.vehicles
    after, moved = move(state, drivers, tick, config, params)
    evs, meds, exchanged = _exchange(before, after, state, drivers.length, config, params)

    with jax.named_scope("exits"):
        left = before.active & (after.x > params.road.length_m)
        ran_out = jnp.zeros_like(left).at[config.ev_slots].set(evs.energy_j <= 0.0)
        depleted = before.active & ran_out & ~left
        active = before.active & ~left & ~depleted
        vehicles = after.replace(active=active)
        in_lane = after.lane[config.med_slots] == params.fleet.service_lane
        settled = jnp.abs(after.lateral_offset[config.med_slots]) < 1.0
        status = jnp.where((meds.status == MERGING) & in_lane & settled, IN_SERVICE, meds.status)
        gone = left[config.med_slots]
        meds = meds.replace(
            status=jnp.where(gone, RETIRED, status),
            ready_in_s=jnp.where(gone, params.fleet.turnaround_s, meds.ready_in_s),
        )
        evs = _release(vehicles, evs, meds, config, params)

    with jax.named_scope("tally"):
        soc = rounded(in_units(evs.energy_j, params.ev_capacity_j))
        travelled = jnp.where(before.active, after.x - before.x, 0.0)
        on_road = by_class(active, config)
        flow = Tally.zeros().replace(
            left=by_class(left, config),
            depleted=jnp.sum(depleted, dtype=jnp.float32),
            ev_seconds=on_road[1] * config.tick_s,
            ev_distance_m=sum_pairwise(travelled[config.ev_slots]),
            soc_seconds=sum_pairwise(jnp.where(active[config.ev_slots], soc, 0.0)) * config.tick_s,
            exit_soc=sum_pairwise(jnp.where(left[config.ev_slots], soc, 0.0)),
            gas_seconds=on_road[2] * config.tick_s,
            gas_distance_m=sum_pairwise(travelled[config.gas_slots]),
            vehicle_ticks=jnp.sum(on_road),
        )
        happened = moved + exchanged + flow
    state = state.replace(vehicles=vehicles, evs=evs, meds=meds)
    return state, happened

"""Plugs: the fast chargers at exits, first come first served.

An EV that leaves the road to charge takes the plug that becomes free first, which serves EVs in their order of arrival.
No later arrival changes its wait, so wait, charging time and energy are booked when it arrives, and what a site has to
remember is when each of its plugs becomes free (Kiefer and Wolfowitz 1955, Trans. AMS 78).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.numerics.sums import count_down, sum_pairwise
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState, EpisodeStats

Line = tuple[jax.Array, jax.Array, jax.Array]  # when plugs are free, who is in line, waits


def plug_seconds(energy_j: jax.Array, params: EnvParams) -> jax.Array:
    """Time at a plug from each charge `(E,)` J to `plug_target_soc`, `(E,)` s; 0 for those that have more.

    The power is `plug_power_w` up to `taper_soc` and falls linearly from there, to 0 at a full battery, as at a MED
    (`medjax.charging.exchange.taper`).
    """
    charging, capacity_j = params.charging, params.ev_capacity_j
    target_j = charging.plug_target_soc * capacity_j
    bend_j = jnp.minimum(charging.taper_soc * capacity_j, target_j)
    steady_j = jnp.maximum(bend_j - energy_j, 0.0)
    # Above the bend the power is in proportion to what the battery lacks of a full one.
    lacks_j = capacity_j - jnp.clip(energy_j, bend_j, target_j)
    slow_j = (capacity_j - bend_j) * jnp.log(lacks_j / (capacity_j - target_j))
    return (steady_j + slow_j) / charging.plug_power_w


def take_plugs(
    free_in_s: jax.Array, site: jax.Array, arrives: jax.Array, charging_s: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Gives each arriving EV the plug of its site that becomes free first; EVs that arrive together go by their index.

    Gradients do not pass through what it returns.

    Args:
      free_in_s: (num_exits, num_plugs) s, until each plug is free; 0 for a free one.
      site: (E,) int32, the exit of each EV.
      arrives: (E,) bool.
      charging_s: (E,) s, for which each EV will hold its plug.

    Returns:
      (free_in_s, wait of each EV `(E,)` s, 0 for those that do not arrive)
    """
    evs, sites = jnp.arange(site.shape[0], dtype=jnp.int32), jnp.arange(free_in_s.shape[0])
    nobody = site.shape[0]

    def serve(carry: Line) -> Line:
        """Serves the first EV in line at each site."""
        free, pending, wait_s = carry
        in_line = pending & (site == sites[:, None])
        first = jnp.min(jnp.where(in_line, evs, nobody), axis=1)
        plug = jnp.argmin(free, axis=1)
        added = jnp.where(first < nobody, charging_s[jnp.minimum(first, nobody - 1)], 0.0)
        wait_s = wait_s.at[first].set(free[sites, plug], mode="drop")
        return (
            free.at[sites, plug].add(added),
            pending.at[first].set(False, mode="drop"),
            wait_s,
        )

    # No gradient passes through waits, since a loop of unknown length has none in reverse mode.
    free_in_s, charging_s = jax.lax.stop_gradient((free_in_s, charging_s))
    carry = free_in_s, arrives, jnp.zeros_like(charging_s)
    free_in_s, _, wait_s = jax.lax.while_loop(lambda carry: carry[1].any(), serve, carry)
    return free_in_s, wait_s


def expected_waits(free_in_s: jax.Array, way_m: jax.Array, speed: jax.Array) -> jax.Array:
    """Waits at each site for an EV that drives there at a constant speed, if nobody else arrives before it.

    Args:
      free_in_s: (num_exits, num_plugs) s, until each plug is free.
      way_m: (num_exits, E) m, from each EV to each site; speed: () m/s.

    Returns:
      (num_exits, E) s.
    """
    first = jax.lax.stop_gradient(free_in_s).min(axis=1)
    return jnp.maximum(first[:, None] - way_m / speed, 0.0)


def charge_at_exits(
    state: EnvState, free_in_s: jax.Array, config: EnvConfig, params: EnvParams
) -> tuple[EnvState, EpisodeStats]:
    """Serves the EVs that left the road in a round to charge at an exit; they arrive at its end.

    An EV that has missed the last exit leaves at the road's end, where no plugs are simulated.

    Args:
      state: after the round's ticks.
      free_in_s: `state.plugs_free_in_s`, which is not None.

    Returns:
      (state after the round, statistics of waits, charging times and energy)
    """
    vehicles, evs, slots = state.vehicles, state.evs, config.ev_slots
    at_exit = ~vehicles.active[slots] & (vehicles.x[slots] <= params.road.length_m)
    arrives = evs.stops & at_exit & ~evs.is_depleted
    is_exit = vehicles.destination[slots, None] == params.road.exit_x_m
    site = jnp.argmax(is_exit, axis=1).astype(jnp.int32)
    charging_s = plug_seconds(evs.energy_j, params)
    free_in_s = count_down(free_in_s, config.round_s)
    free_in_s, wait_s = take_plugs(free_in_s, site, arrives, charging_s)
    target_j = params.charging.plug_target_soc * params.ev_capacity_j
    gained_j = jnp.maximum(target_j - evs.energy_j, 0.0)

    def total(values: jax.Array) -> jax.Array:
        return sum_pairwise(jnp.where(arrives, values, 0.0))

    stats = EpisodeStats.zeros().replace(
        plug_stops=jnp.sum(arrives, dtype=jnp.float32),
        plug_wait_s=total(wait_s),
        plug_charging_s=total(charging_s),
        plug_energy_j=total(gained_j),
    )
    evs = evs.replace(stops=evs.stops & ~arrives)
    return state.replace(plugs_free_in_s=free_in_s, evs=evs), stats

"""What the dispatcher sees: the paper's state space, structured and flat.

An observation is a value handed to ChargingEnv: anything with `size(config)` and
`__call__(state, config, params) -> (size,)`.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct

from medjax.charging.booking import panel_flags
from medjax.config import EnvConfig, EnvParams
from medjax.state import AT_DEPOT, IN_SERVICE, NOT_BOOKED, QUEUED, EnvState
from medjax.traffic.road import lateral_position

MED_FEATURES = 14
EV_FEATURES = 8
CLOCK_FEATURES = 4
# A cooldown may be 0, so it is scaled by a fixed time.
COOLDOWN_UNIT_S = 20.0


class Observation(struct.PyTreeNode):
    """The structured form; features in the paper's order, scaled to about [-1, 1]."""

    meds: jax.Array  # (M, 14): x, y, vx, vy, SoC, in service, booked x 4, charging x 4
    evs: jax.Array  # (E, 8): x, y, vx, vy, SoC, is human, is charging, target MED
    med_mask: jax.Array  # (M,) bool, on the road
    ev_mask: jax.Array  # (E,) bool, on the road
    clock: jax.Array  # (4,): time left, cooldown left, share at the depot, share waiting at a ramp


def observe(state: EnvState, config: EnvConfig, params: EnvParams) -> Observation:
    """The structured observation of one environment.

    Vehicles off the road are zero rows, but a MED keeps its state of charge: a full one off the road
    has not been sent yet. The target MED of an EV is (index + 1) / num_meds, 0 for none.
    """
    vehicles, evs, meds = state.vehicles, state.evs, state.meds
    width = config.num_lanes * params.road.lane_width_m
    cruise = params.drivers.desired_speed[-1]
    y = lateral_position(vehicles.lane, vehicles.lateral_offset, params.road.lane_width_m)
    motion = jnp.stack(
        [
            vehicles.x / params.road.length_m,
            y / width,
            vehicles.speed / cruise,
            vehicles.lateral_speed / params.road.lane_width_m,
        ],
        axis=-1,
    )
    motion = jnp.where(vehicles.active[:, None], motion, 0.0)
    booked = panel_flags(evs.med, evs.panel, evs.med != NOT_BOOKED, config.num_meds)
    charging = panel_flags(evs.med, evs.panel, evs.is_charging, config.num_meds)
    med_rows = jnp.concatenate(
        [
            motion[config.med_slots],
            (meds.energy_j / params.med_capacity_j)[:, None],
            (meds.status == IN_SERVICE)[:, None],
            booked,
            charging,
        ],
        axis=-1,
        dtype=jnp.float32,
    )
    own = jnp.stack(
        [
            evs.energy_j / params.ev_capacity_j,
            evs.is_human.astype(jnp.float32),
            evs.is_charging.astype(jnp.float32),
            (evs.med + 1) / config.num_meds,
        ],
        axis=-1,
    )
    on_road = vehicles.active[config.ev_slots]
    ev_rows = jnp.concatenate(
        [motion[config.ev_slots], jnp.where(on_road[:, None], own, 0.0)], axis=-1
    )
    clock = jnp.stack(
        [
            1.0 - state.time / params.episode_decisions,
            state.cooldown_s / COOLDOWN_UNIT_S,
            jnp.mean(meds.status == AT_DEPOT),
            jnp.mean(meds.status == QUEUED),
        ]
    )
    return Observation(
        meds=med_rows,
        evs=ev_rows,
        med_mask=vehicles.active[config.med_slots],
        ev_mask=on_road,
        clock=clock.astype(jnp.float32),
    )


@dataclasses.dataclass(frozen=True)
class FlatObservation:
    """MED rows, then EV rows, then (optionally) the clock, as one float32 vector."""

    include_clock: bool = True

    def size(self, config: EnvConfig) -> int:
        """Length of the vector."""
        return (
            MED_FEATURES * config.num_meds
            + EV_FEATURES * config.num_evs
            + CLOCK_FEATURES * self.include_clock
        )

    def __call__(self, state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
        """`(size,)` float32."""
        seen = observe(state, config, params)
        parts = [seen.meds.ravel(), seen.evs.ravel()]
        if self.include_clock:
            parts.append(seen.clock)
        return jnp.concatenate(parts).astype(jnp.float32)

"""The dispatcher's observation: the paper's state space, structured and flat.

ChargingEnv accepts any observation object with `size(config)` and
`__call__(state, config, params) -> (size,)`.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from medjax.charging.booking import charging_slot_flags
from medjax.env.depots import distinct_depots, shares_at_depots
from medjax.env.forecast import (
    Need,
    detected_flows,
    expected_need,
    free_slots,
    med_positions,
    num_detectors,
)
from medjax.errors import InputError, shown
from medjax.numerics.sums import scale_by
from medjax.traffic.road import lateral_position
from medjax.world.kinds import GAS, HUMAN_EV
from medjax.world.params import CHARGING_SLOTS, EnvConfig, EnvParams
from medjax.world.state import AT_DEPOT, IN_SERVICE, MERGING, NOT_BOOKED, QUEUED, EnvState

MED_FEATURES = 14
EV_FEATURES = 8
CLOCK_FEATURES = 4
# `fleet.cooldown_s` may be 0, so a fixed time scales the clock.
COOLDOWN_UNIT_S = 20.0
NEED_WINDOW_S = 60.0  # forecast window of the road profile
STEPS = 128.0  # quantisation of road-profile shares; float32 then sums a thousand vehicles' products exactly
FAR_KM = 2.0  # a MED farther away matters little to a ramp


class Observation(struct.PyTreeNode):
    """Structured observation with features in the paper's order.

    All features are in [0, 1] except y, speeds and the cooldown; docs/guide.md has their ranges.
    """

    meds: jax.Array  # (M, 14): x, y, vx, vy, SoC, in service, booked x 4, charging x 4
    evs: jax.Array  # (E, 8): x, y, vx, vy, SoC, is human, is charging, target MED
    med_mask: jax.Array  # (M,) bool, on the road
    ev_mask: jax.Array  # (E,) bool, on the road
    clock: jax.Array  # (4,): time left, cooldown left, shares of the fleet at the depot, at a ramp


def clock_features(state: EnvState, params: EnvParams) -> jax.Array:
    """`Observation.clock`, (4,) float32."""
    fleet, status = jnp.maximum(params.fleet.size, 1), state.meds.status
    clock = [
        scale_by(params.episode_decisions - state.time, params.episode_decisions),
        state.cooldown_s / COOLDOWN_UNIT_S,
        *(scale_by(jnp.sum(status == each, dtype=jnp.int32), fleet) for each in (AT_DEPOT, QUEUED)),
    ]
    return jnp.stack(clock).astype(jnp.float32)


def observe(state: EnvState, config: EnvConfig, params: EnvParams) -> Observation:
    """The structured observation of one environment.

    Rows of vehicles off the road are zero, except a MED's state of charge: a full MED off the road is at a depot or
    waits at a ramp. The target MED of an EV is (index + 1) / num_meds, 0 for none.
    """
    vehicles, evs, meds, lane_m = state.vehicles, state.evs, state.meds, params.road.lane_width_m
    width = config.num_lanes * lane_m
    cruise = params.drivers.desired_speed[GAS]
    y = lateral_position(vehicles.lane, vehicles.lateral_offset, lane_m)
    motion = [
        scale_by(vehicles.x, params.road.length_m),
        scale_by(y, width),
        scale_by(vehicles.speed, cruise),
        scale_by(vehicles.lateral_speed, lane_m),
    ]
    rows = jnp.where(vehicles.active[:, None], jnp.stack(motion, axis=-1), 0.0)
    # One write for both flags: 1 for a booked slot, 2 for one whose EV charges.
    taken = 1 + evs.is_charging.astype(jnp.int8)
    taken = charging_slot_flags(evs.med, evs.charging_slot, taken, config.num_meds)
    booked, charging = taken > 0, taken > 1
    soc, serves = scale_by(meds.energy_j, params.med_capacity_j), meds.status == IN_SERVICE
    of_meds = [rows[config.med_slots], soc[:, None], serves[:, None], booked, charging]
    med_rows = jnp.concatenate(of_meds, axis=-1, dtype=jnp.float32)
    of_evs = [
        scale_by(evs.energy_j, params.ev_capacity_j),
        (vehicles.kind[config.ev_slots] == HUMAN_EV).astype(jnp.float32),
        evs.is_charging.astype(jnp.float32),
        (evs.med + 1) / config.num_meds,
    ]
    on_road = vehicles.active[config.ev_slots]
    own = jnp.where(on_road[:, None], jnp.stack(of_evs, axis=-1), 0.0)
    return Observation(
        meds=med_rows,
        evs=jnp.concatenate([rows[config.ev_slots], own], axis=-1),
        med_mask=vehicles.active[config.med_slots],
        ev_mask=on_road,
        clock=clock_features(state, params),
    )


@dataclasses.dataclass(frozen=True)
class FlatObservation:
    """One float32 vector of MED rows, EV rows, what detectors show, and (optionally) the clock."""

    include_clock: bool = True

    def size(self, config: EnvConfig) -> int:
        """Length of the vector."""
        rows = MED_FEATURES * config.num_meds + EV_FEATURES * config.num_evs
        return rows + num_detectors(config) + CLOCK_FEATURES * self.include_clock

    def split(self, vector: jax.Array, config: EnvConfig) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Splits `(..., size)` into MEDs `(..., M, 14)`, EVs `(..., E, 8)`, and the rest: detectors and clock."""
        meds, evs = config.num_meds * MED_FEATURES, config.num_evs * EV_FEATURES
        first, second, rest = jnp.split(vector, [meds, meds + evs], axis=-1)
        first = first.reshape(*vector.shape[:-1], config.num_meds, MED_FEATURES)
        return first, second.reshape(*vector.shape[:-1], config.num_evs, EV_FEATURES), rest

    def __call__(self, state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
        """`(size,)` float32."""
        seen = observe(state, config, params)
        parts = [seen.meds.ravel(), seen.evs.ravel(), detected_flows(state)]
        if self.include_clock:
            parts.append(seen.clock)
        return jnp.concatenate(parts).astype(jnp.float32)


def hat_weights(values: jax.Array, num_nodes: int) -> jax.Array:
    """Linear interpolation weights of values in [0, 1] over evenly spaced nodes.

    Args:
      values: any shape; values outside [0, 1] are clipped.
      num_nodes: at least 2.

    Returns:
      `(*values.shape, num_nodes)`: at most two nonzero weights per value, which add up to 1.
    """
    position = jnp.clip(values, 0.0, 1.0)[..., None] * (num_nodes - 1)
    return jnp.maximum(1.0 - jnp.abs(position - jnp.arange(num_nodes, dtype=jnp.int32)), 0.0)


def show_need(need: Need) -> jax.Array:
    """Encodes `Need` as `(4 * num_ramps,)`: counts of EVs and slots are divided by the slots of one MED."""
    slots = len(CHARGING_SLOTS)
    return jnp.concatenate(
        [need.there / slots, need.shortfall, need.coming / slots, need.free / slots]
    )


def outlook_in(needs: jax.Array, clock: jax.Array) -> tuple[Need, jax.Array, jax.Array]:
    """Decodes `show_need` `(..., 4 * num_ramps)` and the clock `(..., 4)`; see `RoadProfile.outlook`."""
    there, shortfall, coming, free = jnp.split(needs, len(Need._fields), axis=-1)
    slots = len(CHARGING_SLOTS)
    time_left, _, at_depot, _ = jnp.moveaxis(clock, -1, 0)
    return Need(there * slots, shortfall, coming * slots, free * slots), at_depot, time_left


@dataclasses.dataclass(frozen=True)
class RoadProfile:
    """Counts of EVs (by charge) and MEDs at evenly spaced nodes along the road; no lanes, no speeds.

    It does not depend on the order of vehicles in their slots, and is smaller than the flat observation: 244 numbers
    instead of 534 on `paper`.


    Layout: the share of the fleet at each depot, if there are several; what the detector at each entry shows, thousand
    vehicles/h, if there are any. At each node, unbooked EVs by state of charge
    (`soc_nodes`), EVs booked, EVs charging; then MEDs queued (at their ramps) or merging, MEDs in service, their state
    of charge, their free slots. For each ramp, the distance in km to the next MED downstream and upstream, at most
    FAR_KM, then `Need` as `show_need` encodes it. Time left and the share at the depot, each over `clock_nodes`.
    The clock of `Observation`.

    No entry is negative. Shares are in [0, 1] and distances in [0, 2]. Counts of vehicles and slots are not scaled,
    because the pretrained policies learned from raw counts; docs/guide.md gives their range.
    """

    road_nodes: int = 17
    soc_nodes: int = 6
    clock_nodes: int = 6

    def size(self, config: EnvConfig) -> int:
        """Length of the vector."""
        nodes = self.road_nodes * (self.soc_nodes + 2 + 4) + 2 * self.clock_nodes
        nodes += distinct_depots(config) + num_detectors(config)
        return nodes + (2 + len(Need._fields)) * config.num_ramps + CLOCK_FEATURES

    def __call__(self, state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
        """`(size,)` float32."""
        vehicles, evs, meds = state.vehicles, state.evs, state.meds
        on_road = vehicles.active[config.ev_slots]
        free = (on_road & (evs.med == NOT_BOOKED) & ~evs.is_depleted)[:, None]
        charge = hat_weights(scale_by(evs.energy_j, params.ev_capacity_j), self.soc_nodes)
        booked = on_road & (evs.med != NOT_BOOKED)
        ev_columns = jnp.concatenate(
            [jnp.where(free, charge, 0.0), booked[:, None], evs.is_charging[:, None]], axis=1
        )
        ev_position = scale_by(vehicles.x[config.ev_slots], params.road.length_m)

        med_x = med_positions(state, config, params)
        serves = meds.status == IN_SERVICE
        med_columns = jnp.stack(
            [
                (meds.status == QUEUED) | (meds.status == MERGING),
                serves,
                jnp.where(serves, scale_by(meds.energy_j, params.med_capacity_j), 0.0),
                jnp.where(serves, free_slots(state, config), 0),
            ],
            axis=1,
        )
        med_position = scale_by(med_x, params.road.length_m)
        ahead_km = (med_x[:, None] - params.road.ramp_x_m) / 1000.0
        clock = clock_features(state, params)
        time_left, _, at_depot, _ = clock
        parts = [
            shares_at_depots(meds, config, params),
            detected_flows(state),
            self._at_nodes(ev_position, ev_columns),
            self._at_nodes(med_position, med_columns),
            jnp.min(jnp.where(ahead_km >= 0.0, ahead_km, FAR_KM), axis=0, initial=FAR_KM),
            jnp.min(jnp.where(ahead_km < 0.0, -ahead_km, FAR_KM), axis=0, initial=FAR_KM),
            show_need(expected_need(state, config, params, NEED_WINDOW_S)),
            hat_weights(time_left, self.clock_nodes),
            hat_weights(at_depot, self.clock_nodes),
            clock,
        ]
        return jnp.concatenate(parts).astype(jnp.float32)

    def outlook(self, vector: jax.Array, config: EnvConfig) -> tuple[Need, jax.Array, jax.Array]:
        """Reads `Need`, the share of the fleet at the depot, and the share of time left from `(..., size)`."""
        needs = self._before_clock(vector, len(Need._fields) * config.num_ramps)
        return outlook_in(needs, vector[..., -CLOCK_FEATURES:])

    def of_ramps(self, vector: jax.Array, config: EnvConfig) -> jax.Array:
        """Reads what the vector `(..., size)` tells of each ramp, `(..., num_ramps, 8 + num_ramps)`.

        These are the distances to the next MED downstream and upstream, `Need` as `show_need` encodes it, time left and
        the share of the fleet at the depot, and the ramp's number, one-hot.
        """
        ramps = config.num_ramps
        columns = self._before_clock(vector, (2 + len(Need._fields)) * ramps)
        own = jnp.moveaxis(columns.reshape(*vector.shape[:-1], -1, ramps), -2, -1)
        time_left, _, at_depot, _ = jnp.moveaxis(vector[..., -CLOCK_FEATURES:], -1, 0)
        shape = (*vector.shape[:-1], ramps)
        same = jnp.stack([time_left, at_depot], axis=-1)[..., None, :]
        return jnp.concatenate(
            [
                own,
                jnp.broadcast_to(same, (*shape, 2)),
                jnp.broadcast_to(jnp.eye(ramps, dtype=vector.dtype), (*shape, ramps)),
            ],
            axis=-1,
        )

    def _before_clock(self, vector: jax.Array, count: int) -> jax.Array:
        """The last `count` entries before those of the clock."""
        last = vector.shape[-1] - 2 * self.clock_nodes - CLOCK_FEATURES
        return vector[..., last - count : last]

    def _at_nodes(self, position: jax.Array, columns: jax.Array) -> jax.Array:
        """Sums columns `(n, c)` of vehicles at positions `(n,)` onto the road's nodes, `(road_nodes * c,)`."""
        # Sums of whole steps are exact, so the order in which a program adds them does not matter.
        shares = jnp.round(hat_weights(position, self.road_nodes) * STEPS)
        return (shares.T @ jnp.round(columns * STEPS)).ravel() / STEPS**2


OBSERVATIONS = {"flat": FlatObservation(), "profile": RoadProfile()}


def check_observation(given: Any, config: EnvConfig) -> None:
    """Raises InputError unless `given` is an observation with a valid size."""
    is_function = callable(given) and not isinstance(given, type)
    if not is_function or not callable(getattr(given, "size", None)):
        lacks = "its size(config) is missing, " if is_function else ""
        own = "one of your own with size(config) and __call__(state, config, params)"
        raise InputError(
            f"observation = {shown(given)}: {lacks}allowed {', '.join(OBSERVATIONS)}, or {own}"
        )
    size = given.size(config)
    if not isinstance(size, int | np.integer) or isinstance(size, bool) or size < 0:
        raise InputError(f"size(config) of the observation is {shown(size)}: allowed an integer")


def of_shape(seen: Any, shape: tuple[int, ...]) -> jax.Array:
    """Returns `seen`; raises InputError unless it has the declared shape and is float32."""
    got, dtype = getattr(seen, "shape", None), str(getattr(seen, "dtype", None))
    if (got, dtype) != (shape, "float32"):
        kind = shown(seen) if got is None else f"shape {got} and type {dtype}"
        allowed = f"{shape} and float32, as its size(config) declares"
        raise InputError(f"the observation returns {kind}: allowed {allowed}")
    return seen

"""Observation of an agent: itself, nearby vehicles in its own frame, its next request, and the expected need."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from medjax.charging.booking import grant, requests_and_offers
from medjax.env.depots import distinct_depots, next_to_be_sent, shares_at_depots
from medjax.env.forecast import (
    Need,
    detected_flows,
    expected_need,
    free_slots,
    lacking_j,
    med_positions,
    num_detectors,
)
from medjax.env.observation import (
    CLOCK_FEATURES,
    NEED_WINDOW_S,
    RoadProfile,
    clock_features,
    outlook_in,
    show_need,
)
from medjax.numerics.sums import scale_by
from medjax.traffic.exits import next_exit
from medjax.world.params import CHARGING_SLOTS, EnvConfig, EnvParams
from medjax.world.state import IN_SERVICE, MERGING, NOT_BOOKED, QUEUED, STATUS_NAMES, EnvState

VIEW_M = 500.0  # a distance of 1
SPEED_UNIT = 30.0  # m/s, a speed of 1
UNSEEN_M = 1.0e9  # distance of what a MED does not see
OF_ITSELF = len(STATUS_NAMES) + 11
OF_AN_EV = 10
OF_A_REQUEST = 6
OF_A_MED = 5
OF_A_RAMP = len(Need._fields)


@dataclasses.dataclass(frozen=True)
class AgentView:
    """Observation of each agent, a float32 vector that does not depend on the order of slots.

    - Itself: status one-hot; position as a share of the road, speed, charge, lane, lanes to its service lane, service
      speed; whether it takes EVs; free slots; distance to the next exit and to its own; whether it is first at its
      depot; with several depots, its depot one-hot.
    - The `num_evs` nearest EVs: present, distance, relative speed, lanes to it, charge, packs that it lacks to its
      destination, whether it requests a slot now, is booked on this MED, is booked on another, is charging.
    - The EV that booking would grant it now: the first six of these.
    - The next MED ahead and the next behind: present, distance, relative speed, whether in service, free slots.
    - With several depots, the share of the fleet at each. For each ramp, what a MED from there would meet
      (`medjax.env.forecast.Need`), and the clock of `medjax.env.observation.Observation`.

    Distances to others are in units of 500 m, at most 1, and those to exits are shares of the road; speeds in 30 m/s;
    slots and EVs in the number of slots of a MED. An agent sees others only on the road or in the queue at a ramp.

    Attributes:
      num_evs: number of EVs in view, at most.
      road: profile of the whole road, appended at the end for a critic.
    """

    num_evs: int = 8
    road: RoadProfile | None = None

    def size(self, config: EnvConfig) -> int:
        """Length of an agent's vector."""
        return self.own_size(config) + (self.road.size(config) if self.road else 0)

    def own_size(self, config: EnvConfig) -> int:
        """Number of leading entries that the agent may act on."""
        of_evs = min(self.num_evs, config.num_evs) * OF_AN_EV + OF_A_REQUEST
        of_meds = OF_ITSELF + 2 * OF_A_MED + 2 * distinct_depots(config) + num_detectors(config)
        return of_evs + of_meds + OF_A_RAMP * config.num_ramps + CLOCK_FEATURES

    def outlook(self, vector: jax.Array, config: EnvConfig) -> tuple[Need, jax.Array, jax.Array]:
        """Reads from vectors `(..., size)` each ramp's need, the share at the depot, and the share of time left."""
        last = self.own_size(config)
        clock = last - CLOCK_FEATURES
        needs = vector[..., clock - OF_A_RAMP * config.num_ramps : clock]
        return outlook_in(needs, vector[..., clock:last])

    def __call__(self, state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
        """Observations, `(num_meds, size)` float32."""
        evs = _evs(state, config, params)
        offset = jnp.where(
            _on_road(state, config)[:, None],
            _signed_distances(state, config, params, evs[:, 0]),
            UNSEEN_M,
        )
        there = state.vehicles.active[config.ev_slots] & ~state.evs.is_depleted
        offset = jnp.where(there, offset, UNSEEN_M)
        _, nearest = jax.lax.top_k(-jnp.abs(offset), min(self.num_evs, config.num_evs))
        request = requests(state, config, params)
        everyone = jax.vmap(_seen, (0, 0, 0, 0, None))
        own = jnp.arange(config.num_meds, dtype=jnp.int32)
        frame = jnp.stack([_speeds(state, config), _lanes(state, config), own], axis=1)
        around = everyone(frame, offset, nearest, jnp.ones_like(nearest, bool), evs)
        asked = jnp.maximum(request, 0)[:, None]
        wanted = everyone(frame, offset, asked, request[:, None] >= 0, evs)
        need = expected_need(state, config, params, NEED_WINDOW_S)
        depots = shares_at_depots(state.meds, config, params)
        known = [depots, detected_flows(state), show_need(need), clock_features(state, params)]
        of_all = jnp.concatenate(known)
        if self.road:
            of_all = jnp.concatenate([of_all, self.road(state, config, params)])
        parts = [
            _itself(state, config, params),
            around.reshape(config.num_meds, -1),
            wanted[:, 0, :OF_A_REQUEST],
            _other_meds(state, config, params),
            jnp.broadcast_to(of_all, (config.num_meds, of_all.shape[0])),
        ]
        return jnp.concatenate(parts, axis=1).astype(jnp.float32)


def _on_road(state: EnvState, config: EnvConfig) -> jax.Array:
    """MEDs that see others, `(A,)` bool: on the road, or in the queue at a ramp."""
    return state.vehicles.active[config.med_slots] | (state.meds.status == QUEUED)


def _speeds(state: EnvState, config: EnvConfig) -> jax.Array:
    """Speeds of MEDs, `(A,)` m/s; 0 off the road, where slots keep the values of the last trip."""
    vehicles, slots = state.vehicles, config.med_slots
    return jnp.where(vehicles.active[slots], vehicles.speed[slots], 0.0)


def _lanes(state: EnvState, config: EnvConfig) -> jax.Array:
    """Lanes of MEDs, `(A,)`; 0 off the road, as in `_speeds`."""
    vehicles, slots = state.vehicles, config.med_slots
    return jnp.where(vehicles.active[slots], vehicles.lane[slots], 0).astype(jnp.float32)


def _columns(columns: list[Any]) -> jax.Array:
    """Stacks columns `(n,)` of any type into `(n, c)` float32."""
    return jnp.stack([jnp.asarray(column, jnp.float32) for column in columns], axis=1)


def _signed_distances(
    state: EnvState, config: EnvConfig, params: EnvParams, x: jax.Array
) -> jax.Array:
    """Signed distance from each MED to the positions `(n,)` m, positive ahead, `(A, n)` m."""
    return x[None, :] - med_positions(state, config, params)[:, None]


def _evs(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Absolute features of EVs, `(E, 8)`: x, speed, lane, charge, lacked packs, requests a slot, MED, charging."""
    vehicles, evs, slots = state.vehicles, state.evs, config.ev_slots
    requests, _ = requests_and_offers(state, config, params)
    lacks_j = jnp.maximum(lacking_j(state, config, params), 0.0)
    return _columns(
        [
            *(column[slots] for column in (vehicles.x, vehicles.speed, vehicles.lane)),
            *(scale_by(energy_j, params.ev_capacity_j) for energy_j in (evs.energy_j, lacks_j)),
            *(requests.wants, evs.med, evs.is_charging),
        ]
    )


def _seen(
    frame: jax.Array, offset: jax.Array, which: jax.Array, there: jax.Array, evs: jax.Array
) -> jax.Array:
    """Selected EVs in the frame of a MED, `(k, OF_AN_EV)`; zeros where there is none.

    `frame` is the MED's speed, lane and index; `offset` the signed distance to each EV, UNSEEN_M if it does not see
    it; `which, there` `(k,)` are indices of EVs, and whether each exists; `evs` are from `_evs`.
    """
    speed, lane, own = frame
    rows, offset = evs[which], offset[which]
    there &= jnp.abs(offset) < UNSEEN_M
    booked = rows[:, 6] != NOT_BOOKED
    mine = rows[:, 6] == own
    columns = [
        jnp.ones_like(offset),
        jnp.clip(offset / VIEW_M, -1.0, 1.0),
        (rows[:, 1] - speed) / SPEED_UNIT,
        rows[:, 2] - lane,
        rows[:, 3],
        rows[:, 4],
        rows[:, 5],
        mine,
        booked & ~mine,
        rows[:, 7],
    ]
    return jnp.where(there[:, None], jnp.stack(columns, axis=1), 0.0)


def requests(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """The EV that booking would grant each MED now if it took EVs, `(A,)` int32; -1 if there is none."""
    willing = state.replace(meds=state.meds.replace(accepts=jnp.ones_like(state.meds.accepts)))
    requests, offers = requests_and_offers(willing, config, params)
    med = state.evs.med
    granted, _ = grant(med, state.evs.charging_slot, requests, offers, params.charging)
    new = (granted != med)[:, None] & (granted[:, None] == jnp.arange(config.num_meds))
    return jnp.where(new.any(axis=0), jnp.argmax(new, axis=0).astype(jnp.int32), -1)


def _itself(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Features of each agent itself, `(A, OF_ITSELF)`, plus a column per depot if there are several."""
    vehicles, meds, road, slots = state.vehicles, state.meds, params.road, config.med_slots
    status, drives = meds.status, vehicles.active[slots]
    x = med_positions(state, config, params)
    lane = _lanes(state, config)
    columns = [
        *(status == number for number in range(len(STATUS_NAMES))),
        jnp.where(_on_road(state, config), scale_by(x, road.length_m), 0.0),
        _speeds(state, config) / SPEED_UNIT,
        scale_by(meds.energy_j, params.med_capacity_j),
        lane / config.num_lanes,
        jnp.where(drives, meds.service_lane - lane, 0.0),
        meds.service_speed / SPEED_UNIT,
        meds.accepts,
        free_slots(state, config) / len(CHARGING_SLOTS),
        jnp.where(drives, jnp.minimum((next_exit(x, road) - x) / road.length_m, 1.0), 0.0),
        jnp.where(drives, (vehicles.destination[slots] - x) / road.length_m, 0.0),
        next_to_be_sent(meds),
        *(meds.depot == depot for depot in range(distinct_depots(config))),
    ]
    return _columns(columns)


def _other_meds(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Features of the next MED ahead and the next behind, `(A, 2 * OF_A_MED)`."""
    status, speed = state.meds.status, _speeds(state, config)
    serves = status == IN_SERVICE
    there = serves | (status == MERGING) | (status == QUEUED)
    offset = _signed_distances(state, config, params, med_positions(state, config, params))
    apart = ~jnp.eye(config.num_meds, dtype=bool)
    sees = there[None, :] & apart & _on_road(state, config)[:, None]
    free = free_slots(state, config) / len(CHARGING_SLOTS)
    found = []
    for side in (sees & (offset >= 0.0), sees & (offset < 0.0)):
        distance = jnp.where(side, jnp.abs(offset), UNSEEN_M)
        which = jnp.argmin(distance, axis=1).astype(jnp.int32)
        nearest = jnp.min(distance, axis=1)
        columns = [
            jnp.ones_like(nearest),
            jnp.minimum(nearest / VIEW_M, 1.0),
            (speed[which] - speed) / SPEED_UNIT,
            serves[which],
            free[which],
        ]
        found.append(jnp.where(side.any(axis=1)[:, None], _columns(columns), 0.0))
    return jnp.concatenate(found, axis=1)

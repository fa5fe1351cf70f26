"""Scenes on the whole simulator, and checks of what happened on them in float64 NumPy."""

import jax
import jax.numpy as jnp
import numpy as np

from medjax.env.tick import physics_tick
from medjax.traffic.step import drivers_of
from tests.traffic.reference import idm_plus

KIND_FIELDS = ("time_headway", "min_gap", "max_acceleration")
KIND_FIELDS += ("comfortable_deceleration", "vehicle_length")
# Urgency of a MED's change to its service lane, and of an EV's to its slot.
ORDERED, PRESSING = 0.303, 0.65


def put(state, slots, x, lane, speed, desired):
    """The state with only these vehicles on the road, full of energy and without noise."""
    slots = jnp.asarray(slots)

    def column(old, values):
        return old.at[slots].set(jnp.asarray(values, old.dtype))

    vehicles = state.vehicles
    still = jnp.zeros_like(vehicles.x)
    vehicles = vehicles.replace(
        active=column(jnp.zeros_like(vehicles.active), True),
        x=column(vehicles.x, x),
        lane=column(vehicles.lane, lane),
        speed=column(vehicles.speed, speed),
        desired_speed=column(vehicles.desired_speed, desired),
        lateral_offset=still,
        acceleration_noise=still,
        wander=still,
    )
    energy = jnp.full_like(state.evs.energy_j, 1e8)
    return state.replace(vehicles=vehicles, evs=state.evs.replace(energy_j=energy))


def run(config, ticks):
    """Jitted: (state, params, first tick) -> states (ticks + 1, ...), the start included."""

    @jax.jit
    def play(state, params, first=0):
        drivers = drivers_of(state, config, params)

        def tick(state, index):
            return physics_tick(state, drivers, index, config, params)[0], state

        last, before = jax.lax.scan(tick, state, first + jnp.arange(ticks, dtype=jnp.int32))
        return jax.tree.map(lambda many, one: jnp.concatenate([many, one[None]]), before, last)

    return play


def records_of(states, config, params):
    """One Record a road of states (roads, ticks, ...)."""
    roads = range(len(states.time))
    return [Record(jax.tree.map(lambda a, i=i: a[i], states), config, params) for i in roads]


class Record:
    """What a run looked like, (T, N) NumPy arrays; each vehicle with its own parameters."""

    def __init__(self, states, config, params):
        vehicles = jax.tree.map(np.asarray, states.vehicles)
        self.x, self.speed = vehicles.x.astype(np.float64), vehicles.speed.astype(np.float64)
        self.lane, self.active = vehicles.lane, vehicles.active
        self.desired_speed = vehicles.desired_speed
        kind = vehicles.kind
        self.kinds = {name: np.asarray(getattr(params.drivers, name))[kind] for name in KIND_FIELDS}
        self.length = self.kinds["vehicle_length"]
        self.num_lanes, self.is_med = config.num_lanes, np.arange(kind.shape[1]) < config.num_meds
        self.depleted = np.zeros(self.x.shape, bool)
        self.depleted[:, config.ev_slots] = states.evs.is_depleted
        road, change, charging = params.road, params.lane_change, params.charging
        self.lane_ends = np.asarray(road.ramp_x_m, np.float64) + float(road.acceleration_lane_m)
        self.view_m, self.safe_braking = float(change.view_m), float(change.safe_braking)
        self.accepted_headway = float(change.accepted_headway)
        self.platoon = {
            "time_headway": float(charging.platoon_headway),
            "min_gap": float(charging.platoon_min_gap),
        }
        self.med = np.full(self.x.shape, -1)
        self.med[:, config.med_slots] = np.arange(config.num_meds)
        self.med[:, config.ev_slots] = states.evs.med

    def gaps(self):
        """(T, N) gap behind the next vehicle of the own lane, inf for the foremost; by sorting."""
        lane = np.where(self.active, self.lane, 99)
        order = np.lexsort((self.x, lane), axis=1)
        x, length, lane = (
            np.take_along_axis(values, order, axis=1) for values in (self.x, self.length, lane)
        )
        behind = (lane[:, 1:] == lane[:, :-1]) & (lane[:, 1:] < 99)
        gaps = np.full(self.x.shape, np.inf)
        gaps[:, :-1] = np.where(behind, x[:, 1:] - length[:, 1:] - x[:, :-1], np.inf)
        back = np.empty_like(gaps)
        np.put_along_axis(back, order, gaps, axis=1)
        return back

    def changes(self):
        """(tick, slot) pairs that changed lanes in that tick."""
        moved = self.active[:-1] & self.active[1:] & (self.lane[1:] != self.lane[:-1])
        return np.argwhere(moved)

    def braking(self, tick, follower, leader, share):
        """IDM+ acceleration of one slot behind another, and the gap.

        The headway is its own less this share of the way to the shortest accepted one; a platoon's within one.
        """
        together = self.med[tick, follower] == self.med[tick, leader] != -1
        values = {name: column[tick, follower] for name, column in self.kinds.items()}
        values["desired_speed"] = self.desired_speed[tick, follower]
        usual = values["time_headway"]
        values["time_headway"] = usual + (min(self.accepted_headway, usual) - usual) * share
        values |= self.platoon if together else {}
        gap = self.x[tick, leader] - self.length[tick, leader] - self.x[tick, follower]
        speeds = self.speed[tick, follower], self.speed[tick, leader]
        return idm_plus(values, max(gap, 0.1), *speeds), gap

    def desires(self, tick, slot):
        """How urgent a change may have been: 0 for a free one, the most for an ordered one."""
        if self.lane[tick, slot] == self.num_lanes:
            ends = self.lane_ends[self.lane_ends >= self.x[tick, slot] - 1.0]
            return [np.clip(1.0 - (ends.min() - self.x[tick, slot]) / self.view_m, ORDERED, 1.0)]
        if self.depleted[tick, slot]:
            return [1.0]
        if self.med[tick, slot] < 0:
            return [0.0]
        return [0.0, ORDERED if self.is_med[slot] else PRESSING]

    def next_to(self, tick, slot):
        """(leader, follower) in the lane that a slot changed to, before the tick; None if nobody."""
        x = self.x[tick]
        there = np.flatnonzero(self.active[tick] & (self.lane[tick] == self.lane[tick + 1, slot]))
        ahead = min(there[x[there] >= x[slot]], key=lambda s: x[s], default=None)
        return ahead, max(there[x[there] < x[slot]], key=lambda s: x[s], default=None)

    def least_to_spare(self):
        """(m/s^2, m): how much of the braking and of the standing gap that a change may ask is left, at least.

        Of the changing vehicle and of the one then behind, each by its own parameters. A more urgent change may ask
        more braking and take less headway and standing gap. Where the one ahead must come, the headway is shorter, too.
        """
        braking, room = np.inf, np.inf
        for tick, slot in self.changes():
            leader, follower = self.next_to(tick, slot)
            spare = []
            for desire in self.desires(tick, slot):
                pairs = []
                if leader is not None:
                    pairs += [(slot, leader, max(desire, *self.desires(tick, leader), 0.0))]
                pairs += [(follower, slot, desire)] if follower is not None else []
                left, gaps = [np.inf], [np.inf]
                for behind, ahead, share in pairs:
                    acceleration, gap = self.braking(tick, behind, ahead, share)
                    left.append(acceleration + self.safe_braking * (desire or 1.0))
                    gaps.append(gap - self.kinds["min_gap"][tick, behind] * (1.0 - 0.5 * desire))
                spare.append((min(left), min(gaps)))
            best = max(spare, key=min)
            braking, room = min(braking, best[0]), min(room, best[1])
        return braking, room

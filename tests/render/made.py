"""Recordings made by hand: vehicles at known places, or a full and restless highway."""

import dataclasses

import jax
import numpy as np

import medjax
from medjax.episodes.recording import Decisions, Frames, Recording
from medjax.episodes.verdict import NAMES
from medjax.world.kinds import AUTONOMOUS_EV, GAS, MED
from medjax.world.state import AT_DEPOT, IN_SERVICE, EpisodeStats

TICKS = 4


def blank(frames, **overrides):
    """An episode of an empty road; `frames` is 1 + a multiple of TICKS."""
    env, params = medjax.make("paper", **overrides)
    config, decisions = env.config, (frames - 1) // TICKS
    v, e, m, g = config.num_vehicles, config.num_evs, config.num_meds, config.num_gas
    shapes = {
        "x": (v, np.float32), "speed": (v, np.float32), "lane": (v, np.int32),
        "lateral_offset": (v, np.float32), "lateral_speed": (v, np.float32), "active": (v, bool),
        "ev_soc": (e, np.float32), "kind": (v, np.int32), "ev_med": (e, np.int32),
        "ev_charging_slot": (e, np.int32), "ev_is_charging": (e, bool), "med_soc": (m, np.float32),
        "med_status": (m, np.int32), "med_depot": (m, np.int32), "med_service_speed": (m, np.float32),
        "med_service_lane": (m, np.int32), "med_accepts": (m, bool), "gas_is_broken_down": (g, bool),
    }  # fmt: skip
    arrays = {name: np.zeros((frames, size), kind) for name, (size, kind) in shapes.items()}
    arrays["kind"][:] = config.by_slot(MED, AUTONOMOUS_EV, GAS)
    arrays["ev_med"][:] = arrays["ev_charging_slot"][:] = -1
    arrays["med_status"][:] = AT_DEPOT
    mask = np.ones((decisions, env.num_actions), bool)
    zeros = np.zeros(decisions, np.float32)
    stats = jax.tree.map(
        lambda leaf: np.zeros((decisions, *np.shape(leaf)), np.float32), EpisodeStats.zeros()
    )
    decided = Decisions(
        action=np.zeros(decisions, np.int32),
        sent=np.zeros(decisions, np.int32),
        mask=mask,
        probabilities=np.eye(env.num_actions, dtype=np.float32)[np.zeros(decisions, int)],
        reward=zeros,
        reward_terms=dict.fromkeys(params.reward_weights, zeros),
        stats=stats,
        queue=np.zeros((decisions, config.num_entries), np.int32),
        cooldown_s=zeros,
    )
    return Recording(
        scenario="paper",
        policy="made",
        seed=0,
        episode=0,
        config=config,
        params=jax.device_get(params),
        frames=Frames(**arrays),
        decisions=decided,
        ticks_per_decision=TICKS,
    )


def put(recording, slot, x, lane, speed=0.0, frames=slice(None)):
    """Sets a vehicle on the road that drives at a speed, m/s, from x, m."""
    there = recording.frames
    time = recording.time_s[frames]
    there.active[frames, slot] = True
    there.lane[frames, slot] = lane
    there.speed[frames, slot] = speed
    there.x[frames, slot] = x + speed * (time - time[0])


def parked(**overrides):
    """A MED at 1000 m in lane 2 that charges an EV at its left, is booked by a far one, and gas behind it."""
    recording = blank(1 + 2 * TICKS, **overrides)
    config, frames = recording.config, recording.frames
    put(recording, 0, 1000.0, 2)
    frames.med_status[:, 0], frames.med_soc[:, 0] = IN_SERVICE, 0.75
    for ev, (x, lane, soc, charging_slot) in enumerate([(996.5, 1, 0.5, 0), (940.0, 2, 0.25, 2)]):
        put(recording, config.ev_slots.start + ev, x, lane)
        frames.ev_soc[:, ev], frames.ev_med[:, ev], frames.ev_charging_slot[:, ev] = (
            soc,
            0,
            charging_slot,
        )
    frames.ev_is_charging[:, 0] = True
    put(recording, config.gas_slots.start, 960.0, 3)
    return recording


def busy(decisions=600):
    """A highway with every slot taken, and more movement to store than any real episode has."""
    recording = blank(1 + TICKS * decisions)
    frames, config = recording.frames, recording.config
    random = np.random.default_rng(0)
    count, slots = frames.x.shape
    tick = config.tick_s
    noise = np.repeat(random.normal(0.0, 0.3, (count // TICKS + 1, slots)), TICKS, 0)[:count]
    frames.speed[:] = np.clip(25.0 + np.cumsum(noise * tick, 0), 5.0, 40.0)
    frames.x[:] = (random.uniform(0.0, 4000.0, slots) + np.cumsum(frames.speed * tick, 0)) % 4000.0
    frames.active[:] = True
    frames.active[1:] = np.diff(frames.x, axis=0) > 0.0  # one leaves, the next one enters
    frames.lane[:] = random.integers(0, config.num_lanes, slots)
    frames.lateral_offset[:] = np.cumsum(random.normal(0.0, 0.02, (count, slots)), 0) % 1.0
    frames.ev_soc[:] = 0.5 + 0.4 * np.sin(np.arange(count)[:, None] / random.uniform(50, 90, 40))
    frames.ev_med[:] = random.integers(-1, config.num_meds, (count // 40 + 1, 40)).repeat(40, 0)[
        :count
    ]
    frames.ev_charging_slot[:] = np.where(frames.ev_med < 0, -1, 1)
    frames.ev_is_charging[:] = frames.ev_med > 5
    frames.med_soc[:] = np.linspace(1.0, 0.2, count)[:, None]
    frames.med_status[:] = IN_SERVICE
    chances = random.dirichlet(np.ones(config.num_actions), decisions)
    decided = recording.decisions.replace(
        probabilities=chances,
        reward=random.normal(size=decisions),
        reward_terms={
            name: random.normal(size=decisions) for name in recording.decisions.reward_terms
        },
        queue=random.integers(0, 5, (decisions, config.num_entries)),
    )
    return dataclasses.replace(recording, decisions=decided)


def evaluated(recording, episodes=1000):
    """What `train.evaluate --json` would write of a recording's policy."""
    entry = dict.fromkeys(NAMES, 1.5)
    policies = {recording.policy: {**entry, "return_mean": 7.25, "return_ci95": [3.0, 11.5]}}
    return {"scenario": recording.scenario, "episodes": episodes, "policies": policies}

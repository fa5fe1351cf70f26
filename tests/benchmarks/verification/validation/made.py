"""Trajectories made by hand, and random ones for brute force."""

import numpy as np

from benchmarks.verification.validation.trajectories import Road, Trajectories

TICK_S = 0.25
ROAD = Road(
    4000.0, num_lanes=3, lane_width_m=4.0, ramp_x_m=(500.0, 2500.0), acceleration_lane_m=250.0
)


def drive(lanes, speeds, x=0.0, first_tick=0):
    """A vehicle in these lanes at these speeds, one per tick, or at one speed; it starts at x."""
    lanes = np.asarray(lanes)
    speeds = np.broadcast_to(np.asarray(speeds, float), lanes.shape)
    way = np.r_[0.0, np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * TICK_S)][: len(lanes)]
    return first_tick + np.arange(len(lanes)), lanes, x + way, speeds


def seen(*drives, num_ticks=None):
    """Trajectories of vehicles as `drive` gives them."""
    count = [len(drive[0]) for drive in drives]
    tick, lane, x, speed = (np.concatenate(column) for column in zip(*drives, strict=True))
    return Trajectories(
        road=ROAD,
        tick_s=TICK_S,
        num_ticks=int(tick.max()) + 1 if num_ticks is None else num_ticks,
        tick=tick.astype(np.int32),
        vehicle=np.repeat(np.arange(len(drives)), count).astype(np.int32),
        lane=lane.astype(np.int32),
        x=x,
        speed=speed,
        length=np.full(len(x), 5.0),
        width=np.full(len(x), 1.8),
        lateral=None,
    )


def random_traffic(seed, vehicles=40, ticks=30):
    """Vehicles anywhere in any lane at any speed, jumping between lanes: no traffic, but rows."""
    rng = np.random.default_rng(seed)
    drives = []
    for _ in range(vehicles):
        span = rng.integers(2, ticks)
        lanes = rng.integers(0, ROAD.num_lanes + 1, span)
        speeds = rng.uniform(0.0, 30.0, span)
        drives.append(drive(lanes, speeds, rng.uniform(0, 3800), rng.integers(0, ticks - span)))
    return seen(*drives, num_ticks=ticks)

"""Test inputs and exact references for `benchmarks.speed.kernels`.

No reference shares code with the kernel that it checks.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from medjax.scenarios import CoilDesign
from medjax.traffic.neighbours import NOBODY, Neighbours
from medjax.traffic.road import NO_LANE
from medjax.world.params import EnvConfig, LinkParams

COILS = CoilDesign()  # the design in the preset's table
CHECKED_ROADS = 8
STRADDLING = 0.1  # share of vehicles that straddle a lane line


def neumann(axial: float, lateral: float, tilt: float, num_nodes: int = 256) -> tuple[float, float]:
    """Mutual inductance of `COILS` by Neumann's double integral, in float64, with the trapezoid rule around both rims.

    It is exact to 1e-9 at 0.03 m between the wires and to rounding at 0.05 m.

    Args:
      axial, lateral: m, by the convention of `mutual_inductance`.
      tilt: rad, by the same convention.
      num_nodes: of each rim.

    Returns:
      (M in H, shortest distance between the wires in m).
    """
    radius_1, radius_2 = COILS.med_coil_radius_m, COILS.ev_coil_radius_m
    phi = np.arange(num_nodes) * (2 * np.pi / num_nodes)
    cos_1, sin_1 = np.cos(phi)[:, None], np.sin(phi)[:, None]
    cos_2, sin_2 = np.cos(phi), np.sin(phi)
    along = lateral + radius_2 * cos_2 * np.cos(tilt) - radius_1 * cos_1
    across = radius_2 * sin_2 - radius_1 * sin_1
    height = axial + radius_2 * cos_2 * np.sin(tilt)
    distance = np.sqrt(along**2 + across**2 + height**2)
    # Dot product of the wires' unit tangents.
    product = sin_1 * sin_2 * np.cos(tilt) + cos_1 * cos_2
    turns = COILS.med_coil_turns * COILS.ev_coil_turns
    element = radius_1 * radius_2 * (2 * np.pi / num_nodes) ** 2
    return float(1e-7 * turns * element * np.sum(product / distance)), float(np.min(distance))


def draw_positions(link: LinkParams, count: int) -> np.ndarray:
    """Axial and lateral distance (m) and tilt (rad), `(3, count)` float32, within the table's limits.

    Half of the draws come from the nearest quarter of the axial range, where M changes most.
    """
    table = link.inductance
    num_axial, num_lateral, _ = table.values.shape
    nearest = float(jnp.exp(table.log_axial_origin))
    farthest = nearest * float(jnp.exp(table.log_axial_step * (num_axial - 1)))
    widest = float(table.lateral_step) * (num_lateral - 1)
    steepest = -float(table.tilt_origin)
    random = np.random.default_rng(0)
    reach = np.where(random.random(count) < 0.5, 0.25, 1.0)
    axial = nearest + (farthest - nearest) * reach * random.random(count)
    lateral = random.uniform(-widest, widest, count)
    tilt = random.uniform(-steepest, steepest, count)
    return np.stack([axial, lateral, tilt]).astype(np.float32)


def exact_efficiency(inductance: np.ndarray, link: LinkParams) -> np.ndarray:
    """Link efficiency by the circuit form of eq (6), in float64; inductance in H."""
    load, primary = float(link.load_ohm), float(link.med_resistance_ohm)
    secondary, omega = float(link.ev_resistance_ohm), float(link.angular_frequency)
    total = secondary + load
    return load / (total * (1 + primary * total / (omega * inductance) ** 2))


class Traffic(NamedTuple):
    """Vehicles of many roads, `(roads, slots)` each."""

    x: jax.Array  # m
    lane: jax.Array
    other_lane: jax.Array  # second lane of a vehicle that straddles a line, else NO_LANE
    target_lane: jax.Array  # adjacent lane that the vehicle considers; may be off the road
    active: jax.Array
    previous_order: jax.Array  # slots in road order one tick ago


def draw_traffic(config: EnvConfig, length_m: float, roads: int) -> Traffic:
    """Roads three quarters full, as in the preset, whose vehicles drove 20 to 30 m/s in the last tick.

    Positions are multiples of 0.25 m. Some tie, and their road order is by slot; all others are far enough apart
    for the sort to resolve.
    """
    random = np.random.default_rng(0)
    shape = (roads, config.num_vehicles)
    x = np.round(random.uniform(0.0, length_m, shape) * 4) / 4
    active = random.random(shape) < 0.75
    before = x - random.uniform(20.0, 30.0, shape) * config.tick_s
    lane = random.integers(0, config.num_lanes + 1, shape)
    # Outermost lanes have only an inner line.
    inwards = np.where(
        lane == 0, 1, np.where(lane == config.num_lanes, -1, random.choice([-1, 1], shape))
    )
    straddles = np.where(random.random(shape) < STRADDLING, inwards, 0)
    other = np.where(straddles == 0, NO_LANE, lane + straddles)
    # In a tick all vehicles of a road look to one side, except straddling ones.
    side = random.choice([-1, 1], (roads, 1))
    target = lane + np.where(straddles == 0, side, straddles)
    order = road_order(before, active)
    of = [jnp.asarray(each, jnp.int32) for each in (lane, other, target, order)]
    return Traffic(jnp.asarray(x, jnp.float32), of[0], of[1], of[2], jnp.asarray(active), of[3])


def road_order(x: np.ndarray, active: np.ndarray) -> np.ndarray:
    """Slots from the rearmost to the foremost vehicle; ties by slot, inactive slots last."""
    return np.argsort(np.where(active, x, np.inf), axis=-1, kind="stable")


def search_all_pairs(
    x: np.ndarray, lane: np.ndarray, other: np.ndarray, wanted: np.ndarray, active: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Next slots ahead and behind in the lane `wanted` of one road; NOBODY if there is none.

    All pairs are compared in float64. Of vehicles at the same place, the higher slot is ahead.

    Args:
      x: (N,) m.
      lane, other, wanted: (N,) int.
      active: (N,) bool.
    """
    slots = np.arange(len(x))
    gap = x.astype(np.float64) - x.astype(np.float64)[:, None]  # column minus row
    covers = (lane == wanted[:, None]) | (other == wanted[:, None])
    seen = active & active[:, None] & covers
    is_ahead = seen & ((gap > 0) | ((gap == 0) & (slots > slots[:, None])))
    is_behind = seen & ((gap < 0) | ((gap == 0) & (slots < slots[:, None])))
    ahead = np.argmin(np.where(is_ahead, gap, np.inf), axis=1)
    # Of ties behind, the last slot is nearest, but argmin takes the first; hence the reversal.
    behind = len(x) - 1 - np.argmin(np.where(is_behind, -gap, np.inf)[:, ::-1], axis=1)
    ahead = np.where(is_ahead.any(axis=1), ahead, NOBODY)
    return ahead, np.where(is_behind.any(axis=1), behind, NOBODY)


def count_wrong(found: Neighbours, traffic: Traffic, roads: int = CHECKED_ROADS) -> int:
    """Number of neighbours, four per slot, that differ from `search_all_pairs` on the first `roads`.

    A vehicle that straddles the line to its target lane is its own follower there, as `Neighbours` has it.
    """
    wrong = 0
    for road in range(min(roads, len(traffic.x))):
        x, lane, other, target, active, _ = (np.asarray(values[road]) for values in traffic)
        sides = (search_all_pairs(x, lane, other, wanted, active) for wanted in (lane, target))
        expected = np.concatenate(list(sides))
        expected[3] = np.where(active & (other == target), np.arange(len(x)), expected[3])
        ours = np.stack([slots[road] for slots in found])
        wrong += int(np.sum(ours != expected))
    return wrong

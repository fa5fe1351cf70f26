"""`python -m benchmarks.kernels`: time and worst error of the kernels of a tick.

The kernels are the elliptic integrals, mutual inductance by integral and by table, the sort along the road, and the
neighbour search. Each has the preset's size on `--roads` roads and is checked against a reference that shares no code
with it. Plain alternatives to the sort and the neighbour search are timed too. With few roads, the cost of launching a
program shows.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import medjax
from benchmarks.command import add_number, benchmark_parser, machine, run_command, whole_number
from benchmarks.speed.references import (
    CHECKED_ROADS,
    COILS,
    count_wrong,
    draw_positions,
    draw_traffic,
    exact_efficiency,
    neumann,
    road_order,
)
from medjax.charging.link import Misalignment, couple
from medjax.errors import InputError
from medjax.physics import ellipe, ellipk, interpolate_inductance, mutual_inductance
from medjax.traffic import find_neighbours, sort_by_road
from medjax.traffic.neighbours import NOBODY, Neighbours
from medjax.world.params import EnvConfig, LinkParams

try:
    from scipy import special
except ImportError:  # `main` says what to install
    special = None

SCENARIO = "paper"
# With wires closer than this, the integral and its table guarantee no accuracy (their docstrings).
INTEGRAL_GAP_M, TABLE_GAP_M = 0.05, 0.03
CHECKED_PAIRS = 1000  # the reference takes two milliseconds per pair
ALL_PAIRS_ROADS = 64  # enough, since its time per slot grows with the slots, not with the roads
MOST = 65_536  # repeats, and roads, whose indices must fit `medjax.numerics.gathers`


Row = dict[str, Any]  # of the table


def time_calls(
    function: Callable[..., Any], *arguments: Any, repeats: int, element: str, elements: int
) -> tuple[Any, Row]:
    """Times a compiled function.

    Args:
      function: to compile.
      *arguments: of the function.
      repeats: calls to time.
      element: what is counted: value, pair or slot.
      elements: number of them in a call.

    Returns:
      The output, and the figures of a row: ns_per_element is a median without compilation.
    """
    start = time.perf_counter()
    program = jax.jit(function).lower(*arguments).compile()
    compile_s = time.perf_counter() - start
    output = jax.block_until_ready(program(*arguments))
    walls = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(program(*arguments))
        walls.append(time.perf_counter() - start)
    ns_per_element = statistics.median(walls) / elements * 1e9
    counted = {"element": element, "elements": elements}
    return output, {**counted, "ns_per_element": ns_per_element, "compile_s": compile_s}


def row_of(kernel: str, figures: Row, worst_error: Any, against: str) -> Row:
    """A row; `against` says the kind of error and the reference."""
    return {"kernel": kernel, **figures, "worst_error": float(worst_error), "against": against}


def elliptic_rows(count: int, repeats: int) -> list[Row]:
    """Rows of K and E at `count` parameters, half of which approach 1 on a logarithmic scale."""
    random = np.random.default_rng(0)
    near_one = 1 - 10.0 ** random.uniform(-7.2, 0.0, count // 2)
    m = np.concatenate([random.uniform(0.0, 1.0, count - len(near_one)), near_one])
    m = np.minimum(m.astype(np.float32), np.nextafter(np.float32(1), np.float32(0)))
    calls: Row = {"repeats": repeats, "element": "value", "elements": count}
    rows = []
    for function in (ellipk, ellipe):
        value, figures = time_calls(function, jnp.asarray(m), **calls)
        exact = getattr(special, function.__name__)(m.astype(np.float64))
        error = np.max(np.abs(np.asarray(value, np.float64) / exact - 1))
        rows.append(row_of(function.__name__, figures, error, "relative, SciPy's in float64"))
    return rows


def coil_rows(link: LinkParams, count: int, repeats: int) -> list[Row]:
    """Rows of the integral and its table at `count` positions within the table's limits."""
    position = draw_positions(link, count)
    checked = min(count, CHECKED_PAIRS)
    exact, gap = np.transpose([neumann(*each) for each in position[:, :checked].T.tolist()])

    def integral(axial: jax.Array, lateral: jax.Array, tilt: jax.Array) -> jax.Array:
        return mutual_inductance(
            COILS.med_coil_radius_m, COILS.ev_coil_radius_m, axial, lateral, tilt,
            primary_turns=COILS.med_coil_turns, secondary_turns=COILS.ev_coil_turns,
        )  # fmt: skip

    def row(kernel: str, figures: Row, error: np.ndarray, gap_m: float, what: str) -> Row:
        apart = gap >= gap_m
        pairs = f"{np.sum(apart)} of {checked} pairs (wires {gap_m} m apart or more)"
        return row_of(kernel, figures, np.max(error[apart]), f"{what}, {pairs}")

    calls: Row = {"repeats": repeats, "element": "pair", "elements": count}
    arguments = [jnp.asarray(x) for x in position]
    value, integrating = time_calls(integral, *arguments, **calls)
    # M passes through zero, so its error is relative to the coaxial M at the same axial distance.
    coaxial = np.array([neumann(float(axial), 0.0, 0.0)[0] for axial in position[0, :checked]])
    error = np.abs(np.asarray(value, np.float64)[:checked] - exact) / coaxial
    _, reading = time_calls(interpolate_inductance, link.inductance, *arguments, **calls)
    efficiency = jax.jit(couple)(Misalignment(*arguments), link).efficiency
    off = np.abs(np.asarray(efficiency, np.float64)[:checked] - exact_efficiency(exact, link))
    by_neumann = "by coaxial M, Neumann's integral in float64"
    return [
        row("mutual_inductance", integrating, error, INTEGRAL_GAP_M, by_neumann),
        row("interpolate_inductance", reading, off, TABLE_GAP_M, "of link efficiency, the same"),
    ]


def all_pairs_leader(
    x: jax.Array, lane: jax.Array, other: jax.Array, active: jax.Array
) -> jax.Array:
    """Next slots ahead in the same lane, `(N,)`, by a masked argmin over all pairs, which `find_neighbours` avoids."""
    slots = jnp.arange(x.shape[0])
    gap = x - x[:, None]
    is_ahead = (gap > 0) | ((gap == 0) & (slots > slots[:, None]))
    covers = (lane == lane[:, None]) | (other == lane[:, None])
    seen = is_ahead & covers & active & active[:, None]
    leader = jnp.argmin(jnp.where(seen, gap, jnp.inf), axis=1)
    return jnp.where(jnp.any(seen, axis=1), leader, NOBODY)


def neighbour_rows(config: EnvConfig, length_m: float, roads: int, repeats: int) -> list[Row]:
    """Rows of the sort and the neighbour search, and of a plain alternative to each."""
    traffic = draw_traffic(config, length_m, roads)
    x, lane, other, target, active, previous = traffic
    expected = road_order(np.asarray(x, np.float64), np.asarray(active))

    def time_on(used: int, function: Callable[..., Any], *arguments: jax.Array) -> Any:
        calls: Row = {"repeats": repeats, "element": "slot", "elements": used * config.num_vehicles}
        return time_calls(jax.vmap(function), *arguments, **calls)

    def sort(x: jax.Array, active: jax.Array, previous: jax.Array) -> jax.Array:
        return sort_by_road(x, active, length_m, previous)

    def plain_sort(x: jax.Array, active: jax.Array) -> jax.Array:
        return jnp.argsort(jnp.where(active, x, jnp.inf))

    def find(
        order: jax.Array, lane: jax.Array, other: jax.Array, target: jax.Array, active: jax.Array
    ) -> Neighbours:
        return find_neighbours(order, lane, other, target, active, config.num_lanes + 1)

    order, sorting = time_on(roads, sort, x, active, previous)
    plain_order, plain_sorting = time_on(roads, plain_sort, x, active)
    neighbours, finding = time_on(roads, find, order, lane, other, target, active)
    few = min(roads, ALL_PAIRS_ROADS)
    leader, searching = time_on(few, all_pairs_leader, *(a[:few] for a in (x, lane, other, active)))
    places = "places that differ, NumPy's stable argsort in float64"
    nearest = f"neighbours that differ, all pairs in float64, {min(roads, CHECKED_ROADS)} roads"
    differ = np.sum(np.asarray(leader != neighbours.leader[:few]))
    return [
        row_of("sort_by_road", sorting, np.sum(np.asarray(order) != expected), places),
        row_of("jnp.argsort", plain_sorting, np.sum(np.asarray(plain_order) != expected), places),
        row_of("find_neighbours", finding, count_wrong(neighbours, traffic), nearest),
        row_of("all-pairs leader", searching, differ, "leaders that differ, find_neighbours"),
    ]


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Times all kernels at the preset's sizes and prints the table.

    Raises:
      InputError: SciPy is not installed.
    """
    if special is None:
        raise InputError('SciPy, the reference, is not installed: pip install -e ".[train,test]"')
    roads, repeats = options.roads, options.repeats
    env, params = medjax.make(SCENARIO)
    rows = [
        *elliptic_rows(roads * env.config.num_vehicles, repeats),
        # Every tick evaluates one inductance per EV slot.
        *coil_rows(params.link, roads * env.config.num_evs, repeats),
        *neighbour_rows(env.config, float(params.road.length_m), roads, repeats),
    ]
    ns = {row["kernel"]: row["ns_per_element"] for row in rows}
    result = {"scenario": SCENARIO, "roads": roads, "repeats": repeats, **machine()}
    result["integral_by_table"] = ns["mutual_inductance"] / ns["interpolate_inductance"]
    result["rows"] = rows
    print(report(result))
    return result


def report(result: dict[str, Any]) -> str:
    """Formats the table."""
    lines = [
        f"{result['roads']} roads of preset {result['scenario']}, medians of {result['repeats']} repeats; "
        f"JAX {result['jax_version']} on {result['backend']} ({result['device']})",
        "",
        f"{'kernel':23}{'elements':>16}{'ns/element':>12}{'compile s':>11}{'worst error':>13}  against",
    ]
    for row in result["rows"]:
        elements = f"{row['elements']:,} {row['element']}s"
        lines.append(
            f"{row['kernel']:23}{elements:>16}{row['ns_per_element']:12.2f}{row['compile_s']:11.2f}"
            f"{row['worst_error']:13.2g}  {row['against']}"
        )
    ratio = f"The coil integral takes {result['integral_by_table']:.1f} times as long as its table."
    return "\n".join([*lines, "", ratio])


def main(arguments: list[str] | None = None) -> None:
    parser = benchmark_parser("kernels", __doc__)
    count = whole_number(most=MOST)
    add_number(parser, "--roads", 1024, "number of roads", count)
    add_number(parser, "--repeats", 7, "timings per kernel", count)
    run_command(parser, measure, arguments)

"""Kernels are timed, their errors are within what the docs promise, and the checks can fail."""

import dataclasses
import json
import subprocess
import sys

import jax
import numpy as np
import pytest

import medjax
from benchmarks.speed import kernels
from tests.benchmarks.refusal import refused

special = pytest.importorskip("scipy.special")

# Worst errors promised: tests/physics/test_elliptic.py; the docstring of mutual_inductance (1e-6 of its
# coaxial value) with float32's rounding; that of tabulate_inductance; neighbours are exact.
BOUNDS = {
    "ellipk": 1e-6,
    "ellipe": 1e-6,
    "mutual_inductance": 2e-6,
    "interpolate_inductance": 9e-4,
    "sort_by_road": 0,
    "jnp.argsort": 0,
    "find_neighbours": 0,
    "all-pairs leader": 0,
}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """What the command wrote, on two roads."""
    path = tmp_path_factory.mktemp("kernels") / "kernels.json"
    kernels.main(["--roads", "2", "--repeats", "2", "--json", str(path)])
    return json.loads(path.read_text())


def test_rows_are_timed_and_within_the_documented_errors(written):
    assert [row["kernel"] for row in written["rows"]] == list(BOUNDS)
    for row in written["rows"]:
        assert set(row) == {field.name for field in dataclasses.fields(kernels.Row)}
        for figure in ("elements", "ns_per_element", "compile_s"):
            assert 0 < row[figure] < np.inf, row
        assert 0 <= row["worst_error"] <= BOUNDS[row["kernel"]], row


def test_sizes_are_the_presets(written):
    config = medjax.SCENARIOS[kernels.SCENARIO].config
    per_road = {"value": config.num_vehicles, "pair": config.num_evs, "slot": config.num_vehicles}
    for row in written["rows"]:
        assert row["elements"] == 2 * per_road[row["element"]]
    assert {key: written[key] for key in ("roads", "repeats", "jax_version", "backend")} == {
        "roads": 2,
        "repeats": 2,
        "jax_version": jax.__version__,
        "backend": jax.default_backend(),
    }
    assert written["device"]


def test_table_shows_every_row_and_the_ratio(written):
    lines = kernels.report(written).splitlines()
    columns = {line.index("  against") for line in lines if "  against" in line}
    assert len(columns) == 1
    for row in written["rows"]:
        (line,) = [line for line in lines if line.startswith(f"{row['kernel']}  ")]
        assert f"{row['ns_per_element']:.2f}" in line
        assert line.endswith(f"  {row['against']}")
    ns = {row["kernel"]: row["ns_per_element"] for row in written["rows"]}
    ratio = ns["mutual_inductance"] / ns["interpolate_inductance"]
    assert written["integral_by_table"] == pytest.approx(ratio)
    assert f"{ratio:.1f} times" in lines[-1]


@pytest.mark.parametrize("axial", [0.05, 0.2, 1.0])
def test_neumanns_integral_is_maxwells_closed_form_on_one_axis(axial):
    """DLMF 19.34; the wires' distance is that of two rings."""
    coils = kernels.COILS
    radius_1, radius_2 = coils.med_coil_radius_m, coils.ev_coil_radius_m
    m = 4 * radius_1 * radius_2 / ((radius_1 + radius_2) ** 2 + axial**2)
    k = np.sqrt(m)
    psi = (2 / k - k) * special.ellipk(m) - 2 / k * special.ellipe(m)
    turns = coils.med_coil_turns * coils.ev_coil_turns
    expected = turns * 4e-7 * np.pi * np.sqrt(radius_1 * radius_2) * psi
    inductance, gap = kernels.neumann(axial, 0.0, 0.0)
    assert inductance == pytest.approx(expected, rel=1e-10)
    assert gap == pytest.approx(np.hypot(axial, radius_1 - radius_2))


def test_neumanns_integral_has_converged_where_it_is_used():
    """The nearest wires that are checked: one rim dips to the other."""
    position = (0.105, -0.05, 0.25)
    inductance, gap = kernels.neumann(*position)
    assert gap == pytest.approx(kernels.TABLE_GAP_M, abs=0.003)
    assert inductance == pytest.approx(kernels.neumann(*position, num_nodes=1024)[0], rel=1e-8)


@pytest.fixture(scope="module")
def roads():
    """Two roads and their neighbours."""
    config = medjax.SCENARIOS[kernels.SCENARIO].config
    traffic = kernels.draw_traffic(config, 4000.0, 2)
    x, lane, target, active, previous = traffic

    def find(x, lane, target, active, previous):
        order = kernels.sort_by_road(x, active, 4000.0, previous)
        return kernels.find_neighbours(order, lane, target, active, config.num_lanes + 1)

    return traffic, jax.jit(jax.vmap(find))(x, lane, target, active, previous)


def test_drawn_roads_are_three_quarters_full_and_hold_ties(roads):
    traffic, _ = roads
    for x, active in zip(np.asarray(traffic.x), np.asarray(traffic.active), strict=True):
        assert 0.6 < np.mean(active) < 0.9
        assert 0.0 <= x.min() <= x.max() <= 4000.0
    assert any(len(np.unique(x)) < len(x) for x in np.asarray(traffic.x))


def test_true_neighbours_agree_with_all_pairs(roads):
    traffic, found = roads
    assert kernels.count_wrong(found, traffic) == 0


@pytest.mark.parametrize("side", range(4))
def test_one_wrong_neighbour_is_counted(roads, side):
    traffic, found = roads
    wrong = [np.array(slots) for slots in found]
    wrong[side][1, 20] += 1
    assert kernels.count_wrong(type(found)(*wrong), traffic) == 1


def test_wrong_ways_to_find_neighbours_are_detected(roads):
    """Sides exchanged, inactive vehicles seen, and the own lane taken for the target's."""
    traffic, found = roads
    exchanged = found._replace(leader=found.follower, follower=found.leader)
    blind = found._replace(target_leader=found.leader, target_follower=found.follower)
    everybody = traffic._replace(active=np.ones_like(traffic.active))
    for wrong, truth in ((exchanged, traffic), (blind, traffic), (found, everybody)):
        assert kernels.count_wrong(wrong, truth) > 100


def test_a_wrong_kernel_shows_in_its_row(monkeypatch):
    """The whole way: a finder that takes ahead for behind is not reported as exact."""
    true = kernels.find_neighbours

    def wrong(order, lane, target, active, num_lanes):
        return true(order[::-1], lane, target, active, num_lanes)

    monkeypatch.setattr(kernels, "find_neighbours", wrong)
    config = medjax.SCENARIOS[kernels.SCENARIO].config
    rows = {row.kernel: row for row in kernels.neighbour_rows(config, 4000.0, 1, 1)}
    assert rows["find_neighbours"].worst_error > 100
    assert rows["sort_by_road"].worst_error == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--roads", "0"], "'0': allowed a whole number from 1 to 65536"),
        (["--roads", "many"], "'many': allowed a whole number"),
        (["--roads", "65537"], "allowed a whole number from 1 to 65536"),
        (["--repeats", "-1"], "'-1': allowed a whole number"),
        (["--repeats", "1.5"], "'1.5': allowed a whole number"),
        (["--json", "."], ".: is a directory; allowed a file"),
        (
            ["--json", "/no/such/place.json"],
            "No such file or directory; allowed a file in a directory that can be written",
        ),
        (["--road", "3"], "unrecognized arguments"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments, said, capsys):
    error = refused(kernels.main, arguments, capsys)
    assert error.startswith("python -m benchmarks.kernels: ")
    assert said in error


def test_missing_scipy_is_one_line_that_says_what_to_install():
    program = (
        "import sys; sys.modules['scipy'] = None; from benchmarks import kernels; kernels.main([])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == (
        "python -m benchmarks.kernels: SciPy, the reference, is not installed: "
        'pip install -e ".[train,test]"\n'
    )

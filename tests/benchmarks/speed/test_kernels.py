"""Kernels are timed, and their errors are within what the docs promise."""

import importlib
import json
import sys

import jax
import numpy as np
import pytest

import medjax
from benchmarks.speed import kernels
from tests.benchmarks.refusal import refused

pytest.importorskip("scipy.special")

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


@pytest.mark.thorough
def test_rows_are_timed_and_within_the_documented_errors(written):
    assert [row["kernel"] for row in written["rows"]] == list(BOUNDS)
    figures = {"element", "elements", "ns_per_element", "compile_s", "worst_error"}
    for row in written["rows"]:
        assert set(row) == {"kernel", "against", *figures}
        assert row["against"]
        for figure in ("elements", "ns_per_element", "compile_s"):
            assert 0 < row[figure] < np.inf, row
        assert 0 <= row["worst_error"] <= BOUNDS[row["kernel"]], row


def test_sizes_are_the_presets(written):
    config = medjax.SCENARIOS[kernels.SCENARIO].config
    per_road = {"value": config.num_vehicles, "pair": config.num_evs, "slot": config.num_vehicles}
    for row in written["rows"]:
        assert row["elements"] == 2 * per_road[row["element"]]
    machine = {"jax_version": jax.__version__, "backend": jax.default_backend()}
    assert {"roads": 2, "repeats": 2, **machine}.items() <= written.items()
    assert written["device"]


def test_table_shows_every_row_and_the_ratio(written):
    *lines, last = kernels.report(written).splitlines()
    assert len({line.index("  against") for line in lines if "  against" in line}) == 1
    for row in written["rows"]:
        (line,) = [line for line in lines if line.startswith(f"{row['kernel']}  ")]
        assert f"{row['ns_per_element']:.2f}" in line
        assert line.endswith(f"  {row['against']}")
    ns = {row["kernel"]: row["ns_per_element"] for row in written["rows"]}
    ratio = ns["mutual_inductance"] / ns["interpolate_inductance"]
    assert written["integral_by_table"] == pytest.approx(ratio)
    assert f"{ratio:.1f} times" in last


def test_a_wrong_kernel_shows_in_its_row(monkeypatch):
    """The whole way: a finder that takes ahead for behind is not reported as exact."""
    true = kernels.find_neighbours

    def wrong(order, *seen):
        return true(order[::-1], *seen)

    monkeypatch.setattr(kernels, "find_neighbours", wrong)
    config = medjax.SCENARIOS[kernels.SCENARIO].config
    rows = kernels.neighbour_rows(config, 4000.0, 1, 1)
    errors = {row["kernel"]: row["worst_error"] for row in rows}
    assert errors["find_neighbours"] > 100
    assert errors["sort_by_road"] == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--roads", "0"], "'0': allowed a whole number from 1 to 65536"),
        (["--roads", "many"], "'many': allowed a whole number"),
        (["--roads", "65537"], "allowed a whole number from 1 to 65536"),
        (["--repeats", "-1"], "'-1': allowed a whole number"),
        (["--repeats", "1.5"], "'1.5': allowed a whole number"),
        (["--json", "."], "is a directory"),
        (["--json", "/no/such/place.json"], "/no/such/place.json"),
        (["--road", "3"], "unrecognized arguments"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments, said, capsys):
    error = refused(kernels.main, arguments, capsys)
    assert error.startswith("python -m benchmarks.kernels: ")
    assert said in error


def test_missing_scipy_is_one_line_that_says_what_to_install(monkeypatch, capsys):
    with monkeypatch.context() as patched:
        patched.setitem(sys.modules, "scipy", None)
        error = refused(importlib.reload(kernels).main, [], capsys)
    importlib.reload(kernels)
    assert error == (
        "python -m benchmarks.kernels: SciPy, the reference, is not installed: "
        'pip install -e ".[train,test]"\n'
    )

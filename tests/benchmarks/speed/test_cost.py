"""Launches and bytes are counted as a person would count them, and a decision keeps to its budget."""

import importlib.metadata
import json
import subprocess

import jax
import jax.numpy as jnp
import pytest
from jax import lax

from benchmarks.speed import cost
from benchmarks.speed.hlo import Program, shape_bytes
from benchmarks.speed.launches import cost_of, loops_of
from benchmarks.speed.stages import OTHER, STAGES
from medjax.numerics.rows import CACHED_ROWS
from tests.benchmarks.refusal import refused
from tests.documented import ROOT

# A decision of 128 environments of the paper's preset on a CPU, with JAX 0.10.2: 2,460 launches and 231.8 MB; one of
# 65,536 on an H100: 351 and 30,919 MB.
MOST_LAUNCHES, MOST_BYTES = 2_460, 235_000_000
MOST_ON_H100 = {"launches": 357, "bytes": 31_000_000_000}
REMEDY = (
    f"`python -m benchmarks.cost` shows the stages, in the tree before, too. Make it cheaper; if what it buys is "
    f"worth the price, or a new JAX compiles otherwise (this one is {jax.__version__}), raise the budget here, "
    f"say why in the commit, and renew the tables of docs/performance.md and docs/gpu.md"
)

K = jax.ShapeDtypeStruct((1000,), jnp.float32)  # 4000 bytes
LONG = jax.ShapeDtypeStruct((10_000,), jnp.float32)
FEW = jax.ShapeDtypeStruct((10,), jnp.int32)
INDEX = jax.ShapeDtypeStruct((), jnp.int32)
SCALARS = 100  # bytes; more than the counters and flags of a small program


def compiled(function, *shapes, **options):
    text = jax.jit(function, **options).lower(*shapes).compile().as_text()
    return Program(text)


def counted(function, *shapes, **options):
    program = compiled(function, *shapes, **options)
    return cost_of(program, program.entry)


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ("f32[]", 4),
        ("f32[64,208]{1,0}", 53_248),
        ("pred[3]{0}", 3),
        ("bf16[2,3]{1,0}", 12),
        ("s4[3]{0}", 2),
        ("(f32[2]{0}, /*index=1*/u8[5]{0})", 13),
        ("token[]", 0),
    ],
)
def test_bytes_of_a_shape(shape, expected):
    assert shape_bytes(shape) == expected


def test_an_addition_reads_and_writes_its_array():
    found = counted(lambda x: x + 1, K)
    assert (found.total_launches, found.total_bytes) == (1, 8000)


def test_a_loop_counts_each_round_and_of_its_rows_one():
    """A round multiplies the carry (4000 bytes in, 4000 out) by one of seven rows (4000)."""
    rows = jax.ShapeDtypeStruct((7, 1000), jnp.float32)
    program = compiled(
        lambda x, rows: lax.scan(lambda x, row: (x * row, None), x, rows)[0], K, rows
    )
    ((loop, times),) = loops_of(program, program.entry)
    assert times == loop.rounds == 7
    a_round = cost_of(program, loop.called[-1])
    assert 12_000 <= a_round.total_bytes < 12_000 + SCALARS
    whole = cost_of(program, program.entry)
    around = cost_of(program, program.entry, without=loop.called[-1])
    assert whole.total_bytes == 7 * a_round.total_bytes + around.total_bytes
    assert whole.total_launches == 7 * a_round.total_launches + around.total_launches
    assert around.total_bytes < 8000 + SCALARS  # XLA copies the carry once


def test_a_loop_whose_rounds_depend_on_the_data_is_not_counted():
    program = compiled(lambda x, n: lax.fori_loop(0, n, lambda _, x: x * 1.5, x), K, INDEX)
    ((loop, times),) = loops_of(program, program.entry)
    assert (loop.rounds, times) == (None, 0)
    assert cost_of(program, program.entry).total_bytes < 8000 + SCALARS


def test_of_a_conditional_the_dearest_branch_counts():
    """The product of two arrays moves 12,000 bytes, the double of one 8000."""
    whether = jax.ShapeDtypeStruct((), jnp.bool_)
    double, multiply = lambda x, y: x * 2, lambda x, y: x * y
    for branches in ((multiply, double), (double, multiply)):
        found = counted(
            lambda is_true, x, y, of=branches: lax.cond(is_true, *of, x, y), whether, K, K
        )
        assert 12_000 <= found.total_bytes < 12_000 + SCALARS


def test_a_read_by_index_counts_what_it_picks():
    """Ten numbers of four bytes, their indices, and the result."""
    assert counted(lambda x, index: x[index], LONG, FEW).total_bytes == 3 * 40


def test_a_write_in_place_counts_what_it_writes():
    """Ten doubled numbers, in and out, and where they go."""
    values = jax.ShapeDtypeStruct((10,), jnp.float32)

    def write(x, values, index):
        return lax.dynamic_update_slice(x, 2 * values, (index,))

    assert counted(write, LONG, values, INDEX, donate_argnums=0).total_bytes == 40 + 40 + 4


def test_a_launch_is_shared_among_its_stages():
    """Entry reads x, exits reads w and writes the result: 4000 bytes each, in one launch."""

    def decide(x, w):
        with jax.named_scope("entry"):
            x = x + 1
        with jax.named_scope("exits"):
            return x * w

    found = counted(decide, K, K)
    assert found.bytes == {"entry": 4000, "exits": 8000}
    assert found.launches == pytest.approx({"entry": 1 / 3, "exits": 2 / 3})


@pytest.fixture(scope="module")
def decision():
    """What the command counts on a CPU; the only program of the world that this file compiles."""
    return cost.count_costs("cpu", "paper", CACHED_ROWS)


def test_a_decision_keeps_to_its_budget(decision):
    assert decision["launches"] <= MOST_LAUNCHES, REMEDY
    assert decision["bytes"] <= MOST_BYTES, REMEDY


def test_every_stage_has_a_part_of_a_decision(decision):
    """Stages add up; a tick's bytes do not pile up in the stage at the end of its fusions."""
    tick, around = decision["parts"].values()
    assert (tick["times"], around["times"]) == (4, 1)
    assert {*tick["stages"], *around["stages"]} == {*STAGES, OTHER}
    for what in ("launches", "bytes"):
        for part in (tick, around):
            shares = [stage[what] for stage in part["stages"].values()]
            assert min(shares) > 0
            assert sum(shares) == pytest.approx(part[what])
        assert decision[what] == 4 * tick[what] + around[what]
    assert tick["stages"]["exits"]["bytes"] < tick["bytes"] / 10
    assert decision["left_out"] == ["auto_reset"]


@pytest.fixture
def with_settings():
    """Restores JAX's settings that the command changes."""
    names = ("jax_platforms", "jax_compilation_cache_include_metadata_in_key")
    before = {name: getattr(jax.config, name) for name in names}
    yield
    for name, value in before.items():
        jax.config.update(name, value)


@pytest.mark.usefixtures("with_settings")
def test_prints_and_writes_what_it_counts(decision, monkeypatch, tmp_path, capsys):
    asked = []
    monkeypatch.setattr(cost, "count_costs", lambda *given: asked.append(given) or decision)
    path = tmp_path / "cost.json"
    cost.main(["--json", str(path)])
    assert asked == [("cpu", "paper", CACHED_ROWS)]
    assert json.loads(path.read_text()) == decision
    out = capsys.readouterr().out
    assert out.startswith(
        f"128 environments of paper, JAX {jax.__version__}, for cpu, compiled in "
    )
    assert "a tick, 4 times a decision\n" in out
    assert f"a decision: {decision['launches']:,} launches, " in out
    assert "a launch on a CPU: an executed instruction" in out


def test_on_an_h100_it_says_the_least_time(decision):
    out = cost.report(decision | {"target": "h100", "bytes": 67_000_000_000, "least_s": 0.02})
    assert out.splitlines()[-2].endswith(" launches, 67,000.0 MB, at least 20 ms at 3.35 TB/s")
    assert "on a CPU" not in out


@pytest.mark.parametrize(
    ("argv", "word"),
    [
        (["--num-envs", "0"], "--num-envs"),
        (["--target", "tpu"], "'tpu'"),
        (["--scenario", "moon"], "'moon'"),
        (["--json", "/no/such/folder/cost.json"], "allowed a file"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(argv, word, capsys):
    """Before anything is compiled."""
    assert word in refused(cost.main, argv, capsys)


@pytest.mark.parametrize("found", ["not installed", "0.1.0"])
def test_without_the_compiler_it_says_what_to_install(found, monkeypatch, capsys):
    """Or with that of another JAX."""

    def version(name):
        if found == "not installed":
            raise importlib.metadata.PackageNotFoundError(name)
        return found

    monkeypatch.setattr(importlib.metadata, "version", version)
    said = refused(cost.main, ["--target", "h100"], capsys)
    allowed = f'allowed {jax.__version__}: pip install -c constraints.txt -e ".[cost]"'
    assert said == (
        f"python -m benchmarks.cost: --target h100: jax-cuda12-plugin is {found}, {allowed}\n"
    )


@pytest.mark.thorough
def test_a_decision_keeps_to_its_budget_on_an_h100(tmp_path):
    """Where the environment of docs/gpu.md is, .venv/cost; an H100 need not be there."""
    python = ROOT / ".venv" / "cost" / "bin" / "python"
    if not python.exists():
        pytest.skip("docs/gpu.md says how to install .venv/cost")
    path = tmp_path / "cost.json"
    words = ["-m", "benchmarks.cost", "--target=h100", f"--json={path}"]
    subprocess.run([python, *words], check=True, cwd=ROOT, capture_output=True)
    result = json.loads(path.read_text())
    assert result["least_s"] == pytest.approx(result["bytes"] / 3.35e12)
    for what, most in MOST_ON_H100.items():
        assert 0 < result[what] <= most, REMEDY

"""The preset plays as it did when tests/data/golden.json was written, and what compares two trees sees a bit.

Where a change is meant to change what is simulated, write the numbers anew and say why:

    python -m benchmarks.verification.golden --numbers tests/data/golden.json
"""

import dataclasses
import functools
import json
from pathlib import Path

import jax
import numpy as np
import pytest

import medjax
from benchmarks.verification import golden
from tests.benchmarks.refusal import refused

pytestmark = pytest.mark.usefixtures("quick_compiles")

EXPECTED = json.loads((Path(__file__).parents[2] / "data/golden.json").read_text())
# Ten times what these programs and fully optimised ones, which round otherwise, are apart after 60 decisions.
RELATIVE, ABSOLUTE = 2e-6, 1e-4
# Numbers whose hundredth decides nothing in these worlds: thresholds that nobody is close to.
THRESHOLDS = {
    "charging": (
        "dock_speed_tolerance",
        "dock_tolerance_m",
        "hold_tolerance_m",
        "patience_s",
        "reach_ahead_m",
        "reach_behind_m",
        "request_soc",
        "retry_s",
        "stop_soc",
        "taper_soc",
        "target_soc",
        "tow_s",
    ),
    "demand": (
        "ev_share",
        "exit_share",
        "human_share",
        "lorry_share",
        "period_s",
        "ramp_per_h",
        "start_s",
    ),
    "drivers": ("eco_compliance", "eco_horizon_m", "eco_soc"),
    "fleet": ("depot_power_w", "reserve_soc", "return_speed", "trip_m", "turnaround_s"),
    "lane_change": (
        "exit_view_m",
        "mandatory_bias",
        "politeness",
        "right_bias",
        "safe_braking",
        "threshold",
        "urgency_bias",
    ),
    "motion": ("lateral_slope", "max_braking"),
}


@pytest.fixture(scope="module")
def worlds():
    """By name: parameters, and what the world's last decision comes to under such ones."""
    found = {}
    for name, (preset, decisions, overrides) in golden.SHORT.items():
        env, params = medjax.make(preset, **overrides)
        play = golden.rollout(env, decisions)
        found[name] = params, lambda params, play=play: golden.last_of(play(params, 1))
    return found


def unlike(found, expected):
    """Names whose numbers are not those that are expected: whole ones exactly, others to rounding."""
    assert found.keys() == expected.keys()
    return {name for name in found if not alike(found[name], expected[name])}


def alike(a, b):
    a, b = np.asarray(a), np.asarray(b)
    if a.shape != b.shape:
        return False
    if "f" not in a.dtype.kind + b.dtype.kind:
        return np.array_equal(a, b)
    return np.allclose(a, b, RELATIVE, ABSOLUTE)


@pytest.mark.parametrize("world", golden.SHORT)
def test_plays_as_it_did(worlds, world):
    params, play = worlds[world]
    assert unlike(play(params), EXPECTED[world]) == set()


def test_a_hundredth_of_a_number_is_seen(worlds):
    """Of every number that is not 0 but THRESHOLDS, one after the other."""
    unseen: dict[str, bool] = {}
    for world, (params, play) in worlds.items():
        for index, (path, leaf) in enumerate(jax.tree_util.tree_leaves_with_path(params)):
            name = jax.tree_util.keystr(path, simple=True, separator=".")
            if leaf.ndim < 2 and np.any(leaf) and unseen.get(name, True):
                unseen[name] = not is_seen(params, play, index, EXPECTED[world])
    expected = {f"{group}.{name}" for group, names in THRESHOLDS.items() for name in names}
    found = {name for name in unseen if unseen[name]}
    assert sorted((found - {"episode_decisions"}) ^ expected) == []


def is_seen(params, play, index, expected):
    """Whether the leaf at that place, a hundredth larger or one less, changes what is played."""
    leaves, tree = jax.tree.flatten(params)
    leaf = leaves[index]
    changed = leaf * 1.01 if leaf.dtype.kind == "f" else leaf - 1
    leaves[index] = changed.astype(leaf.dtype)
    return bool(unlike(play(jax.tree.unflatten(tree, leaves)), expected))


def test_a_bit_is_seen():
    """Of any type, where it is, and by how much; NaN is itself, and -0.0 is not 0.0."""
    x = np.array([[[1.0, np.nan], [2.0, 0.0]]], np.float32)  # an environment, two decisions
    old = {"w/x": x, "w/n": np.array([1]), "w/text": np.array(["a", "b"])}
    assert list(golden.differences(old, {name: each.copy() for name, each in old.items()})) == []
    moved = x.copy()
    moved[0, 1, 0] = np.nextafter(x[0, 1, 0], np.float32(3))
    (line,) = golden.differences(old, old | {"w/x": moved})
    assert line == "w/x: 1 of 4 differ, first in decision 1, by at most 2.38e-07"
    negative = np.copysign(x, [[[1, 1], [1, -1]]]).astype("f")
    (line,) = golden.differences(old, old | {"w/x": negative})
    assert line == "w/x: 0 of 4 differ"
    (line,) = golden.differences(old, old | {"w/text": np.array(["a", "c"])})
    assert line == "w/text: differs"
    (line,) = golden.differences(old, old | {"w/n": np.array([1, 2])})
    assert line.startswith("w/n: int64 (1,)")
    assert [*golden.differences(old, {**old, "new": x})] == ["new: only in the new file"]
    assert [*golden.differences({**old, "old": x}, old)] == ["old: only in the old file"]


def run(argv):
    """Exit code of the command."""
    with pytest.raises(SystemExit) as ended:
        golden.main(argv)
    return int(ended.value.code)


def test_trees_are_compared_by_the_command(monkeypatch, tmp_path, capsys):
    """Twice the same world, and one in which an EV is a hundredth heavier."""
    small = {"num_meds": 1, "num_evs": 2, "num_gas": 4}
    rollout, envs = functools.cache(golden.rollout), {}  # of equal sizes: compiled once
    once = lambda env, count: rollout(envs.setdefault(env.config, env), count)  # noqa: E731
    monkeypatch.setattr(golden, "rollout", once)
    for file, world in (("a", {}), ("b", {}), ("c", {"ev.mass_kg": 1.01 * 1580.0})):
        monkeypatch.setattr(golden, "WORLDS", {"small": ("paper", 5, small | world)})
        monkeypatch.setattr(golden, "AGENTS", {})
        assert run([f"--out={tmp_path / file}.npz"]) == 0
    a, b, c = (str(tmp_path / f"{file}.npz") for file in "abc")
    assert run(["--compare", a, b]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("0 of ")
    assert run(["--compare", a, c, f"--json={tmp_path / 'd.json'}"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("small/evs.energy_j: ") for line in lines)
    assert not any(line.startswith("small/vehicles.x: ") for line in lines)
    assert json.loads((tmp_path / "d.json").read_text())["differ"] == lines[:-1]


def test_a_number_of_a_preset_that_no_world_plays_is_seen(monkeypatch):
    monkeypatch.setattr(golden, "WORLDS", {})
    monkeypatch.setattr(golden, "AGENTS", {})
    before = golden.rollouts()
    numbers = {**medjax.SCENARIOS["long"].numbers, "mainline_per_h": 1101.0}
    other = dataclasses.replace(medjax.SCENARIOS["long"], numbers=numbers)
    monkeypatch.setitem(medjax.SCENARIOS, "long", other)
    (line,) = golden.differences(before, golden.rollouts())
    assert line.startswith("long/preset: ")


@pytest.mark.slow
def test_a_short_training_run_repeats(monkeypatch):
    """Bit for bit: metrics, scores and weights."""
    tiny = {"--num-envs": 4, "--num-minibatches": 2, "--total-timesteps": 512, "--eval-episodes": 2}
    options = golden.TRAINING["training"] | tiny
    monkeypatch.setitem(golden.TRAINING, "training", options)
    first, second = golden.train("training"), golden.train("training")
    assert {
        "training/evaluation/policies/none/return_mean",
        "training/episode_return",
    } <= first.keys()
    assert any(name.startswith("training/weights/") for name in first)
    assert list(golden.differences(first, second)) == []


@pytest.mark.parametrize(
    ("argv", "word"),
    [
        ([], "--out"),
        (["--compare", "absent.npz", "absent.npz"], "absent.npz"),
        (["--compare", __file__, __file__], "test_golden.py cannot be read"),
        (["--out", "a.npz", "--numbers", "b.json"], "not allowed with"),
        (["--out", "/no/such/folder/a.npz"], "allowed a file"),
    ],
)
def test_bad_input_is_one_line_and_code_2(argv, word, capsys):
    assert word in refused(golden.main, argv, capsys)

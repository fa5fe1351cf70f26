"""The preset plays as it did when tests/data/golden.json was written, and the comparison of two trees sees one bit.

After a change that is meant to change the simulation, write the numbers anew and say why:

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
# Ten times the difference between these programs and fully optimised ones after 60 decisions.
RELATIVE, ABSOLUTE = 2e-6, 1e-4
# A change of these by a hundredth changes nothing in these worlds, since no vehicle is close to the threshold.
THRESHOLDS = """
charging.dock_speed_tolerance charging.dock_tolerance_m charging.hold_tolerance_m charging.patience_s
charging.reach_ahead_m charging.reach_behind_m charging.request_soc charging.retry_s charging.stop_soc
charging.taper_soc charging.target_soc charging.tow_s
demand.human_share demand.lorry_share demand.period_s demand.start_s demand.surge_factor demand.surge_from_s
demand.surge_until_s
drivers.eco_horizon_m drivers.eco_soc
fleet.depot_power_w fleet.reserve_soc fleet.return_speed fleet.trip_m fleet.turnaround_s
lane_change.exit_view_m lane_change.mandatory_bias lane_change.politeness lane_change.right_bias
lane_change.safe_braking lane_change.urgency_bias
motion.lateral_slope motion.max_braking
road.exit_notice_m
incidents.incident_from_s incidents.incident_from_x_m incidents.incident_until_s incidents.incident_until_x_m
"""


@pytest.fixture(scope="module")
def worlds():
    """By name: parameters, and a function from parameters to what one environment plays."""
    found = {}
    for name, (preset, decisions, overrides) in golden.SHORT.items():
        env, params = medjax.make(preset, **overrides)
        found[name] = params, functools.partial(golden.rollout(env, decisions), num_envs=1)
    return found


def unlike(found, expected):
    """Names of unexpected numbers; integers are compared exactly, others to rounding."""
    assert found.keys() == expected.keys()
    return {
        name for name in found if not alike(np.asarray(found[name]), np.asarray(expected[name]))
    }


def alike(a, b):
    if a.shape != b.shape or "f" not in a.dtype.kind + b.dtype.kind:
        return np.array_equal(a, b)
    return np.allclose(a, b, RELATIVE, ABSOLUTE)


@pytest.mark.thorough
@pytest.mark.parametrize("world", golden.SHORT)
def test_worlds_play_as_they_did(worlds, world):
    params, play = worlds[world]
    assert unlike(golden.last_of(play(params)), EXPECTED[world]) == set()


@pytest.mark.thorough
def test_a_change_of_a_hundredth_is_seen(worlds):
    """Each nonzero number except THRESHOLDS, a hundredth larger or one less, changes what one of the worlds plays."""
    unseen: dict[str, bool] = {}
    for world, (params, play) in worlds.items():
        paths = jax.tree_util.tree_leaves_with_path(params)
        leaves, tree = jax.tree.flatten(params)
        for index, (path, leaf) in enumerate(paths):
            name = jax.tree_util.keystr(path, simple=True, separator=".")
            if leaf.ndim < 2 and np.any(leaf) and unseen.get(name, True):
                changed = leaf * 1.01 if leaf.dtype.kind == "f" else leaf - 1
                others = [*leaves[:index], changed.astype(leaf.dtype), *leaves[index + 1 :]]
                found = golden.last_of(play(jax.tree.unflatten(tree, others)))
                unseen[name] = not unlike(found, EXPECTED[world])
    found = {name for name in unseen if unseen[name]}
    assert sorted((found - {"episode_decisions"}) ^ {*THRESHOLDS.split()}) == []


X = np.array([[[1.0, np.nan], [2.0, 0.0]]], np.float32)  # an environment, two decisions
MOVED = np.array([[[1.0, np.nan], [np.nextafter(np.float32(2), np.float32(3)), 0.0]]], np.float32)
OLD = {"x": X, "n": np.array([1]), "text": np.array(["a", "b"])}


@pytest.mark.parametrize(
    ("old", "new", "lines"),
    [
        (OLD, {name: each.copy() for name, each in OLD.items()}, []),
        (OLD, OLD | {"x": MOVED}, ["x: 1 of 4 differ, first in decision 1, by at most 2.38e-07"]),
        (OLD, OLD | {"x": np.where(X == 0.0, -X, X)}, ["x: 0 of 4 differ"]),  # -0.0 is not 0.0
        (OLD, OLD | {"text": np.array(["a", "c"])}, ["text: differs"]),
        (OLD, OLD | {"n": np.array([1, 2])}, ["n: int64 (1,) and int64 (2,)"]),
        (OLD, OLD | {"a": X}, ["a: only in the new file"]),
        (OLD | {"a": X}, OLD, ["a: only in the old file"]),
    ],
)
def test_a_difference_of_a_bit_is_found(old, new, lines):
    assert list(golden.differences(old, new)) == lines


def run(argv):
    """Exit code of the command."""
    with pytest.raises(SystemExit) as ended:
        golden.main(argv)
    return int(ended.value.code)


@pytest.mark.thorough
def test_the_command_compares_two_trees(monkeypatch, tmp_path, capsys):
    """Twice the same world, and one in which an EV is a hundredth heavier."""
    small = {"num_meds": 1, "num_evs": 2, "num_gas": 4, "battery_scale": 1.0}  # none runs out
    rollout, envs = functools.cache(golden.rollout), {}  # of equal sizes: compiled once
    once = lambda env, count: rollout(envs.setdefault(env.config, env), count)  # noqa: E731
    monkeypatch.setattr(golden, "rollout", once)
    monkeypatch.setattr(golden, "AGENTS", {})
    for file, changed in (("a", {}), ("b", {}), ("c", {"ev.mass_kg": 1.01 * 1636.03})):
        monkeypatch.setattr(golden, "WORLDS", {"small": ("paper", 5, small | changed)})
        assert run([f"--out={tmp_path / file}.npz"]) == 0
    a, b, c = (str(tmp_path / f"{file}.npz") for file in "abc")
    assert run(["--compare", a, b]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("0 of ")
    assert run(["--compare", a, c, f"--json={tmp_path / 'd.json'}"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("small/evs.energy_j: ") for line in lines)
    assert not any(line.startswith(("small/vehicles.x: ", "small/ended: ")) for line in lines)
    assert json.loads((tmp_path / "d.json").read_text())["differ"] == lines[:-1]


def test_a_changed_preset_that_no_world_plays_is_seen(monkeypatch):
    monkeypatch.setattr(golden, "WORLDS", {})
    monkeypatch.setattr(golden, "AGENTS", {})
    before = golden.rollouts()
    long = medjax.SCENARIOS["long"]
    other = dataclasses.replace(long, numbers={**long.numbers, "mainline_per_h": 1101.0})
    monkeypatch.setitem(medjax.SCENARIOS, "long", other)
    (line,) = golden.differences(before, golden.rollouts())
    assert line.startswith("long/preset: ")


@pytest.mark.slow
def test_a_short_training_run_repeats(monkeypatch):
    """Metrics, scores, weights and the output of train.evaluate are the same bit for bit."""
    tiny = {"--num-envs": 4, "--num-minibatches": 2, "--total-timesteps": 512, "--eval-episodes": 2}
    monkeypatch.setitem(golden.TRAINING, "training", golden.TRAINING["training"] | tiny)
    first, second = golden.train("training"), golden.train("training")
    names = {"training/evaluation/policies/none/return_mean", "training/episode_return"}
    assert names <= first.keys()
    assert any(name.startswith("training/weights/") for name in first)
    assert "none" in str(first["training/printed"])
    assert list(golden.differences(first, second)) == []


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        ([], "--out"),
        (["--compare", "absent.npz", "absent.npz"], "absent.npz cannot be read"),
        (["--compare", __file__, __file__], f"{__file__} cannot be read"),
        (["--out", "a.npz", "--numbers", "b.json"], "not allowed with"),
        (["--out", "/no/such/folder/a.npz"], "allowed a file"),
    ],
)
def test_bad_input_is_one_line_and_code_2(argv, words, capsys):
    assert words in refused(golden.main, argv, capsys)

"""The comparison of checkouts by turns."""

import json
from pathlib import Path

import pytest

from benchmarks.speed import pairs
from tests.benchmarks.refusal import refused

ROOT = Path(__file__).parents[3]


def test_shares_are_of_the_same_round():
    """The machine halves its speed between the rounds; the second tree is always 10 % slower."""
    rounds = [[(10.0, 20.0), (9.0, 18.0)], [(5.0, 10.0), (4.5, 9.0)]]
    first, second = pairs.summarize(rounds, ["old", "new"])
    assert first["wall_share"] == first["processor_share"] == [1.0, 1.0, 1.0]
    assert second["wall_share"] == second["processor_share"] == pytest.approx([0.9, 0.9, 0.9])
    assert second["updates_per_wall_s"] == pytest.approx(6.75)


STUB = """
import time

class Workload:
    compile_s = {compile_s}

    def __init__(self, num_envs, steps, scenario):
        self.active = {speed} * num_envs * steps

    def play(self):
        end = time.process_time() + 0.02
        while time.process_time() < end:
            pass
        return 2.0, self.active
"""


def test_each_tree_runs_its_own_code(tmp_path, capsys):
    """Two checkouts whose simulators only say how fast they are."""
    for name, speed in (("old", 100.0), ("new", 25.0)):
        for file, text in (
            ("medjax/numerics/devices.py", "prepare_cpu = lambda: None\n"),
            ("benchmarks/speed/workload.py", STUB.format(speed=speed, compile_s=speed / 10)),
        ):
            path = tmp_path / name / file
            path.parent.mkdir(parents=True)
            path.write_text(text)
            for folder in list(path.parents)[:2]:
                (folder / "__init__.py").touch()
    file = tmp_path / "pairs.json"
    trees = [str(tmp_path / name) for name in ("old", "new")]
    pairs.main([*trees, "--num-envs=8", "--rounds=3", f"--json={file}"])
    old, new = json.loads(file.read_text())["trees"]
    assert (old["tree"], new["tree"]) == tuple(trees)
    assert (old["compile_s"], new["compile_s"]) == (10.0, 2.5)
    assert old["updates_per_wall_s"] == 100.0 * 8 * 10 / 2.0
    assert (old["wall_share"], new["wall_share"]) == ([1.0] * 3, [0.25] * 3)
    assert new["processor_share"][1] == pytest.approx(0.25, rel=0.2)
    assert "8 environments of paper, 3 rounds" in capsys.readouterr().out


@pytest.mark.thorough
def test_a_tree_against_itself(tmp_path, capsys):
    file = tmp_path / "pairs.json"
    pairs.main([str(ROOT), str(ROOT), "--num-envs=8", "--rounds=2", f"--json={file}"])
    first, second = json.loads(file.read_text())["trees"]
    assert first["processor_share"] == [1.0, 1.0, 1.0]
    assert 0.2 < second["processor_share"][1] < 5.0
    assert first["updates_per_wall_s"] > 0.0
    assert capsys.readouterr().out.count(str(ROOT)) == 2


def test_a_folder_that_is_no_checkout_is_refused(tmp_path, capsys):
    assert "no checkout of medjax" in refused(pairs.main, [str(tmp_path)], capsys)

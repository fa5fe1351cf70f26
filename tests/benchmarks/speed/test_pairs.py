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

"""The soak's command: what it prints, counts and returns, and that its command shows a violation again."""

import functools
import json
import re
import shlex

import jax
import numpy as np
import pytest

from benchmarks import cases, soak
from benchmarks.invariants import INVARIANTS
from benchmarks.worlds import draw_config
from medjax.config import EnvConfig
from medjax.traffic import lane_change
from tests.benchmarks.refusal import refused

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = EnvConfig(
    num_lanes=3, num_ramps=1, num_meds=2, num_evs=6, num_gas=30, tick_s=0.5, ticks_per_decision=2
)


@pytest.fixture(scope="module")
def reckless():
    """A soak of one small case in a simulator that waives the safety of lane changes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lane_change, "is_safe", lambda own_after, *_, **__: own_after == own_after)
        patch.setattr(cases, "draw_config", lambda seed, number: SMALL)
        patch.setattr(cases, "EPISODE_S", 30.0)
        patch.setattr(soak, "Case", functools.cache(soak.Case))  # compiled once
        yield


def run(argv, capsys):
    """(exit code, what was printed) of the command."""
    with pytest.raises(SystemExit) as ended:
        soak.main(argv)
    return int(ended.value.code or 0), capsys.readouterr().out


def test_a_violation_is_shown_again_by_its_command(reckless, tmp_path, capsys):
    """Collisions are found, counted and printed, and the printed command plays up to the first and shows the pair."""
    path = tmp_path / "soak.json"
    argv = ["--updates=1", "--seed=3", "--cases=1", "--num-envs=8", f"--json={path}"]
    code, out = run(argv, capsys)
    assert code == 1
    report = json.loads(path.read_text())
    assert report["violations"]["overlap"] > 0
    assert report["violations"]["road"] == report["violations"]["bookings"] == 0
    assert f"{report['updates']:,} vehicle updates" in out
    assert len(report["commands"]) > 0
    for command in report["commands"][: soak.MOST_SHOWN]:
        assert command in out

    command = next(line for line in out.splitlines() if line.startswith("  python -m"))
    first = re.search(r"VIOLATED: (.*): seed 3, .* first in decision (\d+)", out)
    code, shown = run(shlex.split(command)[3:], capsys)
    assert code == 1
    assert first.group(0) in shown  # the same counts in the same decision
    assert re.search(r"tick \d: overlap: pairs in road order: \d", shown)
    assert shown.count("slot ") >= 2
    assert "--set 'demand.mainline_per_h=" in shown


def test_counts_are_of_vehicles_on_the_road(reckless):
    """Updates of an episode, against states between its decisions: few come and go in one."""
    case = soak.Case(3, 0, 8)
    totals, on_road = [], []
    for decisions in range(6):
        played = case.play(0, decisions)
        totals.append(int(played.updates.sum()))
        on_road.append(int(played.state.vehicles.active.sum()))
    ticks = SMALL.ticks_per_decision
    means = (np.array(on_road[1:]) + np.array(on_road[:-1])) / 2
    np.testing.assert_allclose(np.diff(totals), ticks * means, rtol=0.05)


def test_playing_to_a_decision_is_the_start_of_playing_on(reckless):
    """Bit for bit, or a violation could not be shown again; another episode is another."""
    case = soak.Case(3, 0, 8)
    one, again, other = case.play(0, 7), case.play(0, 7), case.play(1, 7)
    jax.tree.map(np.testing.assert_array_equal, one, again)
    assert not np.array_equal(one.state.vehicles.x, other.state.vehicles.x)
    whole = case.play(0)
    early = [row for row in range(8) if 0 <= whole.first[row] < case.decisions]
    row = early[0]
    assert case.play(0, int(whole.first[row])).violations[row].sum() == 0
    assert case.play(0, int(whole.first[row]) + 1).violations[row].sum() > 0


def test_stopping_prints_the_counts_so_far(monkeypatch, capsys):
    """Ctrl-C in the second case."""

    class Stopped:
        """A case that plays 100 updates, then is interrupted."""

        compile_s, config, num_envs = 0.0, draw_config(0, 0), 1

        def __init__(self, seed, number, num_envs):
            self.seed, self.number = seed, number

        def play(self, episode):
            if self.number == 1:
                raise KeyboardInterrupt
            quiet = np.zeros((1, len(INVARIANTS)), np.int32)
            return cases.Played(None, np.array([100]), quiet, np.array([cases.NEVER]))

    monkeypatch.setattr(soak, "Case", Stopped)
    code, out = run(["--updates=200", "--cases=2"], capsys)
    assert code == 0
    assert "stopped" in out
    assert "100 vehicle updates" in out


@pytest.mark.parametrize(
    ("argv", "word"),
    [
        (["--updates", "none"], "'none'"),
        (["--updates", "0"], "'0'"),
        (["--updates", "inf"], "'inf'"),
        (["--seed", "-1"], "--seed"),
        (["--num-envs", "0"], "--num-envs"),
        (["--case", "1"], "--environment"),
        (["--case", "1", "--environment", "256"], "--environment 256"),
        (["--json", "/no/such/folder/result.json"], "allowed a file"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(argv, word, capsys):
    """Before anything is compiled."""
    assert word in refused(soak.main, argv, capsys)

"""Both simulators on one road under one demand: their input, and the rows read from them."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.verification.validation import compare as command
from benchmarks.verification.validation.demands import DEMANDS, mean_demand, world
from benchmarks.verification.validation.measures import find
from benchmarks.verification.validation.medjax_side import SEEN, program, trajectories_from_slots
from benchmarks.verification.validation.published import RANGES, checks
from benchmarks.verification.validation.sumo_side import read, sumo
from benchmarks.verification.validation.trajectories import Bodies, Road
from medjax.episodes.keys import episode_keys
from tests.benchmarks.refusal import refused

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_demands_range_from_free_to_overloaded_traffic():
    """Vehicles/h behind the last of four ramps, as shares of four lanes of 2,000."""
    loads = [(each.mainline_per_h + 4 * each.ramp_per_h) / 8000.0 for each in DEMANDS.values()]
    assert loads == pytest.approx([0.45, 0.7125, 0.9, 1.0, 1.2, 1.2])


def test_a_rising_demand_rises_for_half_of_its_time():
    """From half of it, in the warm-up and at first, to all of it; 20 measured minutes are 40."""
    _, schedule = world(DEMANDS["rising"], 20)
    demands = [schedule.params_at(minute).demand for minute in range(schedule.all_minutes)]
    main, ramps = (
        np.stack(each)
        for each in zip(*((d.mainline_per_h, d.ramp_per_h) for d in demands), strict=True)
    )
    assert len(main) == 45
    assert main[:6] == pytest.approx(3800.0)
    assert np.diff(main[5:26]) == pytest.approx(190.0, rel=1e-4)
    assert main[25:] == pytest.approx(7600.0)
    assert ramps == pytest.approx(np.repeat(main[:, None] * 500.0 / 7600.0, 4, axis=1))
    assert mean_demand(schedule)["asked_main_per_h"] == pytest.approx(main[5:].mean())


def test_every_range_is_checked():
    """Values outside are told from those inside; only medjax has to reach this project's goals."""
    of_all = dict.fromkeys({each.figure for each in RANGES}, -7.5)
    figures = {name: {"medjax": of_all, "SUMO": of_all} for name in DEMANDS}
    found = checks(figures, figures)
    assert len(found) == len(RANGES)
    for check, each in zip(found, RANGES, strict=True):
        marks = {name: of["holds"] for name, of in check["measured"].items()}
        assert marks == {"medjax": False, "SUMO": None if each.is_goal else False}
        assert each.source
        assert each.low <= each.high
    assert 0 < sum(each.is_goal for each in RANGES) < len(RANGES)
    (drop,) = (each for each in RANGES if each.figure == "capacity_drop")
    assert [drop.holds(value) for value in (0.1, 0.2, np.nan)] == [True, False, None]


FCD = """timestep_time;vehicle_id;vehicle_type;vehicle_speed;vehicle_pos;vehicle_lane
60.00;;;;;
60.25;main0lane0.0;kind3;30.00;5.00;main0_1
60.25;ramp100lane0.0;kind1;20.00;15.00;ramp100_0
60.50;main0lane0.0;kind3;30.00;12.50;main0_1
60.50;ramp100lane0.0;kind1;20.00;0.00;main100_0
60.75;ramp100lane0.0;kind1;20.00;5.00;main100_1
"""


def test_sumos_table_becomes_rows(tmp_path):
    """Lanes count from the left, positions share one axis, ticks count from the end of the warm-up."""
    file = tmp_path / "fcd.csv"
    file.write_text(FCD)
    _, schedule = world(DEMANDS["paper"], 1)
    schedule = dataclasses.replace(schedule, warm_up_minutes=1)
    seen = read(file, schedule)
    assert seen.vehicle.tolist() == [0, 0, 1, 1, 1]
    assert seen.tick.tolist() == [1, 2, 1, 2, 3]
    assert seen.lane.tolist() == [2, 2, 4, 4, 3]
    assert seen.x.tolist() == [5.0, 12.5, 95.0, 100.0, 105.0]
    assert seen.speed.tolist() == [30.0, 30.0, 20.0, 20.0, 20.0]
    assert set(seen.length) == {5.0}
    assert seen.num_ticks == 240


def test_sumos_vehicles_move_by_their_speeds():
    """Positions change by the mean of two speeds (ballistic), over all edges and lanes."""
    pytest.importorskip("sumo")
    _, schedule = world(DEMANDS["merging"], 1)
    schedule = dataclasses.replace(schedule, warm_up_minutes=2)
    with sumo(schedule, 1, 0) as rows:
        (seen,) = rows
    on = seen.goes_on
    assert on.sum() > 10_000
    mean = 0.5 * (seen.speed[1:] + seen.speed[:-1])[on]
    assert np.diff(seen.x)[on] == pytest.approx(mean * seen.tick_s, abs=0.03)
    assert set(np.diff(seen.tick)[on]) == {1}
    assert np.abs(np.diff(seen.lane)[on]).max() == 1


@pytest.mark.thorough
def test_medjaxs_rows_agree_with_its_tally():
    """Vehicles, exits, lane changes and distance; the last tick of all is not among the rows."""
    env, schedule = world(DEMANDS["merging"], 1)
    params = schedule.params_at(0)
    start, minute = program(env)  # the command's, so that both tests share one compilation
    playing = start(episode_keys(0, 1), params)
    begun = int(playing.state.vehicles.active.sum())
    playing, ticks = minute(playing, jnp.int32(0), params)
    stats = jax.tree.map(lambda leaf: np.asarray(leaf)[0], playing.state.stats)
    slots = {name: np.asarray(ticks[name]).reshape(240, -1) for name in SEEN}
    places = Road.of(env.config, params), env.config.tick_s, Bodies.of(params)
    seen = trajectories_from_slots(slots, *places)
    found = find(seen, 30.0)
    assert len(np.unique(seen.vehicle)) == stats.entered.sum() > begun
    assert found.collisions == found.in_one_place == stats.collisions == 0
    assert 0 <= stats.left.sum() - found.left <= 3
    changes = found.changed.changes + len(found.merged.speed)
    assert 0 <= stats.lane_changes - changes <= 3
    assert changes > 50
    distance = np.diff(seen.x)[seen.goes_on].sum()
    assert distance == pytest.approx(stats.gas_distance_m[0], rel=0.01)


@pytest.mark.thorough
def test_the_command_measures_both_and_writes_what_it_prints(tmp_path, capsys):
    file, picture = tmp_path / "validation.json", tmp_path / "validation.png"
    argv = ["--demands", "paper", "--episodes", "1", "--minutes", "2"]
    command.main([*argv, "--json", str(file), "--plot", str(picture)])
    out = capsys.readouterr().out
    written = json.loads(file.read_text())
    ours, by_idm = (written["figures"]["paper"][name] for name in ("medjax", "medjax IDM"))
    # Near its desired speed IDM keeps more than its headway, so it drives more slowly than IDM+.
    assert by_idm["speed_last_mean"] < ours["speed_last_mean"] - 0.5
    assert "| paper, medjax | paper, medjax IDM |" in out
    # Five standard deviations of Poisson arrivals in two minutes.
    assert ours["entered_main_per_h"] == pytest.approx(2600.0, abs=5 * (2600.0 * 30) ** 0.5)
    assert ours["merges"] > 0
    assert ours["collisions"] == ours["in_one_place"] == 0
    assert ours["discharge"] is None
    assert f"| {ours['entered_main_per_h']:,.0f} |" in out
    assert picture.read_bytes().startswith(b"\x89PNG")
    diagram = written["diagram"]["paper"]["medjax"]
    assert np.shape(diagram["flow"]) == np.shape(diagram["density"]) == (1, len(diagram["x_m"]), 4)
    assert {check["demand"] for check in written["checks"]} == {"paper"}


@pytest.mark.parametrize(
    ("option", "word"),
    [("--minutes=0", "'0': allowed"), ("--demands=rush", "rush"), ("--plot=figure.pdf", ".png")],
)
def test_bad_input_is_one_line_and_code_2(option, word, capsys):
    assert word in refused(command.main, [option], capsys)

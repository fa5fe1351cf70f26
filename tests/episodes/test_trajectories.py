"""Trajectory files read back by pyarrow, pandas, SUMO's schema and SUMO's own tools."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import medjax.episodes.files
import medjax.episodes.recording
from medjax.episodes.files import write_trajectories
from medjax.episodes.table import KIND_NAMES, vehicle_table
from medjax.traffic.road import lateral_position
from medjax.trajectories import main
from medjax.world.params import PANELS

pytestmark = pytest.mark.usefixtures("quick_compiles")

WORLD = {
    "num_meds": 3,
    "num_evs": 12,
    "num_gas": 12,
    "mainline_per_h": 800,
    "ev_share": 0.4,
    "arrival_soc_high": 0.3,
    "episode_decisions": 90,
}
SET = [text for name, value in WORLD.items() for text in ("--set", f"{name}={value}")]


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """The recording that the command made, and the file that it wrote."""
    target = tmp_path_factory.mktemp("out") / "run.csv"
    made = []
    record = medjax.episodes.options.record_episode
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            medjax.episodes.options,
            "record_episode",
            lambda *args, **kwargs: made.append(record(*args, **kwargs)) or made[0],
        )
        asked = ["--policy", "paced", "--scenario", "paper", "--seed", "3", "--episode", "1"]
        assert main([*asked, *SET, "--out", str(target)]) == 0
    return made[0], target


@pytest.fixture(scope="module")
def recording(played):
    return played[0]


@pytest.fixture(scope="module")
def table(recording):
    return vehicle_table(recording)


def test_the_command_plays_the_episode_that_it_is_asked_for(played):
    recording, target = played
    assert (recording.policy, recording.scenario) == ("paced", "paper")
    assert (recording.seed, recording.episode) == (3, 1)
    assert {name: getattr(recording.config, name) for name in list(WORLD)[:3]} == {
        name: WORLD[name] for name in list(WORLD)[:3]
    }
    assert len(recording.decisions.action) == WORLD["episode_decisions"]
    assert [path.name for path in target.parent.iterdir()] == [target.name]


def test_a_row_for_each_vehicle_and_tick(recording, table):
    active = recording.frames.active
    rows = len(table["time_s"])
    ticks = recording.decisions.tally.vehicle_ticks.sum()  # the environment's own count
    assert rows == active.sum() == ticks + active[0].sum()
    times, counts = np.unique(table["time_s"], return_counts=True)
    present = active.sum(axis=1)
    np.testing.assert_array_equal(times, recording.time_s[present > 0])
    np.testing.assert_array_equal(counts, present[present > 0])


def test_an_id_is_one_vehicle_from_its_entry_to_its_exit(recording, table):
    ids = table["vehicle_id"].data
    tally = recording.decisions.tally
    assert len(np.unique(ids)) == recording.frames.active[0].sum() + tally.entered.sum()
    for number in np.unique(ids):
        own = ids == number
        ticks = np.diff(table["time_s"].data[own])
        np.testing.assert_allclose(ticks, recording.config.tick_s)
        assert len(np.unique(table["kind"].data[own])) == 1
        assert (np.diff(table["x_m"].data[own]) >= 0.0).all()
    first = np.unique(ids, return_index=True)[1]
    np.testing.assert_array_equal(
        np.flatnonzero(table["acceleration_m_per_s2"].mask), np.sort(first)
    )


def test_rows_are_the_recording(recording, table):
    frames, config = recording.frames, recording.config
    rng = np.random.default_rng(0)
    frame, slot = (rows := np.nonzero(frames.active))
    width = recording.params.road.lane_width_m
    y = lateral_position(frames.lane, frames.lateral_offset, width)
    np.testing.assert_allclose(table["lateral_m"], y[rows], rtol=1e-6)
    for row in rng.choice(len(frame), 300):
        f, s = frame[row], slot[row]
        got = {name: column[row] for name, column in table.items()}
        assert got["time_s"] == f * config.tick_s
        assert got["x_m"] == frames.x[f, s]
        assert got["speed_m_per_s"] == frames.speed[f, s]
        assert got["lateral_speed_m_per_s"] == frames.lateral_speed[f, s]
        ev = s - config.num_meds
        if s < config.num_meds:
            assert got["kind"] == "med"
            assert got["soc"] == frames.med_soc[f, s]
        elif ev < config.num_evs:
            human = frames.ev_is_human[f, ev]
            assert got["kind"] == ("human_ev" if human else "autonomous_ev")
            assert got["soc"] == frames.ev_soc[f, ev]
            assert got["is_charging"] == frames.ev_is_charging[f, ev]
        else:
            assert got["kind"] == "gas"
            assert got["soc"] is np.ma.masked


def test_bookings_name_a_med_that_is_on_the_road(recording, table):
    booked = ~np.ma.getmaskarray(table["booked_med_id"])
    assert booked.sum() == (recording.frames.ev_med >= 0).sum() > 0
    charging = table["is_charging"].data
    assert charging.sum() == recording.frames.ev_is_charging.sum() > 0
    assert (booked | ~charging).all()
    seen = zip(*(table[name].tolist() for name in ("time_s", "vehicle_id", "kind")), strict=True)
    kinds = {(time, number): kind for time, number, kind in seen}
    for row in np.flatnonzero(booked):
        assert kinds[table["time_s"][row], table["booked_med_id"][row]] == "med"
        assert table["panel"][row] in PANELS


def test_acceleration_is_the_change_of_speed(recording, table):
    ids, speed = table["vehicle_id"].data, table["speed_m_per_s"].data
    tick = recording.config.tick_s
    for number in np.unique(ids)[:20]:
        own = ids == number
        change = np.diff(speed[own].astype(float)) / tick
        np.testing.assert_allclose(table["acceleration_m_per_s2"][own][1:], change, atol=1e-4)


def test_parquet_reads_back_as_the_table(recording, table, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason='pip install "medjax[trajectories]"')
    path = tmp_path / "run.parquet"
    assert write_trajectories(recording, path) == len(table["time_s"])
    back = parquet.read_table(path)
    assert back.column_names == list(table)
    for name, column in table.items():
        mask = np.ma.getmaskarray(column)
        assert back[name].null_count == mask.sum()
        values = np.asarray(back[name].drop_null().to_pylist())
        np.testing.assert_array_equal(values, column.compressed())
    played = back.schema.metadata[b"medjax"].decode()
    assert '"scenario": "paper"' in played
    assert '"policy": "paced"' in played


def test_csv_reads_back_as_the_table(played, table):
    pandas = pytest.importorskip("pandas")
    back = pandas.read_csv(played[1], dtype={"booked_med_id": "Int64"})
    assert list(back.columns) == list(table)
    for name, column in table.items():
        mask = np.ma.getmaskarray(column)
        np.testing.assert_array_equal(back[name].isna(), mask)
        values = back[name][~mask].to_numpy()
        np.testing.assert_array_equal(values.astype(column.dtype), column.compressed())


@pytest.fixture(scope="module")
def fcd(recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("fcd") / "run.fcd.xml"
    assert write_trajectories(recording, path) == len(vehicle_table(recording)["time_s"])
    return path


@pytest.fixture
def sumo_home():
    return Path(pytest.importorskip("sumo", reason='pip install "medjax[peers]"').SUMO_HOME)


def run_tool(sumo_home, *command):
    """A tool of SUMO, in its own process; its output."""
    done = subprocess.run(
        [sys.executable, *map(str, command)],
        env={**os.environ, "SUMO_HOME": str(sumo_home), "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_fcd_is_valid_by_the_schema_of_sumo(fcd, sumo_home):
    etree = pytest.importorskip("lxml.etree", reason="pip install lxml")
    schema = etree.XMLSchema(etree.parse(sumo_home / "data" / "xsd" / "fcd_file.xsd"))
    document = etree.parse(fcd)
    assert schema.validate(document), schema.error_log
    document.getroot()[0][0].set("charge", "0.5")
    assert not schema.validate(document)  # it does look


def test_fcd_reads_back_by_sumos_converter(recording, table, fcd, sumo_home, tmp_path):
    run_tool(sumo_home, sumo_home / "tools/xml/xml2csv.py", fcd, "-o", tmp_path / "run.csv")
    with (tmp_path / "run.csv").open() as file:
        rows = list(csv.DictReader(file, delimiter=";"))
    rows = [row for row in rows if row["vehicle_id"]]
    assert len(rows) == len(table["time_s"])

    def column(name):
        return np.asarray([float(row[name]) for row in rows])

    np.testing.assert_allclose(column("timestep_time"), table["time_s"])
    np.testing.assert_array_equal(column("vehicle_id"), table["vehicle_id"])
    assert {row["vehicle_type"] for row in rows} <= set(KIND_NAMES)
    width = float(recording.params.road.lane_width_m)
    for name, expected in {
        "vehicle_x": table["x_m"],
        "vehicle_pos": table["x_m"],
        "vehicle_y": -table["lateral_m"] - width / 2,
        "vehicle_speed": table["speed_m_per_s"],
        "vehicle_posLat": -table["lane_offset_m"],
        "vehicle_speedLat": -table["lateral_speed_m_per_s"],
        "vehicle_acceleration": table["acceleration_m_per_s2"].filled(0.0),
    }.items():
        np.testing.assert_allclose(column(name), expected, atol=6e-4)


def test_fcd_lies_on_the_lanes_of_such_a_road_in_sumo(recording, fcd, sumo_home, tmp_path):
    sys.path.append(str(sumo_home / "tools"))
    sumolib = pytest.importorskip("sumolib")
    lanes = recording.config.num_lanes + 1
    length, width = (float(v) for v in (recording.params.road.length_m, 4.0))
    (tmp_path / "a.nod.xml").write_text(
        f'<nodes><node id="a" x="0" y="0"/><node id="b" x="{length}" y="0"/></nodes>'
    )
    (tmp_path / "a.edg.xml").write_text(
        f'<edges><edge id="highway" from="a" to="b" numLanes="{lanes}" width="{width}"/></edges>'
    )
    net = tmp_path / "a.net.xml"
    files = ["-n", tmp_path / "a.nod.xml", "-e", tmp_path / "a.edg.xml", "-o", net]
    binary = sumolib.checkBinary("netconvert", str(sumo_home / "bin"))
    subprocess.run([binary, *map(str, files)], check=True, capture_output=True)
    centres = {
        lane.getID(): lane.getShape()[0][1]
        for lane in sumolib.net.readNet(str(net)).getEdge("highway").getLanes()
    }
    seen = set()
    for step in sumolib.xml.parse(str(fcd), "timestep"):
        for vehicle in step.vehicle or ():
            y = centres[vehicle.lane] + float(vehicle.posLat)
            assert float(vehicle.y) == pytest.approx(y, abs=2e-3)
            seen.add(vehicle.lane)
    assert len(seen) >= recording.config.num_lanes


def test_fcd_is_drawn_by_sumos_plotter(fcd, sumo_home, tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "run.png"
    run_tool(sumo_home, sumo_home / "tools/plot_trajectories.py", "-t", "td", "-o", picture, fcd)
    assert picture.stat().st_size > 5000


def test_a_failed_write_leaves_the_old_file(recording, tmp_path, monkeypatch):
    path = tmp_path / "run.csv"
    path.write_text("old")

    def fails(recording, file):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setitem(medjax.episodes.files.FORMATS, ".csv", fails)
    with pytest.raises(OSError, match="No space left"):
        write_trajectories(recording, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--policy", "best"], "unknown policy 'best': allowed none, random"),
        (["--scenario", "papr"], "unknown scenario 'papr': allowed paper, realistic"),
        (["--out", "run.txt"], "run.txt: allowed endings .parquet, .csv, .fcd.xml"),
        (["--out", "nowhere/run.csv"], "no directory nowhere"),
        (["--seed", "-1"], "--seed '-1': allowed a whole number from 0 to 4294967295"),
        (["--set", "cooldown_s"], "--set cooldown_s: allowed NAME=VALUE"),
        (["--set", "cooldwn_s=1"], "unknown option 'cooldwn_s': did you mean"),
        (["--set", "cooldown_s=-1"], "cooldown_s = -1: allowed a number from 0 to 1e+06"),
        (["--pollicy", "none"], "unrecognized arguments: --pollicy none"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(change, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["--out", "run.csv", *change])
    assert end.value.code == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert message in line
    assert list(tmp_path.iterdir()) == []


def test_parquet_without_pyarrow_names_the_remedy(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(SystemExit) as end:
        main(["--out", str(tmp_path / "run.parquet")])
    assert end.value.code == 2
    assert 'pip install "medjax[trajectories]"' in capsys.readouterr().err

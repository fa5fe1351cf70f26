"""Floating-car data read back by SUMO's schema and SUMO's own tools."""

import csv
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from medjax.episodes.files import write_trajectories
from medjax.episodes.table import vehicle_table
from medjax.world.kinds import KINDS


@pytest.fixture(scope="module")
def fcd(played, recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("fcd") / "run.fcd.xml"
    assert write_trajectories(played[0], path) == len(vehicle_table(recording)["time_s"])
    return path


@pytest.fixture
def sumo_home():
    return Path(pytest.importorskip("sumo", reason='pip install -e ".[peers]"').SUMO_HOME)


def run_tool(sumo_home, *command):
    """Runs a tool of SUMO, which draws without a screen; returns its output."""
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


@pytest.mark.thorough
def test_fcd_is_valid_by_sumos_schema(fcd, sumo_home):
    etree = pytest.importorskip("lxml.etree", reason="pip install lxml")
    schema = etree.XMLSchema(etree.parse(sumo_home / "data" / "xsd" / "fcd_file.xsd"))
    document = etree.parse(fcd)
    assert schema.validate(document), schema.error_log
    document.getroot()[0][0].set("charge", "0.5")
    assert not schema.validate(document)


@pytest.mark.thorough
def test_fcd_reads_back_with_sumos_converter(recording, table, fcd, sumo_home, tmp_path):
    run_tool(sumo_home, sumo_home / "tools/xml/xml2csv.py", fcd, "-o", tmp_path / "run.csv")
    with (tmp_path / "run.csv").open() as file:
        rows = list(csv.DictReader(file, delimiter=";"))
    rows = [row for row in rows if row["vehicle_id"]]
    assert len(rows) == len(table["time_s"])

    def column(name):
        return np.asarray([float(row[name]) for row in rows])

    np.testing.assert_allclose(column("timestep_time"), table["time_s"])
    np.testing.assert_array_equal(column("vehicle_id"), table["vehicle_id"])
    assert {row["vehicle_type"] for row in rows} <= {kind.column for kind in KINDS}
    width = float(recording.params.road.lane_width_m)
    # SUMO has a vehicle in the lane beneath its centre, medjax in the lane that it changes to.
    right = table["lateral_m"].data / width
    lane = np.floor(right + 0.5)
    assert abs(table["lane_offset_m"]).max() > width / 2 + 1.0
    assert abs(column("vehicle_posLat")).max() <= width / 2 + 1e-3
    numbers = [int(row["vehicle_lane"].removeprefix("highway_")) for row in rows]
    np.testing.assert_array_equal(numbers, recording.config.num_lanes - lane)
    for name, expected in {
        "vehicle_x": table["x_m"],
        "vehicle_pos": table["x_m"],
        "vehicle_y": -table["lateral_m"] - width / 2,
        "vehicle_speed": table["speed_m_per_s"],
        "vehicle_posLat": (lane - right) * width,
        "vehicle_speedLat": -table["lateral_speed_m_per_s"],
        "vehicle_acceleration": table["acceleration_m_per_s2"].filled(0.0),
        "vehicle_slope": np.degrees(recording.params.road.slope),
    }.items():
        np.testing.assert_allclose(column(name), expected, atol=6e-4)


@pytest.fixture(scope="module")
def net(recording, tmp_path_factory):
    """The same road as a SUMO network file."""
    sumo_home = Path(pytest.importorskip("sumo", reason='pip install -e ".[peers]"').SUMO_HOME)
    tmp_path = tmp_path_factory.mktemp("net")
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
    binary = sumo_home / "bin" / "netconvert"
    subprocess.run([binary, *map(str, files)], check=True, capture_output=True)
    return net


@pytest.mark.thorough
def test_fcd_is_replayed_by_sumo(recording, fcd, net, sumo_home, tmp_path):
    """In the same lanes, except just after a change: SUMO places a vehicle up to two ticks late."""
    drivers = recording.params.drivers
    types = "".join(
        f'<vType id="{kind.column}" length="{length}" width="{width}"/>'
        for kind, length, width in zip(
            KINDS, drivers.vehicle_length, drivers.vehicle_width, strict=True
        )
    )
    (tmp_path / "types.add.xml").write_text(f"<additional>{types}</additional>")
    seen = tmp_path / "seen.xml"
    words = ["-n", net, "-a", tmp_path / "types.add.xml", "--device.fcd-replay.files", fcd]
    words += ["--step-length", recording.config.tick_s, "--lateral-resolution", 0.4]
    words += ["--fcd-output", seen, "--no-step-log", "true", "--no-warnings", "true", "--end", 91]
    command = [sumo_home / "bin" / "sumo", *words]
    subprocess.run(list(map(str, command)), check=True, capture_output=True, timeout=300)

    def lanes(file):
        return {
            (float(step.get("time")), vehicle.get("id")): vehicle.get("lane")
            for step in ElementTree.parse(file).getroot()
            for vehicle in step
        }

    ours, theirs = lanes(fcd), lanes(seen)
    both = ours.keys() & theirs.keys()
    assert len(both) > 0.95 * len(ours)
    assert sum(ours[row] != theirs[row] for row in both) < 0.003 * len(both)


def test_fcd_lies_on_sumos_lanes(recording, fcd, net, sumo_home):
    sys.path.append(str(sumo_home / "tools"))
    sumolib = pytest.importorskip("sumolib")
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


@pytest.mark.thorough
def test_fcd_is_drawn_by_sumos_plotter(fcd, sumo_home, tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "run.png"
    run_tool(sumo_home, sumo_home / "tools/plot_trajectories.py", "-t", "td", "-o", picture, fcd)
    assert picture.stat().st_size > 5000

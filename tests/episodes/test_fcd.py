"""Floating-car data read back by SUMO's schema and SUMO's own tools."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from medjax.episodes.files import write_trajectories
from medjax.episodes.table import vehicle_table
from medjax.world.kinds import KINDS

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.fixture(scope="module")
def fcd(played, recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("fcd") / "run.fcd.xml"
    assert write_trajectories(played[0], path) == len(vehicle_table(recording)["time_s"])
    return path


@pytest.fixture
def sumo_home():
    return Path(pytest.importorskip("sumo", reason='pip install -e ".[peers]"').SUMO_HOME)


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
    assert {row["vehicle_type"] for row in rows} <= {kind.column for kind in KINDS}
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

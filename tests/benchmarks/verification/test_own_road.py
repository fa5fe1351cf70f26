"""`benchmarks.road`: ways and times by hand, and free traffic on SUMO's Autobahn in both simulators, in closed form."""

import json
import sys

import numpy as np
import pytest
from scipy import integrate, stats

import medjax
from benchmarks.verification.own_road import compare
from benchmarks.verification.own_road.sides import times_of
from benchmarks.verification.own_road.ways import Way, ways_of, world
from medjax.traffic.demand import SPEED_SPREAD
from medjax.traffic.idm import IDM_PLUS
from medjax.world.kinds import GAS, LORRY
from medjax.world.sumo_net import motorway_of, read_network
from tests.benchmarks.refusal import refused
from tests.benchmarks.verification.validation.made import ROAD, drive, seen
from tests.world.test_sumo_net import CHAIN, net


def way(begin, until, end, before=None, after=None):
    return Way(begin, until, end, before, (), after, 1.0)


def test_ways_of_a_road_by_hand(tmp_path):
    """One vehicle in ten leaves by the exit at 1,200 m; who comes from the ramp at 1,707.5 m drives to the end."""
    file = net(tmp_path)
    network = read_network(file)
    road = medjax.read_sumo_net(file)
    _, params = world(road, 0.5, IDM_PLUS)
    found = ways_of(network, motorway_of(file, network, None), params)
    assert [each.along for each in found] == [tuple(CHAIN[:2]), tuple(CHAIN), tuple(CHAIN[3:])]
    assert [(each.before, each.after) for each in found] == [
        (None, "off"), (None, None), ("on", None),
    ]  # fmt: skip
    metres = [(each.begin_m, each.until_m, each.end_m) for each in found]
    np.testing.assert_allclose(
        metres, [(0, 1000, 1200), (0, 2757.5, 2757.5), (1707.5, 2757.5, 2757.5)]
    )
    # Half of 1,200 vehicles an hour and lane, and of 360 from the ramp.
    assert [each.per_h for each in found] == pytest.approx([120.0, 1080.0, 180.0])


def test_times_by_hand():
    """Of vehicles at 20 and 25 m/s: through, from a ramp, to an exit; one was there before, one is there at last."""
    ways = [way(0, 800, 1000, after="off"), way(0, 4000, 4000), way(500, 4000, 4000, before="on")]
    ramp = ROAD.num_lanes
    rows = seen(
        drive([1] * 640, 25.0, x=6.0, first_tick=9),  # to 4,000 m
        drive([ramp] * 20 + [2] * 680, 20.0, x=510.0, first_tick=9),  # to 4,005 m
        drive([2] * 180, 20.0, x=2.0, first_tick=3),  # to 897 m
        drive([0] * 640, 25.0, x=6.0, first_tick=0),
        drive([0] * 300, 20.0, x=6.0, first_tick=400),
        drive([0] * 640, 25.0, x=6.0, first_tick=500),
    )
    out, through, joined = times_of(rows, ways, 120.0)
    assert out == pytest.approx([40.0])
    assert through == pytest.approx([160.0])
    assert joined == pytest.approx([175.0])


def mean_pace(params, kind):
    """Mean of 1/v over desired speeds of a kind: a normal distribution that is cut off."""
    mean, spread = (
        float(each[kind])
        for each in (params.drivers.desired_speed, params.drivers.desired_speed_std)
    )
    cut = stats.truncnorm(-SPEED_SPREAD, SPEED_SPREAD, mean, spread)
    return integrate.quad(lambda v: cut.pdf(v) / v, *cut.support())[0]


@pytest.mark.thorough
def test_free_traffic_on_the_autobahn_drives_as_desired(tmp_path, capsys):
    """With few vehicles a way takes its length by desired speeds; SUMO's network and medjax's road agree on it."""
    pytest.importorskip("sumo")
    out = tmp_path / "road.json"
    compare.main(["--factors", "0.05", "--episodes", "4", "--minutes", "25", f"--json={out}"])
    assert "| 0.05 | 0 to 2,767 |" in capsys.readouterr().out
    rows = json.loads(out.read_text())["rows"]
    assert [row["begin_m"] for row in rows] == pytest.approx([0.0, 0.0, 1573.09])
    (through,) = (row for row in rows if row["end_m"] - row["begin_m"] > 2000.0)
    _, params = world(medjax.read_sumo_net(compare.autobahn()), 0.05, IDM_PLUS)
    share = float(params.demand.lorry_share)
    pace = (1.0 - share) * mean_pace(params, GAS) + share * mean_pace(params, LORRY)
    free_s = through["end_m"] * pace
    for name in compare.SIMULATORS:
        assert through[name]["vehicles"] == pytest.approx(180.0 * 0.9 * 25.0 / 60.0, rel=0.2)
        # IDM comes near a desired speed, but drivers hold back behind the slower ones.
        assert 0.0 < through[name]["mean_s"] - free_s < 0.06 * free_s


def test_a_way_without_vehicles_has_no_times():
    """Nobody in any episode: a dash in the table and null in the file, not 0 s; one episode has no interval."""
    nobody = compare.figures_of([np.array([]), np.array([])])
    assert nobody["vehicles"] == 0.0
    assert np.isnan([nobody[name] for name in ("mean_s", "half_width_s", "p95_s")]).all()
    once = compare.figures_of([np.array([]), np.array([30.0, 50.0])])
    assert (once["vehicles"], once["mean_s"]) == (1.0, 40.0)
    assert np.isnan(once["half_width_s"])


def test_bad_input_ends_the_command(tmp_path, capsys, monkeypatch):
    file = str(net(tmp_path))
    for argv, words in (
        ([str(tmp_path / "none.net.xml")], "none.net.xml"),
        ([file, "--edges", "first", "nowhere"], "edges has 'nowhere': allowed edges of"),
        ([file, "--factors", "-1"], "allowed a number from 0 to 5"),
    ):
        assert words in refused(compare.main, argv, capsys)
    monkeypatch.setitem(sys.modules, "sumo", None)
    assert "SUMO is not installed: allowed pip install" in refused(compare.main, [file], capsys)

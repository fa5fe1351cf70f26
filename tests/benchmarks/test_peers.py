"""Peers get medjax's road and demand, count their vehicles rightly, and are compared by medians."""

import dataclasses
import importlib.metadata
import itertools
import json
from xml.etree import ElementTree

import pytest

import medjax
from benchmarks.peers import Peer, Rate, World
from benchmarks.peers import __main__ as command
from benchmarks.peers.highway import SPAN_S, HighwayEnv, Traffic, build_road, move
from benchmarks.peers.sumo import Sumo
from benchmarks.peers.sumo_road import Period, build_demand, build_network, lanes_of_network
from tests.benchmarks.refusal import refused

SPAN = 150  # s; vehicles cross the road in about as long


@pytest.fixture(scope="module")
def workload(tmp_path_factory):
    env, params = medjax.make("paper", episode_decisions=SPAN)
    return World(
        env.config, params, num_vehicles=145, cores=1, folder=tmp_path_factory.mktemp("road")
    )


@pytest.fixture(scope="module")
def road(workload):
    """The network that SUMO loads: edges and connections by name."""
    pytest.importorskip("sumo")
    network = build_network(workload.config, workload.params, workload.folder)
    root = ElementTree.parse(network).getroot()
    edges = {edge.get("id"): edge for edge in root.iter("edge")}
    connections = [
        tuple(connection.get(key) for key in ("from", "fromLane", "to", "toLane"))
        for connection in root.iter("connection")
    ]
    return edges, connections


def follow(edges, name):
    """Edges in driving order from one, as (name, left end, length, lanes), left end from 0."""
    x, passed = 0.0, []
    while name:
        lanes = edges[name].findall("lane")
        (length,) = {float(lane.get("length")) for lane in lanes}
        passed.append((name, x, length, len(lanes)))
        x += length
        end = edges[name].get("to")
        onward = [other for other, edge in edges.items() if edge.get("from") == end]
        name = onward[0] if onward else None
    return passed


def test_network_has_the_length_lanes_and_merges_of_medjax(road, workload):
    """4000 m of four lanes, and a fifth for 250 m from each ramp."""
    edges, _ = road
    params = workload.params
    main = follow(edges, "main0")
    assert sum(length for _, _, length, _ in main) == pytest.approx(float(params.road.length_m))
    merges = [(x, length) for _, x, length, lanes in main if lanes == 5]
    wanted = [(float(x), float(params.road.acceleration_lane_m)) for x in params.road.ramp_x_m]
    assert merges == wanted
    assert {lanes for *_, lanes in main} == {4, 5}
    for name, x, *_ in main:
        assert name == f"main{x:g}"


def test_ramps_join_their_acceleration_lane_which_ends(road, workload):
    """The rightmost lane of a merge is fed by the ramp alone and leads nowhere; the others go on."""
    edges, connections = road
    for x in workload.params.road.ramp_x_m:
        merge, ramp = f"main{x:g}", f"ramp{x:g}"
        assert [lane.get("length") for lane in edges[ramp].findall("lane")] == ["20.00"]
        assert [c for c in connections if c[0] == ramp] == [(ramp, "0", merge, "0")]
        assert [c[0] for c in connections if c[2:] == (merge, "0")] == [ramp]
        assert {c[1] for c in connections if c[0] == merge} == {"1", "2", "3", "4"}
    names = [name for name, *_ in follow(edges, "main0")]
    for left, right in itertools.pairwise(names):
        assert len([c for c in connections if c[0] == left and c[2] == right]) == 4


def test_names_of_lanes_give_their_start_and_number(road, workload):
    """Each lane of the network, where it starts, and 0 for the leftmost; 4 beside a ramp and on it."""
    edges, _ = road
    named = lanes_of_network(workload.config, workload.params)
    starts = {name: x for name, x, *_ in follow(edges, "main0")}
    starts |= {f"ramp{x:g}": x - 20.0 for x in workload.params.road.ramp_x_m}
    expected = {}
    for name, x in starts.items():
        lanes = [lane.get("id") for lane in edges[name].findall("lane")]  # from the right
        rightmost = 4 if len(lanes) != 4 else 3
        expected |= {lane: (x, rightmost - index) for index, lane in enumerate(lanes)}
    assert named == expected


def test_demand_and_drivers_are_those_of_medjax(workload):
    """Flows add up to the demand, kinds to its shares; drivers have the numbers of docs/parameters.md."""
    whole = Period(0.0, 2.0 * SPAN + 1.0, workload.params)
    demand = build_demand(workload.config, [whole], workload.folder)
    root = ElementTree.parse(demand).getroot()
    rates = {flow.get("id"): float(flow.get("period")[4:-1]) * 3600 for flow in root.iter("flow")}
    main = [rate for name, rate in rates.items() if name.startswith("main")]
    ramps = [rate for name, rate in rates.items() if name.startswith("ramp")]
    assert main == pytest.approx([650.0] * 4, rel=1e-4)
    assert ramps == pytest.approx([250.0] * 4, rel=1e-4)
    kinds = _, _, gas, lorry = list(root.iter("vType"))
    shares = [float(kind.get("probability")) for kind in kinds]
    assert shares == pytest.approx([0.06, 0.06, 0.88, 0.0])
    assert [float(kind.get("tau")) for kind in kinds] == pytest.approx([1.4, 1.2, 1.4, 2.0])
    names = ("minGap", "accel", "decel", "emergencyDecel", "length")
    assert [float(gas.get(name)) for name in names] == pytest.approx([2.0, 1.4, 2.0, 9.0, 5.0])
    assert float(lorry.get("length")) == 16.5
    assert {kind.get("carFollowModel") for kind in kinds} == {"IDM"}


@pytest.fixture(scope="module")
def sumo(workload):
    pytest.importorskip("sumo")
    return Sumo(workload)


@pytest.mark.thorough
def test_sumo_counts_the_vehicles_that_it_writes(sumo, workload):
    """Its rate counts the vehicles of its own trajectories, which are about as many as medjax's."""
    trajectories = workload.folder / "fcd.xml"
    assert sumo.resume(0, "--fcd-output", str(trajectories)).wait() == 0
    rate = sumo.read(0)
    steps = ElementTree.parse(trajectories).getroot().findall("timestep")
    assert len(steps) == SPAN / workload.config.tick_s
    written = sum(len(step.findall("vehicle")) for step in steps)
    assert rate.mean_active_vehicles == pytest.approx(written / len(steps), rel=1e-3)
    # Five standard deviations of the Poisson arrivals that share the road.
    assert written / len(steps) == pytest.approx(145, abs=60)


def test_sumo_demand_flows_in_and_nobody_collides(sumo, workload):
    """Vehicles ask at the rate of the demand, few wait to enter, none collides."""
    rate = sumo.measure()
    assert rate.active_vehicle_updates_per_s > 1e4
    root = ElementTree.parse(workload.folder / "road0.statistics.xml").getroot()
    vehicles = {name: int(value) for name, value in root.find("vehicles").attrib.items()}
    expected = 4000 / 3600 * 2 * SPAN
    assert vehicles["loaded"] == pytest.approx(expected, abs=5 * expected**0.5)
    assert vehicles["waiting"] <= 15
    assert root.find("safety").get("collisions") == "0"


def test_highway_env_moves_every_vehicle_on_the_road():
    """As many as asked, in all lanes, moved as far as their speed says, none leaves while timed."""
    pytest.importorskip("highway_env")
    traffic = Traffic(4000.0, 4, 20, 0.25, 30.0, 2.0)
    road = build_road(traffic, seed=0)
    before = [vehicle.position[0] for vehicle in road.vehicles]
    ticks = round(SPAN_S / traffic.tick_s)
    assert {vehicle.lane_index[2] for vehicle in road.vehicles} == {0, 1, 2, 3}
    assert move(road, traffic, ticks) == 20 * ticks
    travelled = [vehicle.position[0] - x for vehicle, x in zip(road.vehicles, before, strict=True)]
    assert min(travelled) > 15.0 * SPAN_S
    assert max(travelled) < 40.0 * SPAN_S
    road.vehicles[0].position[0] = traffic.length_m + 1.0
    assert move(road, traffic, 1) == 19  # who is off the road does not count


@pytest.mark.thorough
def test_highway_env_measures_in_processes(workload):
    """Every process adds its rate; the number of vehicles is one road's."""
    pytest.importorskip("highway_env")
    rate = HighwayEnv(dataclasses.replace(workload, num_vehicles=12, cores=2)).measure()
    assert rate.mean_active_vehicles == 12
    assert rate.active_vehicle_updates_per_s > 0


def scripted(peer_name, distribution, figures, log):
    """A peer whose measurements are given."""

    class Scripted(Peer):
        name, package, differences = peer_name, distribution, (f"{peer_name} is scripted.",)

        def __init__(self, *_):
            self.left = iter(figures)

        def measure(self):
            log.append(peer_name)
            return Rate(next(self.left), 100.0)

    return Scripted


def test_rounds_alternate_and_ratios_are_of_medians():
    """Median of three, and medjax's median by each."""
    log = []
    ours = scripted("ours", "medjax", [80.0, 120.0, 90.0], log)()
    other = scripted("other", "numpy", [3.0, 1.0, 2.0], log)()
    rates = command.alternate([ours, other], 3)
    assert log == ["ours", "other"] * 3
    results = command.summarise([ours, other], rates)
    assert results["ours"]["active_vehicle_updates_per_s"] == 90.0
    assert results["ours"]["medjax_ratio"] == 1.0
    assert results["other"]["active_vehicle_updates_per_s"] == 2.0
    assert results["other"]["medjax_ratio"] == 45.0
    assert results["other"]["rounds"] == [3.0, 1.0, 2.0]
    assert results["other"]["version"] == importlib.metadata.version("numpy")


def test_missing_peer_is_named_and_skipped(monkeypatch, capsys, tmp_path):
    """The others are measured all the same, and the file says so too."""
    log = []
    ours = scripted("medjax", "medjax", [50.0] * 3, log)
    absent = scripted("absent", "medjax-no-such-peer", [], log)
    present = scripted("present", "numpy", [10.0] * 2, log)
    monkeypatch.setattr(command, "Medjax", ours)
    monkeypatch.setattr(command, "PEERS", (absent, present))
    file = tmp_path / "peers.json"
    command.main(["--rounds", "2", "--json", str(file)])
    out, err = capsys.readouterr()
    assert 'absent: not installed, skipped (pip install -e ".[peers]")\n' in err
    assert "present is scripted." in out
    assert log.count("present") == 2
    written = json.loads(file.read_text())
    assert written["skipped"] == ["absent", "HighJax"]
    assert set(written["simulators"]) == {"medjax", "present"}
    assert written["simulators"]["present"]["medjax_ratio"] == 5.0


def interpreter(path, lines):
    """A program that stands for a Python with HighJax: it prints `lines` and leaves its arguments beside itself."""
    path.write_text("#!/bin/sh\nshift 2\necho $* >> $0.asked\n" + lines)
    path.chmod(0o755)
    return str(path)


def test_highjax_is_timed_in_its_own_python(monkeypatch, capsys, tmp_path):
    """With as many vehicles as medjax has, and as many as its default; what differs is told once for both."""
    ours = scripted("medjax", "medjax", [50.0] * 2, [])
    monkeypatch.setattr(command, "Medjax", ours)
    monkeypatch.setattr(command, "PEERS", ())
    answer = """echo '{"version": "9.9", "updates_per_s": 5.0}'\n"""
    python, file = interpreter(tmp_path / "python", answer), tmp_path / "peers.json"
    command.main(["--rounds", "1", "--highjax", python, "--json", str(file)])
    asked = (tmp_path / "python.asked").read_text().splitlines()
    assert [line.split()[:2] for line in asked if line] == [["100", "16"], ["51", "16"]]
    written = json.loads(file.read_text())["simulators"]
    assert written["HighJax, 51"]["version"] == "9.9"
    assert written["HighJax, 51"]["mean_active_vehicles"] == 51
    assert written["HighJax, 100"]["medjax_ratio"] == 10.0
    assert capsys.readouterr().out.count("square of their number") == 1


@pytest.mark.parametrize(
    ("lines", "why"),
    [(None, "it does not start"), ("echo No module named highjax >&2; exit 1\n", "No module")],
)
def test_a_python_without_highjax_is_refused(lines, why, capsys, tmp_path):
    """No program, or one that fails: a line that says why, and how to install it."""
    python = tmp_path / "python"
    if lines:
        interpreter(python, lines)
    line = refused(command.main, [f"--highjax={python}"], capsys)
    assert why in line
    assert "allowed: the Python of python3.13 -m venv" in line


@pytest.mark.parametrize(
    ("option", "word"),
    [
        ("--rounds=0", "'0': allowed"),
        ("--num-envs=many", "'many': allowed"),
        ("--json=/no/such/folder/peers.json", "allowed a file"),
        ("--frobnicate", "--frobnicate"),
    ],
)
def test_bad_input_is_one_line_and_code_2(option, word, capsys):
    assert word in refused(command.main, [option], capsys)

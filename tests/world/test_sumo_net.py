"""A road read from a network of SUMO: by hand, of a road that netconvert built, and of the Autobahn that SUMO ships."""

import warnings

import numpy as np
import pytest

import medjax
from medjax.errors import InputError

# Two lanes; an exit with a deceleration lane of 200 m, then a ramp with an acceleration lane of 250 m; and a short
# motorway beside it.
EDGES = {
    "first": ("highway.motorway", 2, 1000.0, 30.0),
    "slow": ("highway.motorway", 3, 200.0, 30.0),
    "between": ("highway.motorway", 2, 500.0, 30.0),
    "fast": ("highway.motorway", 3, 250.0, 30.0),
    "last": ("highway.motorway", 2, 800.0, 30.0),
    "off": ("highway.motorway_link", 1, 100.0, 20.0),
    "on": ("highway.motorway_link", 1, 100.0, 20.0),
    "other": ("highway.motorway", 2, 900.0, 25.0),
}
WAYS = (
    *(("first", "slow"), ("slow", "between"), ("slow", "off"), ("between", "fast")),
    *(("on", "fast"), ("fast", "last")),
)
CHAIN = ["first", "slow", "between", "fast", "last"]
INSIDE_M = 7.5  # of the lane inside the junction before `between`


def net(folder, edges=EDGES, ways=WAYS):
    """The network as netconvert writes it."""
    rows = [
        f'<edge id=":b" function="internal"><lane id=":b_0" speed="30" length="{INSIDE_M}"/></edge>'
    ]
    for name, (kind, lanes, length, speed) in edges.items():
        each = "".join(
            f'<lane id="{name}_{i}" index="{i}" speed="{speed}" length="{length}"/>'
            for i in range(lanes)
        )
        rows.append(f'<edge id="{name}" from="a" to="b" type="{kind}">{each}</edge>')
    for first, then in ways:
        via = ' via=":b_0"' if (first, then) == ("slow", "between") else ""
        rows.append(f'<connection from="{first}" to="{then}" fromLane="0" toLane="0"{via}/>')
    file = folder / "road.net.xml"
    file.write_text("<net>" + "".join(rows) + "</net>")
    return file


@pytest.fixture(autouse=True)
def warnings_are_errors():
    """A warning that no test expects fails it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_a_road_by_hand(tmp_path):
    """The longest motorway, found or given; places are sums of lanes' lengths, with the one inside a junction."""
    expected = {
        "length_m": 2750.0 + INSIDE_M,
        "num_lanes": 2,
        "ramp_x_m": [1700.0 + INSIDE_M],
        "exit_x_m": [1200.0],
        "desired_speed": [23.6, 30.0, 30.0, 30.0, 23.6],
        "acceleration_lane_m": 250.0,
        "exit_lane_m": 200.0,
    }
    file = net(tmp_path)
    assert medjax.read_sumo_net(file) == expected
    assert medjax.read_sumo_net(str(file), edges=CHAIN) == expected
    assert medjax.read_sumo_net(file, edges=["other"])["desired_speed"][1] == 25.0


def test_a_preset_takes_the_road_and_what_is_given_beside_it(tmp_path):
    """What is given beside it comes first."""
    road = medjax.read_sumo_net(net(tmp_path))
    env, params = medjax.make(
        "corridor", road=road, length_m=3000, demand={"mainline_per_h": 1800.0}, num_gas=50
    )
    assert (env.config.num_lanes, env.config.num_ramps, env.config.num_exits) == (2, 1, 1)
    assert float(params.road.length_m) == 3000.0
    np.testing.assert_allclose(params.road.ramp_x_m, [1707.5])
    assert float(params.road.exit_lane_m) == 200.0
    assert float(params.demand.mainline_per_h) == 1800.0
    assert dict(env.recipe.overrides)["num_lanes"] == 2


def test_lorries_of_a_preset_stay_slow():
    """On `freight` EVs are lorries, which no limit for cars makes faster; on `corridor` they are cars."""
    road = {"desired_speed": [23.6, 36.1, 36.1, 36.1, 23.6]}
    slow, fast = (medjax.scenarios.prepare(name, road=road)[1] for name in ("freight", "corridor"))
    np.testing.assert_allclose(slow.drivers.desired_speed, [23.6, 23.6, 23.6, 36.1, 23.6])
    np.testing.assert_allclose(fast.drivers.desired_speed, [23.6, 36.1, 36.1, 36.1, 23.6])


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"last": ("highway.motorway", 4, 800.0, 30.0)}, "more than 2 lanes and one beside them"),
        ({"last": ("highway.motorway", 2, 800.0, 20.0)}, "its limits are 20 to 30 m/s"),
        ({"fast": ("highway.motorway", 2, 250.0, 30.0)}, "its acceleration lanes are 0 m long"),
    ],
)
def test_what_does_not_fit_is_said(tmp_path, changed, said):
    with pytest.warns(UserWarning, match=said):
        medjax.read_sumo_net(net(tmp_path, EDGES | changed))


def test_what_is_no_road_is_refused(tmp_path):
    """One line: what it is, and what is allowed."""
    file = net(tmp_path)
    for edges, said in (
        (["first", "nowhere"], "edges has 'nowhere': allowed edges of"),
        (["first", "between"], "edge 'between' after 'first': allowed one of slow"),
        (["last", "first"], "edge 'first' after 'last': allowed one of none"),
        ([], "edges = []: allowed names of edges in driving order"),
        (5, "edges = 5: allowed names"),
        ([5], "edges has 5: allowed edges"),
    ):
        with pytest.raises(InputError, match=said.replace("[", r"\[")) as raised:
            medjax.read_sumo_net(file, edges=edges)
        assert "\n" not in str(raised.value)
    streets = {name: ("highway.primary", *rest) for name, (_, *rest) in EDGES.items()}
    with pytest.raises(InputError, match=r"no edge of type highway\.motorway: allowed a network"):
        medjax.read_sumo_net(net(tmp_path, streets))
    for text in ("", "<net", "<routes/>", '<net><edge id="a"/></net>', "<net><edge/></net>"):
        file.write_text(text)
        with pytest.raises(InputError, match=r"road\.net\.xml: (cannot be read|allowed a network)"):
            medjax.read_sumo_net(file)
    with pytest.raises(InputError, match="file"):
        medjax.read_sumo_net(tmp_path / "nothing.net.xml")
    with pytest.raises(InputError, match="road = 3: allowed numbers by name, as of read_sumo_net"):
        medjax.make("paper", road=3)


def test_a_ring_ends_where_it_began(tmp_path):
    ring = {name: EDGES[name] for name in ("first", "between", "last")}
    ways = (("first", "between"), ("between", "last"), ("last", "first"))
    assert medjax.read_sumo_net(net(tmp_path, ring, ways))["length_m"] == 2300.0


def test_what_netconvert_built_of_a_preset_is_read_back(tmp_path):
    """`paper`'s road as the peers drive on it: 4 km, four lanes, four ramps with lanes of 250 m, no exit."""
    pytest.importorskip("sumo")
    from benchmarks.peers.sumo_road import build_network, lanes_of_network

    env, params = medjax.make("paper")
    file = build_network(env.config, params, tmp_path)
    names = {
        lane.rpartition("_")[0]: x for lane, (x, _) in lanes_of_network(env.config, params).items()
    }
    chain = sorted((name for name in names if name.startswith("main")), key=names.get)
    road = medjax.read_sumo_net(file, edges=chain)
    assert road["length_m"] == pytest.approx(4000.0)
    assert road["num_lanes"] == 4
    np.testing.assert_allclose(road["ramp_x_m"], params.road.ramp_x_m)
    assert road["acceleration_lane_m"] == pytest.approx(250.0)
    assert road["exit_x_m"] == []


def test_the_autobahn_that_sumo_ships():
    """A 10 at Koenigs Wusterhausen: OpenStreetMap's places, which add up from the edges' lengths but for junctions."""
    sumo = pytest.importorskip("sumo")
    road = medjax.read_sumo_net(f"{sumo.SUMO_HOME}/tools/game/A10KW/osm.net.xml")
    assert road["num_lanes"] == 3
    assert road["length_m"] == pytest.approx(1197.37 + 139.89 + 226.05 + 195.39 + 995.18, abs=15.0)
    assert road["exit_x_m"] == [pytest.approx(1197.37 + 139.89, abs=5.0)]
    assert road["ramp_x_m"] == [pytest.approx(1197.37 + 139.89 + 226.05, abs=12.0)]
    assert (road["exit_lane_m"], road["acceleration_lane_m"]) == (139.89, 195.39)
    assert road["desired_speed"][1] == 27.78
    _, params = medjax.make("corridor", road=road, num_evs=60, num_gas=160)
    assert float(params.road.length_m) == pytest.approx(road["length_m"])

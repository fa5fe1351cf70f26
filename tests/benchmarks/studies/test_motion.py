"""Rules of motion: the default is the dispatcher alone, and others move MEDs otherwise."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.studies import motion
from medjax.env.forecast import Need
from medjax.episodes.scores import evaluate_policies
from medjax.policies.rules import BASELINES
from medjax.world.state import IN_SERVICE
from tests.benchmarks.refusal import refused

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"size": 3, "num_evs": 8, "num_gas": 12, "mainline_per_h": 600.0, "episode_decisions": 40}


@pytest.fixture
def small(monkeypatch):
    """Presets as small as they can be, and three rules of motion."""
    make = medjax.make_agents
    monkeypatch.setattr(medjax, "make_agents", lambda name, **how: make(name, **SMALL, **how))
    names = ("default", "14 m/s", "only who needs it")
    monkeypatch.setattr(motion, "MOTIONS", {name: motion.MOTIONS[name] for name in names})
    return names


def test_table_and_file(small, tmp_path, capsys):
    """The default gains nothing on itself and is the dispatcher's own score; a slow MED is another world."""
    out = tmp_path / "out.json"
    motion.main(["--episodes=2", "--seed=3", f"--json={out}", "--motions", *small[1:]])
    rows = {row["motion"]: row for row in json.loads(out.read_text())["rows"]}
    assert tuple(rows) == small
    printed = capsys.readouterr().out
    assert all(name in printed for name in small)
    assert rows["default"]["gain"] == 0.0
    named = medjax.make_agents("paper", speeds=motion.SPEEDS)
    single = named.env.env
    alone = {"budgeted": BASELINES["budgeted"](single)}
    scores = evaluate_policies(single, named.params, alone, 2, 3)["budgeted"]
    assert rows["default"]["return"] == pytest.approx(np.mean(scores["return"]), rel=1e-5)
    assert rows["14 m/s"]["gain"] != 0.0
    assert scores["invalid_actions"].max() == 0.0


@pytest.fixture(scope="module")
def exits(quick_compiles):
    """Agents on a road with exits and depots, their numbers, and a first state."""
    named = medjax.make_agents("corridor", **SMALL, speeds=motion.SPEEDS, num_depots=5)
    _, state = jax.jit(named.env.reset)(jax.random.key(0), named.params)
    return named.env, named.params, state


def test_every_rule_says_what_is_allowed(exits):
    """On a road with exits, of parts that are in their spaces, one for each agent."""
    agents, params, state = exits
    rules = {name: rule for name, rule in motion.MOTIONS.items() if name != "default"}
    said = jax.jit(lambda *now: {name: rule(agents, *now) for name, rule in rules.items()})
    for name, parts in jax.device_get(said(state, params)).items():
        for part, space in zip(parts, agents.actions.parts, strict=True):
            assert part.shape == (3,), name
            assert ((part >= 0) & (part < space.n)).all(), name


def test_a_world_of_ones_own(small, tmp_path, capsys):
    """Slots without power send nothing: what is left of a motion's worth is slow driving."""
    out = tmp_path / "out.json"
    argv = ["--episodes=2", "--set=charging.slot_power_w=0", f"--json={out}"]
    motion.main([*argv, "--motions", "default"])
    result = json.loads(out.read_text())
    assert result["overrides"] == ["charging.slot_power_w=0"]
    assert [row["ev_received_kwh"] for row in result["rows"]] == [0.0]
    assert "paper, charging.slot_power_w=0, 2 episodes" in capsys.readouterr().out


def test_bad_input_is_one_line(capsys):
    assert "no_such" in refused(motion.main, ["--set=no_such=3"], capsys)
    assert "speeds" in refused(motion.main, ["--set=speeds=3"], capsys)
    assert "nowhere" in refused(motion.main, ["--scenario=nowhere"], capsys)
    assert "sideways" in refused(motion.main, ["--motions", "sideways"], capsys)


@pytest.mark.parametrize(
    ("name", "chosen"),
    [("nearest depot", [4, 0, 5]), ("emptiest depot", [2, 0, 2]), ("depot in need", [3, 0, 3])],
)
def test_where_rules_go_home_to(exits, name, chosen, monkeypatch):
    """Three MEDs of the first depot leave at exits before ramps 4 and 5; for the second of them it is too late."""
    agents, params, state = exits
    put = {
        "x": [19_000.0, 20_650.0, 25_000.0],
        "destination": [20_700.0, 20_700.0, 26_700.0],
        "active": True,
    }
    vehicles = state.vehicles.replace(
        **{
            field: getattr(state.vehicles, field).at[:3].set(jnp.array(value))
            for field, value in put.items()
        }
    )
    first = jnp.zeros(3, jnp.int32)
    meds = state.meds.replace(depot=first, status=first + IN_SERVICE)
    state = state.replace(vehicles=vehicles, meds=meds)
    nobody = jnp.zeros(5)
    monkeypatch.setattr(
        motion, "expected_need", lambda *_: Need(nobody.at[2].set(9.0), nobody, nobody, nobody)
    )
    leave = motion.MOTIONS[f"to the {name}"](agents, state, params).leave
    assert leave.tolist() == chosen
    home = motion.MOTIONS["home when idle"](agents, state, params).leave
    assert set(home.tolist()) <= {0, 1}

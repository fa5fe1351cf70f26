"""The map of break-even: chosen without luck, priced without playing again, and resumed where it was interrupted."""

import json

import numpy as np
import pytest

import medjax
from benchmarks.studies.worth.axes import Axis, points, read_axes, world_at
from benchmarks.studies.worth.command import dispatchers_of, main
from benchmarks.studies.worth.drawing import edges, panels_of
from benchmarks.studies.worth.played import Kept, fingerprint
from benchmarks.studies.worth.verdicts import at_prices, gains, judge
from benchmarks.verification.golden import TRIPS
from medjax.episodes.scores import evaluate_policies
from medjax.errors import InputError
from medjax.policies.rules import BASELINES, Budget, budgeted
from tests.benchmarks.refusal import refused
from train.algorithms.ppo.settings import PPOConfig
from train.runs.run_directory import RunDir
from train.runs.versions import versions

pytestmark = pytest.mark.usefixtures("quick_compiles")
SMALL = [f"--set={name}={json.dumps(value)}" for name, value in TRIPS.items()]
SMALL += ["--set=episode_decisions=30", "--scenario=corridor", "--episodes=4"]
MAP = ["--vary=slot_power_w=20e3,190e3", "--vary=reward_weights.charging_stops=-18,-90"]


def test_a_learners_initial_policy_is_no_dispatcher_to_choose():
    policies = dict.fromkeys(["ppo", "ppo_seed2", "start", *BASELINES])
    assert {*dispatchers_of(policies)} == {"ppo", "ppo_seed2", "greedy", "budgeted"}


def test_luck_in_choosing_is_no_gain():
    """Of twenty dispatchers who differ by chance alone the luckiest gains nothing, and who gains 1 gains 1."""
    rng, episodes = np.random.default_rng(0), 400
    returns = {f"rule {number}": rng.normal(0.0, 1.0, episodes) for number in range(20)}
    returns |= {"none": np.zeros(episodes), "slow": np.full(episodes, -1.0)}
    names = [*returns][:20]
    lucky = max(returns[name].mean() for name in names)
    gain = gains(returns, names, ["none", "slow"])
    error = episodes**-0.5
    assert lucky > 1.25 * error
    assert abs(gain.mean()) < error
    returns["rule 7"] += 1.0
    assert gains(returns, names, ["none", "slow"]).mean() == pytest.approx(1.0, abs=3 * error)


def test_a_verdict_by_hand():
    """Two dispatchers and two controls whose episodes are all alike: EUR of half an hour, and what else they did."""
    quiet = dict.fromkeys(("energy_delivered_kwh", "low_exits", "ev_delay_h", "gas_delay_h"), 0.0)
    slow = {"low_exits": 8.0, "ev_delay_h": 0.5, "gas_delay_h": 0.25}
    greedy = {"energy_delivered_kwh": 70.0, "ev_delay_h": 1.5, "gas_delay_h": 2.0}
    of = {
        "none": {**quiet, "return": -100.0, "reward_ev_kwh": -40.0, "low_exits": 9.0},
        "slow": {**quiet, "return": -90.0, "reward_ev_kwh": -30.0, **slow},
        "greedy": {**quiet, "return": -95.0, "reward_ev_kwh": -5.0, **greedy},
        "other": {**quiet, "return": -99.0, "reward_ev_kwh": -20.0, "ev_delay_h": 2.0},
    }
    scores = {
        name: {metric: np.full(6, value) for metric, value in score.items()}
        for name, score in of.items()
    }
    found = judge(scores, ("none", "slow"), {"ev_kwh": 1.0}, 0.5, seed=0)
    assert (found.best, found.control, found.pays) == ("greedy", "slow", "no")
    assert (found.gain_mean, *found.gain_ci95) == (-10.0, -10.0, -10.0)
    # At twice the price of a kWh slow has -120, greedy -100.
    found = judge(scores, ("none", "slow"), {"ev_kwh": 2.0}, 0.5, seed=0)
    assert (found.gain_mean, found.pays, found.kwh, found.stops_spared) == (
        40.0,
        "yes",
        140.0,
        16.0,
    )
    assert found.delay_h == (1.0 + 1.75) / 0.5  # of EVs and of gas vehicles


def test_points_are_all_combinations_and_valid_worlds():
    axes = read_axes([], "freight")
    every = [*points(axes)]
    assert len(every) == 108 == len({tuple(point.values()) for point in every})
    env, params = medjax.make("freight")
    world = world_at(env.config, params, every[-1])
    assert float(world.charging.slot_power_w) == 190e3
    assert float(world.demand.ev_share) == pytest.approx(0.3)
    assert world.reward_weights == params.reward_weights


def test_the_line_lies_between_cases_that_pay_and_others():
    pays = np.array([[False, True], [False, False]])
    assert {*edges(pays)} == {((0.5, -0.5), (0.5, 0.5)), ((0.5, 0.5), (1.5, 0.5))}
    assert not [*edges(np.ones((3, 4), bool))]


def test_a_map_that_was_interrupted_goes_on(tmp_path):
    """However often; a file of other numbers, options or contents is refused and stays as it is."""
    about, path = {"scenario": "freight"}, tmp_path / "kept.json"
    scores = {"none": {"return": np.array([1.0, 2.5])}}
    for key in "abc":
        Kept(path, about).put(key, scores)
    found = Kept(path, about).found
    assert [*found] == ["a", "b", "c"]
    np.testing.assert_array_equal(found["b"]["none"]["return"], [1.0, 2.5])
    before = path.read_bytes()
    with pytest.raises(InputError, match="holds another map"):
        Kept(path, {"scenario": "corridor"})
    assert path.read_bytes() == before
    for text in ("no map\n", "[]", '{"about": {}}', before.decode()[:-20]):
        path.write_text(text)
        with pytest.raises(InputError, match="allowed a new file, or one that --keep wrote"):
            Kept(path, about)
        assert path.read_text() == text


def test_numbers_of_worlds_and_policies_tell_maps_apart():
    env, params = medjax.make("freight")
    rules = {"budgeted": budgeted(env)}
    other = {"budgeted": budgeted(env, Budget())}
    busier = params.replace(demand=params.demand.replace(mainline_per_h=params.demand.start_s))
    every = [fingerprint(*each) for each in ((params, rules), (params, other), (busier, rules))]
    assert len({*every}) == 3
    assert fingerprint(params, {"budgeted": budgeted(env)}) == every[0]


def test_what_changes_the_controls_is_played_with_them():
    """Slow EVs drive at the service speed; power, coils and fleet concern MEDs alone."""
    of_meds = ("slot_power_w", "link.load_ohm", "fleet.size", "med.mass_kg")
    assert all(Axis(name, (1.0,)).is_of_meds for name in of_meds)
    others = ("service_speed", "fleet.service_speed", "request_soc", "ev_share", "ev.mass_kg")
    assert not any(Axis(name, (1.0,)).is_of_meds for name in others)


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--scenario=paper"], "--scenario paper: its reward is not in money, allowed one of"),
        (["--vary=slot_power_w=x"], "--vary 'slot_power_w=x': allowed NAME=NUMBER,NUMBER"),
        (["--vary=slot_power=1"], "--vary 'slot_power': allowed a number of docs/parameters.md"),
        (["--vary=ev_share=0.1,2"], "ev_share = 2"),
        (["--vary=reward_weights.tow=1"], "--vary reward_weights.tow: allowed one of"),
        (["--vary=reward_weights.ev_kwh=nan"], "reward_weights.ev_kwh = nan"),
        (["--vary=episode_decisions=60"], "--vary 'episode_decisions': allowed a number of"),
        (["--vary=ev_share=0.1", "--vary=ev_share=0.2"], "--vary ev_share is given twice"),
    ],
)
def test_bad_maps_are_refused(argv, words, capsys):
    assert words in refused(main, argv, capsys)


def test_a_run_of_agents_is_refused_before_anything_is_played(tmp_path, capsys):
    run = RunDir(tmp_path / "run")
    run.claim(PPOConfig(scenario="freight", agents="ippo").for_episodes(360)).close()
    argv = [f"--run-dir={run.path}"]
    assert "is of agents, allowed: of a dispatcher" in refused(main, argv, capsys)


@pytest.mark.parametrize("option", ["--json", "--plot"])
@pytest.mark.parametrize("other", ["map.png", "../{}/map.png"])
def test_the_file_that_is_kept_is_not_overwritten(option, other, tmp_path, capsys):
    file, same = tmp_path / "map.png", tmp_path / other.format(tmp_path.name)
    argv = [*SMALL, f"--keep={file}", f"{option}={same}"]
    assert "is also a file of results, allowed: one of its own" in refused(main, argv, capsys)
    assert not file.exists()


@pytest.mark.thorough
def test_the_command(tmp_path, capsys, monkeypatch):
    """Returns at another price are those of a world with that price, and the second run plays nothing again."""
    report, kept = tmp_path / "worth.json", tmp_path / "kept.json"
    argv = [*SMALL, *MAP, f"--keep={kept}", f"--json={report}", f"--plot={tmp_path / 'map.png'}"]
    main(argv)
    printed = capsys.readouterr().out
    first = json.loads(report.read_text())
    assert first["conclusion"] in printed
    assert (tmp_path / "map.png").stat().st_size > 10_000
    every = json.loads(kept.read_text())["played"]
    assert len(every) == 2 + 1  # two powers for rules, once for those that send no MED
    assert json.loads(kept.read_text())["about"]["versions"] == versions() == first["versions"]
    prices = {"charging_stops": -90.0}
    env, params = medjax.make(
        "corridor", **TRIPS, episode_decisions=30, slot_power_w=190e3, reward_weights=prices
    )
    rules = {name: medjax.BASELINES[name](env) for name in ("greedy", "budgeted")}
    dearer = evaluate_policies(env, params, rules, 4, 0)
    played = next(scores for key, scores in every.items() if "190000" in key)
    for name, score in dearer.items():
        own = {metric: np.array(values) for metric, values in played[name].items()}
        np.testing.assert_allclose(
            at_prices(own, {"charging_stops": 5.0}), score["return"], rtol=1e-5
        )
    monkeypatch.setattr("benchmarks.studies.worth.played.Evaluation", None)
    main(argv)
    assert json.loads(report.read_text()) == first
    capsys.readouterr()
    monkeypatch.setattr("benchmarks.studies.worth.command.versions", lambda: {"jax": "0.0.1"})
    assert "holds another map" in refused(main, argv, capsys)  # another version may play otherwise
    (panel,) = panels_of(first)
    assert panel.x == Axis("slot_power_w", (20e3, 190e3))
    assert panel.gain.shape == (2, 2)
    assert first["cells"][0]["gain_mean"] == panel.gain[0, 0]

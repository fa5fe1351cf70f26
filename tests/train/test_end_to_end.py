"""The command on the real environment, as small as it gets."""

import json

import pytest

import medjax
from medjax.policies.saved import load_policy
from tests.train.conftest import refused
from tests.train.runs.test_session import assert_same_run, rows_of
from train import evaluate, export, ppo

pytestmark = pytest.mark.usefixtures("quick_compiles")

TERMS = [*medjax.TERMS, "served"]
SMALL = {"num_meds": 2, "num_evs": 6, "num_gas": 12, "episode_decisions": 12}


CHANGES = [f"--set={name}={value}" for name, value in SMALL.items()]


def assert_card(card, run):
    """The card of a policy says what the run's directory says."""
    settings = json.loads((run / "config.json").read_text())
    played = json.loads((run / "evaluation.json").read_text())
    assert (card["settings"], card["versions"]) == (settings["config"], settings["versions"])
    assert card["plays"] == "the most probable action"
    assert card["evaluation"]["episodes"] == played["episodes"]
    for name, entry in played["policies"].items():
        own = card["evaluation"]["policies"][name]
        assert own == {number: entry[number] for number in ("return_mean", "return_ci95")}


def test_train_and_evaluate(tmp_path, capsys):
    run = tmp_path / "run"
    argv = ["--num-envs=8", "--num-minibatches=8", "--total-timesteps=256", "--decide-every=2"]
    argv += ["--rollout-length=8", "--hidden", "8"]
    # Evaluations play the preset, whatever demands were trained on.
    argv += [f"--run-dir={run}", "--eval-episodes=4", "--demand-range", "0.5", "1.5"]
    argv += ["--reward=tests.train.own_parts:served", "--set", "reward_weights.served=0.25"]
    argv += CHANGES
    assert ppo.main(argv) == 0
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert [row["update"] for row in rows] == [1, 2]
    assert all(row["loss"] is not None for row in rows)
    assert rows[-1]["episode_length"] == 6.0  # choices
    assert rows[-1]["episode_collisions"] == 0.0
    for row in rows:  # terms of the reward, which add up to the return
        parts = [value for name, value in row.items() if name.startswith("episode_reward_")]
        assert len(parts) == len(TERMS)
        assert sum(parts) == pytest.approx(row["episode_return"], rel=1e-4)
    # The same episodes again, with the seed of the closing evaluation.
    out = tmp_path / "out.json"
    picture = tmp_path / "out.png"
    written = [f"--json={out}", f"--plot={picture}"]
    assert evaluate.main([f"--run-dir={run}", "--episodes=4", *written]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    result = json.loads(out.read_text())
    rules = "none slow random periodic paced greedy forecast budgeted"
    learned = {"ppo", "ppo_sampled", "start", "start_sampled"}
    assert set(result["policies"]) == {*learned, *rules.split()}
    for entry in result["policies"].values():
        parts = [entry[f"reward_{term}"] for term in TERMS]
        assert entry["reward_served"] == pytest.approx(0.25 * entry["evs_served"], rel=1e-4)
        assert sum(parts) == pytest.approx(entry["return_mean"], rel=1e-4)
    assert result["policies"]["none"]["meds_dispatched"] == 0.0
    assert result["policies"]["random"]["invalid_actions"] == 0.0
    for name in ("depleted_share", "mean_range_m", "mean_soc", "meds_dispatched"):
        assert name in result["policies"]["ppo"]
    assert result == json.loads((run / "evaluation.json").read_text())
    about = load_policy(run / "policy.zip").about
    assert (about.scenario, dict(about.overrides)) == ("paper", SMALL)  # without the custom reward
    assert_card(about.training, run)
    out = capsys.readouterr().out
    assert "MEDs sent" in out
    heading = next(line for line in out.splitlines() if line.startswith("return from"))
    assert {"soc", "distance", "speed"} <= {*heading.split()}
    assert "gas_delay" not in heading  # weighs nothing here
    (run / "evaluation.json").write_text("{}")
    refused(capsys, [f"--run-dir={run}"], "cannot read", "evaluation.json", command=export)


@pytest.mark.slow
def test_the_highway_trains_the_same_however_it_is_driven(tmp_path, monkeypatch):
    """In chunks of one update and of as many as allowed, with other checkpoints, evaluated or not."""
    argv = ["--num-envs=8", "--num-minibatches=8", "--total-timesteps=2048", "--decide-every=2"]
    argv += ["--rollout-length=8", "--hidden", "8", *CHANGES]
    one = ["--updates-per-call=1", "--eval-episodes=0", "--checkpoint-interval=3"]
    assert ppo.main([*argv, *one, f"--run-dir={tmp_path / 'one'}"]) == 0
    monkeypatch.setattr("train.runs.session.SECONDS_PER_CALL", 1e9)
    many = ["--checkpoint-interval=0", "--eval-episodes=4"]
    assert ppo.main([*argv, *many, f"--run-dir={tmp_path / 'many'}"]) == 0
    assert len(rows_of(tmp_path / "one")) == 16
    assert_same_run(tmp_path / "one", tmp_path / "many")


def test_real_presets_refuse_bad_input(tmp_path, capsys):
    for option, *words in (
        ("--scenario=nowhere", "nowhere", "paper"),
        ("--set=cooldown=3", "cooldown"),
        ("--set=cooldown_s=-3", "cooldown_s", "-3"),
        ("--set=cooldown_s=nan", "cooldown_s", "nan"),
        ("--set=num_lanes=0", "num_lanes", "0"),
        ("--set=size=99", "size", "99"),
        ("--set=num_evs=many", "num_evs", "many"),
        ("--set=ramp_x_m=[1, 2]", "ramp_x_m"),
        ("--set=ramp_x_m=9999", "ramp_x_m", "9999"),
    ):
        refused(capsys, [option, f"--run-dir={tmp_path / 'run'}"], *words)
    assert list(tmp_path.iterdir()) == []

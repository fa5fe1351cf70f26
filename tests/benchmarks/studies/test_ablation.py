"""Worlds in one program score and train as each does alone, and the commands report them."""

import dataclasses
import itertools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.studies.ablation import __main__ as ablation
from benchmarks.studies.ablation.side_by_side import (
    in_world,
    play_worlds,
    train_learners,
    train_worlds,
)
from benchmarks.studies.base import RULES, rules
from medjax.episodes.scores import evaluate_policies
from medjax.numerics.devices import environment_mesh
from medjax.physics import link_efficiency, mutual_inductance
from tests.benchmarks.refusal import refused
from train import ppo
from train.algorithms.algorithm import TrainState
from train.algorithms.finite import BAD, QUANTITIES
from train.algorithms.ppo.settings import PPOConfig
from train.algorithms.programs import make_train
from train.runs.policies import load_policies
from train.runs.run_directory import RunDir

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"num_meds": 2, "num_evs": 6, "num_gas": 12, "episode_decisions": 20}
SET_SMALL = [f"--set={name}={value}" for name, value in SMALL.items()]


@pytest.fixture
def run(monkeypatch):
    """The command; it leaves the user's cache alone."""
    monkeypatch.setattr(ablation, "enable_compilation_cache", lambda: None)
    return ablation.main


def assert_same_scores(ours, theirs):
    assert set(ours) == set(theirs)
    for metric, values in ours.items():
        np.testing.assert_allclose(values, theirs[metric], rtol=1e-5, atol=1e-5, err_msg=metric)


@pytest.mark.slow
def test_worlds_side_by_side_score_as_alone():
    """Of one world and of several, to rounding; and without MEDs every rule does what none does."""
    env, params = medjax.make("paper", **SMALL, cooldown_s=5.0)  # time for both MEDs
    policies = rules(env, ("none", "random", "paced"))
    expected = evaluate_policies(env, params, policies, 5, seed=3)  # of 2 MEDs
    for sizes in ([2], [0, 1, 2]):
        numbers = {"fleet.size": np.array(sizes)}
        scores = play_worlds(env, params, numbers, policies, episodes=5, seed=3)
        for name in policies:
            assert_same_scores(in_world(scores[name], -1), expected[name])
            assert scores[name]["return"].shape == (len(sizes), 5)
    for name in policies:
        assert_same_scores(in_world(scores[name], 0), in_world(scores["none"], 0))
    sent = scores["random"]["meds_dispatched"].mean(axis=1)
    np.testing.assert_array_equal(sent, [0.0, 1.0, 2.0])


@pytest.mark.thorough
def test_without_misalignment_every_link_is_nominal():
    """Then the share that arrives is that of coils face to face, and over the episodes more than with misalignment."""
    env, params = medjax.make("paper", num_gas=20, episode_decisions=240)
    numbers = {"link.misalignment_scale": np.array([0.0, 1.0, 2.0])}
    score = play_worlds(env, params, numbers, rules(env, ["paced"]), episodes=4, seed=3)["paced"]
    sent = score["energy_delivered_kwh"] + score["energy_lost_kwh"]
    assert (sent > 0.1).all()
    arrives = score["energy_delivered_kwh"] / sent
    nominal = link_efficiency(
        mutual_inductance(0.35, 0.30, 0.2, 0.0, 0.0, primary_turns=10, secondary_turns=10),
        load=10.0,
        primary_resistance=0.159,
        secondary_resistance=0.126,
        angular_frequency=2 * np.pi * 85e3,
    )
    np.testing.assert_allclose(arrives[0], float(nominal), atol=1e-4)
    # Not in every episode: panels that wander towards each other couple better than nominal ones.
    total = score["energy_delivered_kwh"].sum(axis=1) / sent.sum(axis=1)
    assert total[0] > total[1] > total[2]


def test_a_learner_that_does_not_stay_finite_is_named():
    """Even if its numbers recover; the others go on."""

    @dataclasses.dataclass(frozen=True)
    class Learner:
        """Its loss is not finite in one update."""

        bad_at: jax.Array
        mesh = environment_mesh(1, 1)
        state = TrainState

        def init(self, key, params):
            return TrainState(jnp.zeros(2), jnp.zeros((1, 1)), key, jnp.int32(0))

        def update(self, state, params):
            bad = jnp.where(state.update == self.bad_at, QUANTITIES.index("loss"), len(QUANTITIES))
            return state.replace(update=state.update + 1), {"episode_return": 1.0, BAD: bad}

    learned = train_learners(
        lambda own: Learner(own["bad_at"]),
        lambda given, _: given,
        jax.random.split(jax.random.key(0), 3),
        {"bad_at": np.array([9.0, 1.0, 2.0])},
        None,
        3,
    )
    np.testing.assert_array_equal(learned.finite, [True, False, False])
    np.testing.assert_array_equal(learned.curve, np.ones((3, 3)))


@pytest.mark.slow
def test_learners_side_by_side_train_as_alone():
    """Equal rewards teach the same; each learner is that of train.ppo, to rounding."""
    env, params = medjax.make("paper", **SMALL)
    sizes = {"num_envs": 4, "num_minibatches": 2, "rollout_length": 4, "hidden": (8,)}
    config = PPOConfig(**sizes, decide_every=2, total_timesteps=64, seed=5)
    costs = np.array([30.0, 30.0, 0.0])
    learned = train_worlds(env, params, {"reward_weights.dispatches": -costs}, config)
    programs = make_train(env, params, config)
    for cost, index in ((30.0, 0), (0.0, 2)):
        _, alone = medjax.make("paper", **SMALL, reward_weights={"dispatches": -cost})
        state = programs.init(jax.random.key(5), alone)
        state, _ = programs.run(state, alone, jnp.int32(config.num_updates))
        leaves = map(jax.tree.leaves, (learned, state.weights))
        for ours, theirs in zip(*leaves, strict=True):
            np.testing.assert_allclose(ours[index], theirs, rtol=1e-4, atol=1e-5)
            np.testing.assert_array_equal(ours[0], ours[1])
    first = learned.params["params"]["logits_head"]["kernel"]
    assert not np.allclose(first[0], first[2], atol=1e-4)


@pytest.mark.slow
def test_sweep_command(run, tmp_path, capsys):
    """A row for each policy and value in print and as JSON, and a picture; a trained run joins the rules."""
    path, out, plot = tmp_path / "run", tmp_path / "out.json", tmp_path / "plot.png"
    tiny = ["--num-envs=4", "--num-minibatches=2", "--rollout-length=2", "--hidden", "4"]
    tiny += ["--total-timesteps=64", "--eval-episodes=0", f"--run-dir={path}", *SET_SMALL]
    assert ppo.main(tiny) == 0
    capsys.readouterr()
    options = ["--stochastic", "--episodes=3", "--seed=4", f"--json={out}", f"--plot={plot}"]
    run(["cooldown", "--values", "9", "0", f"--run-dir={path}", *options])
    report = json.loads(out.read_text())
    printed = capsys.readouterr().out
    rows = {(row["policy"], row["value"]): row for row in report["rows"]}
    assert set(rows) == set(itertools.product(("ppo", "start", *RULES), (9, 0)))
    for (name, value), row in rows.items():
        assert any(line.split()[:2] == [name, str(value)] for line in printed.splitlines())
        assert row["return_ci95"][0] <= row["return"] <= row["return_ci95"][1]
        assert row["return_change"] == pytest.approx(row["return"] - rows[name, 9]["return"])
    assert report["number"] == "fleet.cooldown_s"
    assert plot.read_bytes().startswith(b"\x89PNG")

    env, params, policies = load_policies(path, RunDir(path).load_config())
    params = params.replace(fleet=params.fleet.replace(cooldown_s=jnp.float32(9)))
    alone = evaluate_policies(env, params, {"ppo": policies["ppo_sampled"]}, 3, seed=4)["ppo"]
    assert rows["ppo", 9]["return"] == pytest.approx(alone["return"].mean(), rel=1e-5)


@pytest.mark.slow
def test_weights_command(run, tmp_path, capsys):
    """A row for each reward, then one for each rule, and a picture."""
    out, plot = tmp_path / "out.json", tmp_path / "plot.png"
    costs = ["--dispatches", "0", "20", "--gas-delay", "0.1", "--decisions=1"]
    run(["weights", *costs, "--episodes=2", f"--json={out}", f"--plot={plot}", *SET_SMALL])
    report = json.loads(out.read_text())
    learned = [row for row in report["rows"] if row["policy"] == "ppo"]
    assert [(row["dispatches"], row["gas_delay"]) for row in learned] == [(0, 0), (20, 0), (0, 0.1)]
    assert [row["policy"] for row in report["rows"]][3:] == list(RULES)
    printed = capsys.readouterr().out
    assert f"{report['decisions']} decisions of each learner" in printed
    assert plot.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("argv", "named"),
    [
        (["colour"], "colour"),
        (["humans", "--values", "1.5"], "1.5"),
        (["humans", "--values", "nan"], "nan"),
        (["fleet", "--values", "2.5"], "2.5"),
        (["fleet", "--values", "16"], "16"),
        (["fleet", "--values", "1e30"], "size"),
        (["cooldown", "--values", "-1"], "-1"),
        (["cooldown", "--set", "nothing=1"], "nothing"),
        (["cooldown", "--run-dir", "nowhere"], "nowhere"),
        (["cooldown", "--stochastic"], "--stochastic without --run-dir"),
        (["misalignment", "--plot", "plot.pdf"], "plot.pdf"),
        (["weights", "--dispatches", "--gas-delay"], "--gas-delay"),
        (["weights", "--decisions", "0"], "'0'"),
    ],
)
def test_bad_input_is_one_line(argv, named, run, capsys):
    """Exit code 2, and the value is named."""
    assert named in refused(run, argv, capsys)

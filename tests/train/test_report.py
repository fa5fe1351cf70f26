"""The report of a run on the real environment, as small as it gets: what it shows is what the evaluation says."""

import base64
import contextlib
import io
import json
from html.parser import HTMLParser
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from matplotlib.image import imread

import train.reporting.contents
from tests.train.test_arguments import refused
from train import evaluate, report
from train.arguments import parse_request
from train.evaluation.tables import claim_rows, paper_rows
from train.reporting.diagrams import _in_bins
from train.reporting.figures import plot_curve
from train.reporting.survey import SOC_BINS, dispatch_rows, quantile, survey, total
from train.reporting.traces import Frame, Trace
from train.runs.checkpoint import to_host
from train.runs.start import open_session

pytestmark = pytest.mark.usefixtures("quick_compiles")

EPISODES = 4
SMALL = {"num_meds": 3, "num_evs": 6, "num_gas": 12, "episode_decisions": 12}
# So many EVs with so little energy that some run out in every episode, and a policy that sends whenever it may.
SMALL |= {"ev_share": 0.9, "battery_scale": 600, "cooldown_s": 3}
OPTIONS = ["--num-envs=8", "--num-minibatches=8", "--decide-every=2", "--initial-wait=0.01"]
OPTIONS += ["--hidden", "8"]
for name, value in SMALL.items():
    OPTIONS += ["--set", f"{name}={value}"]


def make_run(path):
    """A run that has not trained: its first weights, and a made-up curve."""
    session = open_session(parse_request([*OPTIONS, f"--run-dir={path}"]))
    state = session.programs.init(jax.random.key(0), session.params)
    session.checkpoints.save(to_host(state), session.config)
    rows = [
        {"update": n, "env_steps": 100 * n, "episode_return": value, "episodes": 1.0}
        for n, value in enumerate((None, -3.0, 2.0), 1)
    ]
    session.run_dir.metrics.write_text("".join(json.dumps(row) + "\n" for row in rows))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run, its report, and what passed through the command on the way."""
    run = tmp_path_factory.mktemp("report") / "run"
    make_run(run)
    traces, marked, out = [], [], io.StringIO()
    record, plot_episode = train.reporting.contents.record, train.reporting.contents.plot_episode
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out):

        def keep(*arguments):
            for trace in record(*arguments):
                traces.append(trace)
                yield trace

        patch.setattr("train.reporting.contents.record", keep)
        patch.setattr(
            "train.reporting.contents.plot_episode", lambda *a: marked.append(plot_episode(*a))
        )
        patch.setattr(
            "train.reporting.traces.EPISODES_AT_ONCE", 3
        )  # a whole part and one that is not
        code = report.main([f"--run-dir={run}", f"--episodes={EPISODES}", "--seed=2"])
    whole = jax.tree.map(lambda *parts: np.concatenate(parts), *traces)
    return SimpleNamespace(
        run=run, code=code, out=out.getvalue(), traces=traces, trace=whole, marked=marked[0]
    )


@pytest.fixture(scope="module")
def scores(made):
    """What `train.evaluation.scores` says of the same episodes, an array `(episodes,)` each metric and policy."""
    from train.evaluation.scores import evaluate_policies
    from train.runs.run_directory import RunDir
    from train.runs.trained_run import load_policies

    env, params, policies = load_policies(made.run, RunDir(made.run).load_config(), False)
    return evaluate_policies(env, params, policies, EPISODES, seed=2)


class Page(HTMLParser):
    """Headings, pictures and whatever refers to something outside."""

    def __init__(self, text):
        super().__init__()
        self.headings, self.pictures, self.outside, self.tag = [], [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tag = tag
        for name, value in attributes:
            if tag == "img" and name == "src":
                self.pictures.append(value)
            elif name in ("src", "href", "srcset", "data"):
                self.outside.append(value)

    def handle_data(self, data):
        if self.tag == "h2" and data.strip():
            self.headings.append(data)


def test_pictures_and_page_are_complete(made):
    assert made.code == 0
    there = made.run / "report"
    names = [f"{name}.png" for name in train.reporting.contents.PICTURES]
    assert sorted(path.name for path in there.iterdir()) == sorted(
        [*names, "evaluation.json", "report.html"]
    )
    text = (there / "report.html").read_text()
    page = Page(text)
    assert page.outside == []
    assert "http" not in text
    assert "url(" not in text
    for heading in ("Figure 7", "Table 2", "Figure 8", "One episode", "State of charge", "Where"):
        assert any(heading in found for found in page.headings), heading
    assert len(page.pictures) == len(names)
    for name, source in zip(names, page.pictures, strict=True):
        data = (there / name).read_bytes()
        assert base64.b64decode(source.removeprefix("data:image/png;base64,")) == data
        pixels = imread(there / name)
        assert min(pixels.shape[:2]) > 300
        assert pixels[..., :3].std() > 0.05  # something is drawn


def test_a_trace_is_the_episode_that_the_evaluation_counts(made, scores):
    for index, (name, score) in enumerate(scores.items()):
        trace = jax.tree.map(lambda leaf, index=index: leaf[:, index], made.trace)
        np.testing.assert_allclose(trace.reward.sum(axis=1), score["return"], rtol=1e-4, atol=1e-3)
        np.testing.assert_array_equal(trace.depleted.sum(axis=1), score["evs_depleted"])
        np.testing.assert_array_equal((trace.sent > 0).sum(axis=1), score["meds_dispatched"])
        assert name != "none" or not trace.sent.any()
    assert scores["ppo"]["evs_depleted"].sum() > 0
    assert scores["ppo"]["meds_dispatched"].min() > 0
    first = {"sent": "meds_dispatched", "depleted": "evs_depleted"}
    assert made.marked == {mark: scores["ppo"][metric][0] for mark, metric in first.items()}


def test_vehicles_of_a_trace_drive_forward_and_lose_or_gain_charge(made):
    frames = made.trace.frames
    stays = frames.ev_on_road[:, :, :-1] & frames.ev_on_road[:, :, 1:]
    assert stays.any()
    moved = np.diff(frames.ev_x, axis=2)[stays]
    assert (moved >= 0.0).all()
    assert moved.max() < 50.0
    assert ((frames.ev_soc >= 0.0) & (frames.ev_soc <= 1.0)).all()
    assert (frames.med_on_road[:, :, 0] == False).all()  # noqa: E712
    assert (frames.med_charges.max(axis=(0, 2, 3)) <= 4).all()


def test_the_survey_adds_up(made, scores):
    seen = total([survey(trace) for trace in made.traces])
    assert seen.episodes == EPISODES
    for index, score in enumerate(scores.values()):
        assert seen.depleted[index] == score["evs_depleted"].sum()
        assert seen.sent[index].sum() == score["meds_dispatched"].sum()
    on_road = made.trace.frames.ev_on_road
    np.testing.assert_array_equal(seen.soc.sum(axis=-1), on_road.sum(axis=(0, 3)))
    np.testing.assert_allclose(seen.need, made.trace.need.sum(axis=0), rtol=1e-4, atol=1e-4)
    table = dispatch_rows(list(scores), seen)
    ppo = dict(zip(table[0], table[1], strict=True))
    assert ppo["policy"] == "ppo"
    assert float(ppo["MEDs sent"]) == pytest.approx(scores["ppo"]["meds_dispatched"].mean())


def test_table_2_is_the_evaluation(made, tmp_path):
    out = tmp_path / "out.json"
    argv = [f"--run-dir={made.run}", f"--episodes={EPISODES}", "--seed=2", f"--json={out}"]
    assert evaluate.main(argv) == 0
    result = json.loads(out.read_text())
    assert json.loads((made.run / "report" / "evaluation.json").read_text()) == result
    page = (made.run / "report" / "report.html").read_text()
    for name, theirs in (
        ("ppo", "0.340 (0.141)"),
        ("random", "-332.4 (53.95)"),
        ("none", "-521.9 (16.53)"),
        ("greedy", "-"),
    ):
        row = page.split(f"<tr><td>{name}</td><td>{theirs}</td><td>")[1]
        mean, std = (float(text) for text in row.split(")")[0].split(" ("))
        assert mean == pytest.approx(result["policies"][name]["return_mean"], rel=1e-3, abs=1e-3)
        assert std == pytest.approx(result["policies"][name]["return_std"], rel=1e-3, abs=1e-3)
        assert theirs in made.out


def test_bad_options_are_refused(made, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = sorted(made.run.rglob("*"))
    for argv, words in (
        ([], ["--run-dir"]),
        (["--run-dir=absent"], ["absent", "not a directory"]),
        (["--run-dir=."], ["config.json", "cannot read"]),
        ([f"--run-dir={made.run}", "--episodes=1"], ["--episodes '1'", "from 2"]),
        ([f"--run-dir={made.run}", "--episodes=many"], ["--episodes 'many'", "a whole number"]),
        ([f"--run-dir={made.run}", "--seed=-1"], ["--seed '-1'", "from 0"]),
        ([f"--run-dir={made.run}", "--set", "cooldown_s=3"], ["--set"]),
    ):
        refused(capsys, argv, *words, command=report)
    assert list(tmp_path.iterdir()) == []
    assert sorted(made.run.rglob("*")) == before
    settings = (made.run / "config.json").read_text()
    (tmp_path / "config.json").write_text(settings)
    refused(capsys, ["--run-dir=."], "holds no checkpoint", command=report)
    (tmp_path / "report").write_text("precious")
    refused(capsys, ["--run-dir=."], "report", "not a directory", command=report)
    assert (tmp_path / "report").read_text() == "precious"


def test_tables_of_several_training_seeds():
    entry = {"return_mean": 1.0, "return_std": 2.0, "return_ci95": [0.5, 1.5]}
    seeds = {"return_means": [1.0, 3.0], "interquartile_mean": 2.0, "ci95": [1.0, 3.0]}
    change = {"mean": -0.5, "ci95": [-0.625, -0.375]}
    result = {
        "policies": {
            "ppo": entry | {"meds_dispatched": 2.0},
            "none": entry | {"return_mean": -7.0},
        },
        "training_seeds": seeds,
        "change_against_none": {"depleted_share": change},
    }
    result["policies"]["ppo_seed2"] = entry | {"return_mean": 3.0, "meds_dispatched": 4.0}
    rows = paper_rows(result)
    assert [row[0] for row in rows[1:4]] == ["ppo_seed2", "ppo", "none"]
    assert rows[-1][1:] == ["-", "2.000", "[1.000, 3.000]"]
    claims = {row[0]: row[1:] for row in claim_rows(result)}
    assert claims["depleted share"] == ["-50%", "-50.0% [-62.5%, -37.5%]"]
    assert claims["mean SoC"] == ["+20%", "-"]
    assert claims["MEDs sent"] == ["15", "3.00"]


def trace_by_hand():
    """One policy, two EV slots, three decisions: an EV leaves with half its charge, one runs out, a third enters."""
    on_road = np.array([[1, 1], [0, 1], [1, 0], [1, 0]], bool)
    soc = np.array([[0.6, 0.1], [0.505, 0.05], [0.7, 0.0], [0.6, 0.0]])
    frames = Frame(
        ev_x=np.zeros((4, 2)),
        ev_soc=soc,
        ev_on_road=on_road,
        med_x=np.zeros((4, 1)),
        med_on_road=np.zeros((4, 1), bool),
        med_charges=np.zeros((4, 1), int),
    )
    need = np.array([[1.0, 3.0], [2.0, 0.5], [1.0, 1.0]])
    trace = Trace(frames, np.array([2, 0, 1]), need, np.zeros(3), np.array([0.0, 1.0, 0.0]))
    return jax.tree.map(lambda leaf: leaf[None, None], trace)


def test_a_survey_by_hand():
    seen = survey(trace_by_hand())
    assert seen.depleted.tolist() == [1.0]
    assert np.flatnonzero(seen.exit_soc[0]).tolist() == [50]
    assert seen.soc.sum(axis=-1).tolist() == [[2, 1, 1, 1]]
    assert seen.sent[0].tolist() == [[0, 1], [0, 0], [1, 0]]
    assert seen.need_there.tolist() == [3.0 + 1.0]
    assert seen.to_greatest.tolist() == [2]
    twice = total([seen, seen])
    assert twice.episodes == 2
    assert dispatch_rows(["a"], twice)[1] == [
        "a", "2.00", "1.00", "1.00", "100%", "2.000", "1.417",
    ]  # fmt: skip


@pytest.mark.parametrize("share", [0.05, 0.25, 0.5, 0.95])
def test_quantiles_of_a_histogram_are_those_of_the_samples(share):
    samples = np.random.default_rng(0).beta(2.0, 5.0, (3, 5000))
    counts = np.stack([np.histogram(row, SOC_BINS, (0.0, 1.0))[0] for row in samples])
    got = quantile(counts, share)
    np.testing.assert_allclose(got, np.quantile(samples, share, axis=1), atol=1.0 / SOC_BINS)
    assert np.isnan(quantile(np.zeros((2, SOC_BINS), int), share)).all()


def test_bins_of_time_keep_the_total():
    values = np.random.default_rng(0).random((10, 2))
    edges = np.array([0, 4, 8, 10])
    means = _in_bins(values, edges)
    np.testing.assert_allclose((means * np.diff(edges)[:, None]).sum(axis=0), values.sum(axis=0))
    np.testing.assert_allclose(means[2], values[8:].mean(axis=0))


@pytest.mark.parametrize("seeds", [2, 5])
def test_a_curve_of_several_seeds_and_one_of_none(tmp_path, seeds):
    rng = np.random.default_rng(0)
    rows = [{"env_steps": 10, "episode_return": 1.0, "per_seed": {"episode_return": [1.0] * seeds}}]
    rows[0]["per_seed"]["episode_return"][0] = None  # no episode of the first seed has ended
    for number in range(2, 30):
        values = list(number + rng.normal(size=seeds))
        mean = float(np.mean(values))
        row = {"env_steps": 10 * number, "episode_return": mean}
        rows.append(row | {"per_seed": {"episode_return": values}})
    for name, given in (("curve", rows), ("first", rows[:1]), ("none", [])):
        plot_curve(tmp_path / f"{name}.png", given, "a title", {"none": -1.0, "random": 2.0})
        assert imread(tmp_path / f"{name}.png").std() > 0.02

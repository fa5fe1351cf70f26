"""The report of a run on the real environment, as small as it gets: what it shows is what the evaluation says."""

import base64
import itertools
import json
import re
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from matplotlib.image import imread

import train.reporting.report
from medjax.policies.rules import BASELINES
from tests.train.conftest import refused
from train import evaluate, report
from train.algorithms.ppo.settings import PPOConfig
from train.evaluation.tables import SAMPLED, START, paper_rows
from train.reporting.figures import look
from train.reporting.survey import dispatch_rows, survey, total
from train.runs.arguments import parse_request
from train.runs.checkpoint import to_host
from train.runs.open_session import open_session

pytestmark = pytest.mark.usefixtures("quick_compiles")

EPISODES = 4
SMALL = {"num_meds": 3, "num_evs": 6, "num_gas": 12, "episode_decisions": 12}
# So many EVs with so little energy that some run out in every episode, and a policy that sends whenever it may.
SMALL |= {"ev_share": 0.9, "battery_scale": 600, "cooldown_s": 3}
OPTIONS = ["--num-envs=8", "--num-minibatches=8", "--decide-every=2", "--initial-wait=0.01"]
OPTIONS += ["--hidden", "8", *(f"--set={name}={value}" for name, value in SMALL.items())]


def make_run(path):
    """A run that has not trained: its first weights, and a made-up curve."""
    session = open_session(parse_request(PPOConfig, [*OPTIONS, f"--run-dir={path}"]))
    state = session.programs.init(jax.random.key(0), session.params)
    session.checkpoints.save(to_host(state), session.config)
    rows = [
        {"update": n, "env_steps": 100 * n, "episode_return": value, "episodes": 1.0}
        for n, value in enumerate((None, -3.0, 2.0), 1)
    ]
    session.run_dir.metrics.write_text("".join(json.dumps(row) + "\n" for row in rows))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run and its report, with the traces and the marks that the command drew."""
    run = tmp_path_factory.mktemp("report") / "run"
    make_run(run)
    traces, marked = [], []
    record, plot_episode = train.reporting.report.record, train.reporting.report.plot_episode

    def keep(*arguments):
        for trace in record(*arguments):
            traces.append(trace)
            yield trace

    def plot(*arguments):
        marked.append(plot_episode(*arguments))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("train.reporting.report.record", keep)
        patch.setattr("train.reporting.report.plot_episode", plot)
        patch.setattr("train.reporting.traces.EPISODES_AT_ONCE", 3)  # one batch is not full
        assert report.main([f"--run-dir={run}", f"--episodes={EPISODES}", "--seed=2"]) == 0
    whole = jax.tree.map(lambda *parts: np.concatenate(parts), *traces)
    return SimpleNamespace(run=run, traces=traces, trace=whole, marked=marked[0])


@pytest.fixture(scope="module")
def scores(made):
    """What `medjax.episodes.scores` says of the same episodes, an array `(episodes,)` each metric and policy."""
    from medjax.episodes.scores import evaluate_policies
    from train.runs.policies import load_policies
    from train.runs.run_directory import RunDir

    env, params, policies = load_policies(made.run, RunDir(made.run).load_config())
    # The initial policy and those that sample are played, and not recorded.
    recorded = {
        name: policy
        for name, policy in policies.items()
        if name != START and not name.endswith(SAMPLED)
    }
    return evaluate_policies(env, params, recorded, EPISODES, seed=2)


@pytest.mark.thorough
def test_pictures_and_page_are_complete(made):
    there = made.run / "report"
    names = [f"{name}.png" for name in train.reporting.report.PICTURES]
    files = [*names, "evaluation.json", "report.html"]
    assert sorted(path.name for path in there.iterdir()) == sorted(files)
    text = (there / "report.html").read_text()
    for outside in ("http", "url(", "href=", "srcset=", "data="):
        assert outside not in text
    terms = re.findall("<dt>(.*)</dt><dd>(.+)</dd>", text)
    assert {"return", "ppo", START, *BASELINES} <= {term for term, _ in terms}
    assert text.index("reach their exit with the trained policy (ppo)") < text.index("<h2>")
    headings = re.findall("<h2>(.*)</h2>", text)
    for heading in ("Figure 7", "Table 2", "Figure 8", "One episode", "State of charge", "Where"):
        assert any(heading in found for found in headings), heading
    assert text.count("<figcaption>") == len(names)
    assert f"{EPISODES} episodes are too few to tell ppo from" in text
    assert "of all EVs that were on the road" in text
    assert "the share at 0 is of these" in text  # the other denominator
    sources = re.findall('src="(.*)"', text)
    for name, source in zip(names, sources, strict=True):
        data = (there / name).read_bytes()
        assert base64.b64decode(source.removeprefix("data:image/png;base64,")) == data
        pixels = imread(there / name)
        assert min(pixels.shape[:2]) > 300
        assert pixels[..., :3].std() > 0.05  # something is drawn


@pytest.mark.thorough
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


@pytest.mark.thorough
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


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_a_world_of_another_shape_is_named(made, capsys):
    for changes, words in (
        (
            ["--set", "num_ramps=3"],
            ("another shape than paper ", "num_ramps=3", "in its training on paper "),
        ),
        (["--scenario=corridor"], ("another shape than corridor, ", "in its training on paper ")),
    ):
        said = refused(capsys, [f"--run-dir={made.run}", *changes], command=evaluate)
        assert all(each in said for each in words), said


def test_table_2_is_the_evaluation(made, tmp_path):
    out = tmp_path / "out.json"
    argv = [f"--run-dir={made.run}", f"--episodes={EPISODES}", "--seed=2", f"--json={out}"]
    assert evaluate.main(argv) == 0
    result = json.loads(out.read_text())
    assert json.loads((made.run / "report" / "evaluation.json").read_text()) == result
    page = (made.run / "report" / "report.html").read_text()
    papers = paper_rows(result | {"scenario": "paper", "overrides": {}}, ["ppo"])
    claimed = {row[0]: row[1] for row in papers}
    returns = {"ppo": "0.340 (0.141)", "random": "-332.4 (53.95)", "none": "-521.9 (16.53)"}
    for name, theirs in (returns | {"greedy": "-"}).items():
        assert claimed[name] == theirs
        assert theirs == "-" or theirs not in page  # which is of another world
        row = page.split(f"<tr><td>{name}</td><td>")[1]
        mean, std = (float(text) for text in row.split(")")[0].split(" ("))
        assert mean == pytest.approx(result["policies"][name]["return_mean"], rel=1e-3, abs=1e-3)
        assert std == pytest.approx(result["policies"][name]["return_std"], rel=1e-3, abs=1e-3)


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


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "height"), [(1600, 900), (1024, 768), (390, 844)])
def test_the_page_is_readable_at_any_size(made, browser, width, height, scheme):
    """Only figures and tables with their own scroll bars are wider; text has a contrast of 7:1."""
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    page = context.new_page()
    page.goto((made.run / "report" / "report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    least = min(700, width - 40)
    assert min(page.evaluate("[...document.images].map((each) => each.clientWidth)")) >= least
    ink, paper = page.evaluate(
        "(({color, backgroundColor}) => [color, backgroundColor])(getComputedStyle(document.body))"
    )

    luminances = [
        np.dot(linear([int(part) for part in text[4:-1].split(",")]), (0.2126, 0.7152, 0.0722))
        for text in (ink, paper)
    ]
    low, high = sorted(luminances)
    assert (high + 0.05) / (low + 0.05) >= 7.0
    assert (luminances[1] > 0.5) == (scheme == "light")
    context.close()


def linear(rgb):
    """Intensities of a colour in sRGB, from 0 to 255 each."""
    share = np.asarray(rgb) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


DEUTERANOPIA = np.array(  # Machado, Oliveira, Fernandes 2009, severity 1
    [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]
)


def test_lines_differ_for_the_colour_blind():
    """Any two policies by their dashes, or by 0.2 of a channel as they appear."""
    looks = [look(name) for name in ("ppo", "ppo" + SAMPLED, START, START + SAMPLED, *BASELINES)]
    for one, other in itertools.combinations(looks, 2):
        if one["ls"] == other["ls"]:
            seen = [
                np.clip(DEUTERANOPIA @ linear(list(bytes.fromhex(each["color"][1:]))), 0, 1)
                for each in (one, other)
            ]
            assert np.abs(np.diff(np.power(seen, 1 / 2.2), axis=0)).max() > 0.2, (one, other)

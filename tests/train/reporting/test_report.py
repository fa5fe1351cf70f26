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

import train.reporting.report
from medjax.policies.rules import BASELINES
from tests.train.conftest import refused
from train import evaluate, report
from train.algorithms.ppo.settings import PPOConfig
from train.evaluation.tables import START, paper_rows
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
OPTIONS += ["--hidden", "8"]
for name, value in SMALL.items():
    OPTIONS += ["--set", f"{name}={value}"]


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
    """A run, its report, and what passed through the command on the way."""
    run = tmp_path_factory.mktemp("report") / "run"
    make_run(run)
    traces, marked, out = [], [], io.StringIO()
    record, plot_episode = train.reporting.report.record, train.reporting.report.plot_episode
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out):

        def keep(*arguments):
            for trace in record(*arguments):
                traces.append(trace)
                yield trace

        patch.setattr("train.reporting.report.record", keep)
        patch.setattr(
            "train.reporting.report.plot_episode", lambda *a: marked.append(plot_episode(*a))
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
    """What `medjax.episodes.scores` says of the same episodes, an array `(episodes,)` each metric and policy."""
    from medjax.episodes.scores import evaluate_policies
    from train.runs.policies import load_policies
    from train.runs.run_directory import RunDir

    env, params, policies = load_policies(made.run, RunDir(made.run).load_config(), False)
    del policies[START]  # which is played, and not recorded
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
    names = [f"{name}.png" for name in train.reporting.report.PICTURES]
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
    assert text.count("<figcaption>") == len(names)
    assert f"{EPISODES} episodes are too few to tell ppo from" in text
    assert "of all EVs that were on the road" in text
    assert "the share at 0 is of these" in text  # the other denominator
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
    papers = paper_rows(result | {"scenario": "paper", "overrides": {}}, ["ppo"])
    claimed = {row[0]: row[1] for row in papers}
    for name, theirs in (
        ("ppo", "0.340 (0.141)"),
        ("random", "-332.4 (53.95)"),
        ("none", "-521.9 (16.53)"),
        ("greedy", "-"),
    ):
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
def test_the_page_is_readable_at_any_size(made, browser, scheme, width, height):
    """Nothing but figures and tables in their own scrollers is wider; text has a contrast of 7:1 on its ground."""
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    page = context.new_page()
    page.goto((made.run / "report" / "report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    least = min(700, width - 40)
    assert min(page.evaluate("[...document.images].map((each) => each.clientWidth)")) >= least
    ink, paper = page.evaluate(
        "(({color, backgroundColor}) => [color, backgroundColor])(getComputedStyle(document.body))"
    )

    def luminance(text):
        parts = [int(part) / 255 for part in text[4:-1].split(",")]
        linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    high, low = sorted((luminance(ink), luminance(paper)), reverse=True)
    assert (high + 0.05) / (low + 0.05) >= 7.0
    assert (luminance(paper) > 0.5) == (scheme == "light")
    context.close()


DEUTERANOPIA = np.array(  # Machado, Oliveira, Fernandes 2009, severity 1
    [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]
)


def test_lines_differ_to_those_who_see_no_green():
    """Any two policies by their dashes, or by 0.2 of a channel as they are seen."""
    looks = {name: look(name) for name in ("ppo", START, *BASELINES)}

    def seen(name):
        text = looks[name]["color"]
        rgb = np.array([int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)])
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return np.clip(DEUTERANOPIA @ linear, 0, 1) ** (1 / 2.2)

    for one in looks:
        for other in looks:
            if one != other and looks[one]["ls"] == looks[other]["ls"]:
                assert np.abs(seen(one) - seen(other)).max() > 0.2, (one, other)

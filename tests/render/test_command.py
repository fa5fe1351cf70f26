"""`python -m medjax.render`: bad input is one line and exit code 2; good input is a file."""

import dataclasses
import importlib.util
import json
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.episodes.verdict import NAMES
from medjax.policies.about import About
from medjax.policies.saved import save_policy
from medjax.render.__main__ import _evaluation, _request, build_parser, main
from tests.benchmarks.refusal import refused
from tests.render.test_player import contents

BAD = [
    ("--out a.mp3", "allowed a file that ends in .mp4, .gif, .png, .html"),
    ("--out a", "allowed a file that ends in"),
    ("", "--out"),
    ("--policy best --out a.html", "unknown policy 'best': allowed none, slow, random"),
    ("--compare best --out a.html", "unknown policy 'best': allowed none, slow, random"),
    ("--compare run:. --out a.html", "python -m train.export --run-dir . writes it"),
    ("--policy run:nowhere --out a.html", "run nowhere is not a directory; allowed one that"),
    ("--policy run: --out a.html", "run '': allowed a path"),
    ("--compare forecast --out a.html", "allowed another policy"),
    ("--compare none --out a.mp4", "--compare with a.mp4: allowed with a file that ends in .html"),
    ("--scenario mars --out a.html", "unknown scenario 'mars': allowed paper"),
    ("--run-dir nowhere --out a.html", "allowed one that train.ppo wrote"),
    ("--run-dir . --out a.html", "python -m train.export --run-dir . writes it"),
    ("--run-dir . --policy none --out a.html", "one or the other"),
    ("--out nowhere/a.html", "allowed a file in a directory that can be written"),
    ("--follow bus:3 --out a.html", "allowed auto, MED:NUMBER"),
    ("--seed -1 --out a.html", "allowed a whole number"),
    ("--episode x --out a.html", "allowed a whole number"),
    ("--start -1 --out a.html", "allowed a number from 0"),
    ("--duration 0 --out a.mp4", "allowed a number above 0"),
    ("--duration nan --out a.mp4", "allowed a number above 0"),
    ("--duration 5 --out a.html", "the player holds the whole episode"),
    ("--size big --out a.png", "allowed WIDTHxHEIGHT"),
    ("--size 10x10 --out a.png", "allowed 160 to 8192 px"),
    ("--grid 2 --out a.html", "allowed a whole number from 3"),
    ("--grid 8 --out a.png", "--grid with a.png: allowed with a file that ends in .html"),
    ("--grid 8 --episode 3 --out a.html", "--grid with --episode: allowed one of them"),
    ("--evaluation nowhere.json --out a.html", "train.evaluate --json wrote"),
    ("--evaluation a.json --out a.png", "--evaluation with a.png"),
    ("--set cooldown_s --out a.html", "allowed NAME=VALUE"),
    ("--set name=1 --out a.html", "allowed NAME=VALUE"),
]
BAD_WORLDS = [
    ("--set cooldown=3", "cooldown_s"),
    ("--set num_lanes=0", "num_lanes = 0: allowed"),
    ("--start 601", "allowed 0 to 600 s"),
    ("--follow 4001", "allowed 0 to 4000 m"),
    ("--run-dir run", "a policy that train.ppo or train.export wrote"),
]
RECORD = "medjax.episodes.options.record_episode"


@pytest.fixture(autouse=True)
def _nothing_is_simulated(request, monkeypatch, tmp_path):
    """Commands run in an empty directory and, unless a test is slow, simulate nothing."""
    monkeypatch.chdir(tmp_path)
    if request.node.get_closest_marker("slow") is None:
        monkeypatch.delattr(RECORD)


@pytest.fixture
def played(_nothing_is_simulated, monkeypatch, recording, other):
    """The command gets these recordings at once."""

    def record(*args, name, **kwargs):
        return other if name == "none" else recording

    monkeypatch.setattr(RECORD, record, raising=False)


@pytest.mark.parametrize(("argv", "says"), BAD)
def test_bad_options_are_refused_in_one_line(argv, says, capsys):
    line = refused(main, argv.split(), capsys)
    assert line.startswith("python -m medjax.render: ")
    assert says in line
    assert not list(Path().iterdir())


@pytest.mark.parametrize(("argv", "says"), BAD_WORLDS)
def test_bad_worlds_and_policies_are_refused_in_one_line(argv, says, capsys):
    Path("run").mkdir()
    Path("run/policy.zip").write_bytes(b"no archive")
    assert main([*argv.split(), "--out", "a.html"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert says in err


@pytest.mark.parametrize(
    ("suffix", "module", "library"),
    [
        (".mp4", "imageio_ffmpeg", "imageio-ffmpeg"),
        (".gif", "PIL", "Pillow"),
        (".png", "PIL", "Pillow"),
    ],
)
def test_missing_libraries_are_named_with_their_command(
    suffix, module, library, capsys, monkeypatch
):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == module else find(name)
    )
    line = refused(main, ["--out", f"a{suffix}"], capsys)
    assert line.endswith(f'{library} is not installed: pip install -e ".[render]"\n')


@pytest.mark.parametrize(
    "argv",
    [
        "--out a.html",
        pytest.param(
            "--out a.html --compare none --follow EV:2 --start 30", marks=pytest.mark.slow
        ),
        "--out a.png --size 400x200 --follow 1200 --span 300",
        "--out a.mp4 --duration 0.5 --size 400x200",
        "--out a.gif --start 3 --duration 0.5 --size 400x200",
    ],
)
def test_writes_the_file_and_prints_its_size(argv, capsys, played):
    argv = argv.split()
    assert main(["--policy", "periodic", *argv]) == 0
    out, err = capsys.readouterr()
    name, size, unit = out.split()
    assert name == f"{argv[1]}:"
    unit = {"kB": 1e3, "MB": 1e6}[unit]
    assert float(size) > 0.0
    assert float(size) * unit == pytest.approx(Path(argv[1]).stat().st_size, abs=0.06 * unit)
    # No progress bar, since this is no terminal.
    who = "periodic and none" if "--compare" in argv else "periodic"
    assert err == f"compiling and playing an episode with {who} ...\n"
    assert [path.name for path in Path().iterdir()] == [argv[1]]


def test_a_grid_shows_the_best_the_median_and_the_worst(monkeypatch, recording, browser, capsys):
    """Three players in one page, of known returns."""
    returns = np.array([3.0, -7.0, 12.0, 5.0, 4.0])
    asked = []

    def record(*args, name, episode, **kwargs):
        return dataclasses.replace(recording, policy=name, episode=episode)

    def evaluate(env, params, policies, episodes, seed):
        asked.append((list(policies), episodes, seed))
        return {"periodic": {"return": returns}}

    monkeypatch.setattr(RECORD, record, raising=False)
    monkeypatch.setattr("medjax.render.__main__.evaluate_policies", evaluate)
    assert main(["--policy", "periodic", "--grid", "5", "--seed", "9", "--out", "a.html"]) == 0
    assert asked == [(["periodic"], 5, 9)]
    err = capsys.readouterr().err
    assert err.startswith("compiling and playing 5 episodes with periodic ...\n")
    page = browser.new_page()
    page.goto(Path("a.html").absolute().as_uri())
    titles = page.locator("h2").all_inner_texts()
    assert titles == [
        "Best of 5: episode 2, return 12.0",
        "Median of 5: episode 4, return 4.0",
        "Worst of 5: episode 1, return -7.0",
    ]
    page.frames[1].wait_for_selector("#verdict tbody tr")
    assert "episode 2" in page.frames[1].title()
    page.close()


@pytest.mark.parametrize("grid", ["", " --grid 5"])
def test_memory_is_checked_before_an_episode_is_played(monkeypatch, grid, capsys):
    monkeypatch.delattr("medjax.render.__main__.evaluate_policies")
    monkeypatch.setattr("medjax.numerics.memory.memory_bytes", lambda: 10_000)
    assert main(f"--policy none --out a.html{grid}".split()) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "an episode of 600 decisions with 208 vehicles: about" in err


def evaluation_of(argv, *policies):
    """The evaluation that the command shows for these policies, on the preset `paper`."""
    request = _request(build_parser().parse_args(["--out", "a.html", *argv.split()]))
    return _evaluation(request, SimpleNamespace(name="paper"), policies)


@pytest.mark.parametrize(
    ("argv", "policy", "known"),
    [
        ("", "forecast", True),
        ("--set cooldown_s=30", "forecast", False),
        ("--policy medjax.policies.rules:greedy", "medjax.policies.rules:greedy", False),
    ],
)
def test_unchanged_presets_have_known_means(argv, policy, known):
    assert (evaluation_of(f"--compare none {argv}", policy, "none") is not None) == known


@pytest.mark.parametrize(
    ("argv", "world", "known"),
    [
        ("", "paper", True),
        ("--set cooldown_s=30", "paper", False),
        ("--scenario paper", "paper", False),
        ("", "corridor", False),
    ],
)
def test_an_unchanged_run_has_the_means_of_its_closing_evaluation(argv, world, known):
    """An evaluation of something else, or a broken one, is ignored."""
    Path("run").mkdir()
    Path("run/policy.zip").write_bytes(b"")
    entry = {**dict.fromkeys(NAMES, 1.5), "return_ci95": [3.0, 11.5]}
    found = {"scenario": world, "episodes": 7, "policies": {"ppo": entry}}
    Path("run/evaluation.json").write_text(json.dumps(found))
    for given in ("--run-dir run", "--policy run:run", "--compare run:run"):
        assert evaluation_of(f"{given} {argv}", "ppo") == (found if known else None)
    argv = f"--run-dir run {argv}"
    assert evaluation_of(argv, "ippo") is None
    Path("run/evaluation.json").write_text("{")
    assert evaluation_of(argv, "ppo") is None


def test_an_unknown_vehicle_is_refused_in_one_line(capsys, played):
    assert main(["--policy", "periodic", "--follow", "EV:999", "--out", "a.html"]) == 2
    assert "allowed EV numbers: 1 to" in capsys.readouterr().err
    assert not list(Path().iterdir())


def test_a_broken_policy_is_one_line(capsys):
    Path("run").mkdir()
    Path("run/policy.zip").write_bytes(b"no archive")
    assert main(["--run-dir", "run", "--out", "a.html"]) == 2
    assert capsys.readouterr().err.endswith("a policy that train.ppo or train.export wrote\n")


@pytest.mark.slow
def test_plays_the_policy_of_a_run_beside_a_rule(capsys):
    numbers = {"episode_decisions": 8, "num_meds": 2, "num_evs": 6, "num_gas": 10}
    env, _ = medjax.make("paper", **numbers)
    rows, size = jax.export.symbolic_shape("rows, size")[0], env.observation.size(env.config)

    def network(obs, mask):
        chances = jnp.where(mask, jnp.arange(1.0, 1.0 + env.num_actions), 0.0)
        return chances / chances.sum(axis=1, keepdims=True), obs.sum(axis=1)

    exported = jax.export.export(jax.jit(network))(
        jax.ShapeDtypeStruct((rows, size), jnp.float32),
        jax.ShapeDtypeStruct((rows, env.num_actions), bool),
    )
    about = About("paper", numbers, "flat", 2, size, env.num_actions)
    Path("run").mkdir()
    save_policy(Path("run/policy.zip"), about, exported)
    assert main(["--run-dir", "run", "--compare", "none", "--out", "a.html"]) == 0
    page = Path("a.html").read_text()
    assert Path("a.html").stat().st_size > 50_000
    assert "<title>paper: ppo and none, seed 0, episode 0</title>" in page
    _, tables = contents(page)
    # The network prefers the last ramp wherever it is allowed, at every other decision.
    first = tables["probability"][:, 0]
    assert first == pytest.approx(np.arange(1, 6) / 15.0, abs=1e-4)
    assert tables["action"][0, 0] == tables["sent"][0, 0] == 4
    assert tables["probability"][:, 1].tolist() == [1.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.slow
def test_plays_and_writes_for_real(capsys):
    small = ["episode_decisions=8", "num_meds=2", "num_evs=6", "num_gas=10", "mainline_per_h=600"]
    options = [part for text in small for part in ("--set", text)]
    assert main(["--policy", "greedy", *options, "--out", "a.html", "--compare", "none"]) == 0
    assert Path("a.html").stat().st_size > 50_000

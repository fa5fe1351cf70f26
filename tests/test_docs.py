"""Every Python example in the documentation runs as printed, and its links lead somewhere."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import medjax
from medjax.numerics import compilation
from medjax.world.charging_params import CoilDesign
from medjax.world.presets import Recipe
from medjax.world.weights import PRICES, WEIGHTS
from tests.train.conftest import never
from tests.train.probe_envs import Probe, ProbeParams

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
NAMES = {  # by code, so that an example on two pages runs once
    code: f"{page.relative_to(ROOT)}-{number}"
    for page in PAGES
    for number, code in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL))
}
EXAMPLES = {name: code for code, name in NAMES.items()}
OWN_REWARD = next(name for name, code in EXAMPLES.items() if "def low_charge" in code)
TRAINING = [name for name, code in EXAMPLES.items() if "train.api" in code]


pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.fixture(autouse=True)
def no_messages(monkeypatch):
    """An example's `prepare_jax` must not announce compilations of later tests."""
    monkeypatch.setattr(compilation, "_announce_compiling", lambda: None)


def run(code):
    """Runs an example in a namespace of its own; skips it if a library is missing."""
    for library in re.findall(r"^(?:from|import) (\w+)", code, re.MULTILINE):
        pytest.importorskip(library)
    exec(compile(code, "example", "exec"), {"__name__": "example"})


@pytest.mark.parametrize("name", EXAMPLES)
def test_example_is_short(name):
    """At most 25 lines besides blank ones."""
    assert sum(bool(line.strip()) for line in EXAMPLES[name].splitlines()) <= 25


@pytest.mark.thorough
@pytest.mark.parametrize("name", sorted(EXAMPLES.keys() - {OWN_REWARD, *TRAINING}))
def test_example_runs(name, tmp_path, monkeypatch, capsys):
    """Runs as printed, in a directory of its own, and prints no NaN; the remaining examples run below."""
    monkeypatch.chdir(tmp_path)
    run(EXAMPLES[name])
    printed = capsys.readouterr().out
    assert bool(printed) == bool(re.search(r"^print\(", EXAMPLES[name], re.MULTILINE))
    assert "nan" not in printed.lower()


@pytest.mark.parametrize("name", TRAINING)
def test_training_example_trains(name, tmp_path, monkeypatch, capsys):
    """Trains on a probe environment with tiny settings; the real run would take minutes."""
    asked = {}

    def make(name, *, observation, reward=None):
        asked.update(name=name, terms=[*(reward or ())], observation=observation)
        return Probe("noisy", recipe=Recipe(name, {}, reward, observation)), ProbeParams()

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("medjax.make", make)
    for module in ("about", "saved"):
        monkeypatch.setattr(f"medjax.policies.{module}.make", make)
    rules = dict.fromkeys(("none", "paced", "forecast"), never)
    monkeypatch.setattr("medjax.policies.team.BASELINES", rules)
    whole = "total_timesteps=1_000_000"
    tiny = "total_timesteps=96, num_envs=4, num_minibatches=2, decide_every=1, rollout_length=4"
    assert whole in EXAMPLES[name]
    run(EXAMPLES[name].replace(whole, tiny))
    terms = [*medjax.TERMS, "served"] if "served" in EXAMPLES[name] else []
    assert asked == {"name": "paper", "terms": terms, "observation": "profile"}
    out = capsys.readouterr().out
    assert out.count("64 whole episodes of ") == 2
    assert "minus forecast, 95 % CI" in out
    assert len(list((tmp_path / "runs").glob("*/policy.zip"))) == 1


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_named_files_exist(page):
    """Relative links, files named with their folder, and test files named alone."""
    text = page.read_text()
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    for target in re.findall(r"\]\((?!http)([^)#]+)", prose):
        assert (page.parent / target).exists(), target
    for name in re.findall(r"\b(?:medjax|train|benchmarks|tests|docs)/[\w./]*\.\w+", text):
        assert (ROOT / name).exists(), name
    for name in re.findall(r"(?<![/\w])test_\w+\.py", text):
        assert list((ROOT / "tests").rglob(name)), name


@pytest.mark.thorough
def test_custom_reward_example_adds_its_term(capsys):
    """The example's term appears in the reward with its weight."""
    run(EXAMPLES[OWN_REWARD])
    reward, terms = capsys.readouterr().out.split(maxsplit=1)
    terms = eval(terms)
    assert terms["low_charge"] <= 0.0
    assert terms["dispatches"] == -0.5
    assert float(reward) == pytest.approx(sum(terms.values()), rel=1e-5)


def test_parameter_table_matches_the_presets(paper):
    """docs/parameters.md states the numbers that `make("paper")` has, with either reward."""
    env, params = paper
    _, money = medjax.make("paper", reward="money")
    params = params.replace(reward_weights={**params.reward_weights, **money.reward_weights})
    page = (ROOT / "docs/parameters.md").read_text()
    rows = re.findall(r"^\| `([\w.]+)` \| ([^|]+) \|", page, re.M)
    assert len(rows) > 80
    for name, text in rows:
        group, _, leaf = name.rpartition(".")
        holder = getattr(params, group) if group else params
        holder = next(
            (other for other in (env.config, CoilDesign()) if hasattr(other, name)), holder
        )
        if isinstance(holder, dict):  # weights; those of another reward are not among this preset's
            holder = SimpleNamespace(**{leaf: holder.get(leaf, (WEIGHTS | PRICES)[leaf].default)})
        value = np.atleast_1d(getattr(holder, leaf))
        stated = [float(number) for number in text.split(",") if number.strip() != "none"]
        np.testing.assert_allclose(*np.broadcast_arrays(stated, value), rtol=1e-3)
    leaves = {
        f"{group}.{leaf}"
        for group, member in vars(params).items()
        for leaf in (member if isinstance(member, dict) else getattr(member, "__dict__", {}))
    }
    assert leaves - {name for name, _ in rows} == {"link.inductance"}

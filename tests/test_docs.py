"""Every Python example in the documentation runs as printed, and its links lead somewhere."""

import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
EXAMPLES = [
    pytest.param(code, id=f"{page.name}-{number}")
    for page in PAGES
    for number, code in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL))
]


@pytest.mark.parametrize("code", EXAMPLES)
def test_example_runs(code):
    """At most 25 lines besides blank ones, and it runs."""
    assert sum(bool(line.strip()) for line in code.splitlines()) <= 25
    exec(compile(code, "example", "exec"), {"__name__": "example"})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_exist(page):
    """Relative links point at files of the repository."""
    prose = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\((?!http)([^)#]+)", prose):
        assert (page.parent / target).exists(), target


def test_custom_reward_example_adds_its_term(capsys):
    """The example's term appears in the reward with its weight."""
    code = next(example.values[0] for example in EXAMPLES if "def low_charge" in example.values[0])
    exec(compile(code, "example", "exec"), {"__name__": "example"})
    reward, terms = capsys.readouterr().out.split(maxsplit=1)
    terms = eval(terms)
    assert terms["low_charge"] <= 0.0
    assert terms["dispatches"] == -0.5
    assert float(reward) == pytest.approx(sum(terms.values()), rel=1e-5)


def test_parameter_table_matches_the_presets(paper):
    """docs/parameters.md states the numbers that `make("paper")` really has."""
    _, params = paper
    rows = re.findall(
        r"^\| `([\w.]+)` \| ([^|]+) \|", (ROOT / "docs/parameters.md").read_text(), re.M
    )
    assert len(rows) > 80
    seen = set()
    for name, text in rows:
        group, _, leaf = name.rpartition(".")
        holder = getattr(params, group) if group else params
        value = np.atleast_1d(holder[leaf] if isinstance(holder, dict) else getattr(holder, leaf))
        stated = [float(number) for number in text.split(",")]
        np.testing.assert_allclose(*np.broadcast_arrays(stated, value), rtol=1e-3)
        seen.add(name)
    leaves = {
        f"{group}.{leaf}"
        for group, member in vars(params).items()
        for leaf in (member if isinstance(member, dict) else getattr(member, "__dict__", {}))
    }
    assert leaves - seen == {"link.inductance"}

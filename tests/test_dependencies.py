"""Declared dependencies are documented, imported and pinned."""

import ast
import importlib.metadata
import re
import tomllib
import warnings
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = {"-": PROJECT["dependencies"]} | PROJECT["optional-dependencies"]


def requirements(extra):
    """An extra's requirements, except this package itself."""
    asked = (Requirement(text) for text in EXTRAS[extra])
    return [one for one in asked if one.name != PROJECT["name"]]


def imported(folder):
    """Top-level modules that Python files under a folder import."""
    modules = set()
    for path in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                modules |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                modules.add(node.module.partition(".")[0])
    return modules


def pinned(file):
    lines = (ROOT / file).read_text().splitlines()
    pairs = [line.split("==") for line in lines if "==" in line and not line.startswith("#")]
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in pairs}


def test_the_page_lists_every_requirement():
    """With its extra and a reason."""
    documented = set()
    for line in (ROOT / "docs" / "dependencies.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 5 and cells[0] != "Package" and not cells[0].startswith("---"):
            assert all(cells), line
            documented |= {(cells[0], extra) for extra in cells[1].split(", ")}
    assert documented == {(one.name, extra) for extra in EXTRAS for one in requirements(extra)}


@pytest.mark.parametrize(
    ("extra", "folder"), [("-", "medjax"), ("train", "train"), ("render", "medjax")]
)
def test_requirements_are_imported(extra, folder):
    """Or jax.export imports them for us (flatbuffers)."""
    modules = imported(folder) | {"flatbuffers"}
    providers = importlib.metadata.packages_distributions()
    used = {name.lower() for module in modules for name in providers.get(module, [])}
    used = {name.replace("_", "-") for name in used}
    assert {one.name.lower() for one in requirements(extra)} <= used


@pytest.mark.parametrize("extra", ["-", "train", "test", "render", "gymnasium", "trajectories"])
def test_oldest_constraints_are_the_lower_bounds(extra):
    versions = pinned("constraints-oldest.txt")
    for one in requirements(extra):
        (bound,) = one.specifier
        assert bound.operator == ">="
        oldest = versions[one.name.lower()]
        # A bound of 2.0 means the first release that begins so: 2.0.0, or a later one if that was never published.
        assert f"{oldest}.".startswith(f"{bound.version}."), (one.name, oldest)


@pytest.mark.parametrize("file", ["constraints.txt", "constraints-newest.txt"])
def test_pins_are_allowed(file):
    versions = pinned(file)
    for extra in ("-", "train", "test", "render", "gymnasium", "trajectories"):
        for one in requirements(extra):
            assert one.specifier.contains(versions[one.name.lower()]), one


@pytest.mark.parametrize("kind", [DeprecationWarning, PendingDeprecationWarning, FutureWarning])
def test_deprecation_warnings_fail_a_test(kind):
    with pytest.raises(kind, match="going away"):
        warnings.warn("this is going away", kind, stacklevel=1)

"""The options --policy and --compare of `python -m medjax.render`: each takes every kind of policy."""

import dataclasses
from pathlib import Path

import pytest

from medjax.policies.pretrained import FILES, load_pretrained
from medjax.policies.saved import save_policy
from medjax.render.__main__ import _request, build_parser

NAMES_OF_POLICIES = {
    "greedy": "greedy",
    "pretrained": "pretrained",
    "run:run": "ppo",
    "run/policy.zip": "ppo",
    "medjax.policies.rules:greedy": "medjax.policies.rules:greedy",
}


@pytest.fixture
def trained(monkeypatch, tmp_path):
    """A run, here, whose policy is the one that comes with medjax."""
    monkeypatch.chdir(tmp_path)
    Path("run").mkdir()
    Path("run/policy.zip").write_bytes((FILES / "paper.zip").read_bytes())


def made(*argv):
    """The policies that the command plays, by name."""
    request = _request(build_parser().parse_args(["--out", "a.html", *argv]))
    return request.played.build()[2]


@pytest.mark.parametrize("given", NAMES_OF_POLICIES)
def test_both_options_take_every_kind_of_policy(trained, given):
    name = NAMES_OF_POLICIES[given]
    assert [*made("--policy", given, "--compare", "none")] == [name, "none"]
    assert [*made("--policy", "none", "--compare", given)] == ["none", name]


def test_two_runs_of_one_name_go_by_their_directories(trained):
    Path("again").mkdir()
    Path("again/policy.zip").write_bytes(Path("run/policy.zip").read_bytes())
    assert [*made("--run-dir", "run", "--compare", "run:again")] == ["run:run", "run:again"]


def test_a_run_sets_the_world_of_both(trained):
    """With the numbers of its training, whichever option names it."""
    Path("run/policy.zip").unlink()
    about = dataclasses.replace(load_pretrained().about, overrides={"num_gas": 77})
    save_policy(Path("run/policy.zip"), about, load_pretrained().network)
    for argv in ("--policy run:run --compare none", "--policy none --compare run:run"):
        request = _request(build_parser().parse_args(["--out", "a.html", *argv.split()]))
        assert request.played.prepared()[0].config.num_gas == 77


def test_help_lists_every_kind_of_policy():
    text = " ".join(build_parser().format_help().split())
    for kind in ("forecast", "pretrained", "run:DIR", "module:function", ".zip"):
        assert kind in text, kind

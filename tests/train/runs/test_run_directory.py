"""What the directory of a run keeps of its settings."""

import dataclasses
import json
import platform

import pytest

from medjax.errors import InputError
from tests.train.conftest import TINY
from train.algorithms.ppo.settings import PPOConfig
from train.runs import open_session, run_directory, session
from train.runs.arguments import Request, parse_request
from train.runs.run_directory import RunDir


@pytest.fixture
def config():
    """The settings of `TINY`, complete as a run's are."""
    return parse_request(PPOConfig, TINY).config.for_episodes(4)


def until(run_dir):
    """Learning rates by the update until which they ruled."""
    return {
        path.name: json.loads(path.read_text())["config"]["learning_rate"]
        for path in run_dir.path.glob("config-until-*")
    }


def test_settings_that_ruled_are_kept(tmp_path, config):
    """However often a run resumes from the same update, or from an earlier one."""
    first, second, third = (
        dataclasses.replace(config, learning_rate=rate) for rate in (1e-3, 1e-4, 3e-4)
    )
    run_dir = RunDir(tmp_path / "run")
    run_dir.claim(first).close()
    run_dir.update_config(first, 6)
    assert until(run_dir) == {}
    for changed in (second, third):  # the second trained nothing
        run_dir.update_config(changed, 10)
        assert until(run_dir) == {"config-until-10.json": 1e-3}
        assert run_dir.load_config() == changed
    run_dir.update_config(second, 20)
    assert until(run_dir) == {"config-until-10.json": 1e-3, "config-until-20.json": 3e-4}
    # Updates 13 to 20 are done anew, then 6 to 13 too.
    run_dir.update_config(second, 12)
    assert until(run_dir) == {"config-until-10.json": 1e-3, "config-until-12.json": 3e-4}
    run_dir.update_config(second, 5)
    assert until(run_dir) == {"config-until-5.json": 1e-3}
    # What somebody keeps beside them is no settings of an update.
    own = run_dir.path / "config-until-monday.json"
    own.write_text("{}")
    run_dir.update_config(second, 5)
    assert own.read_text() == "{}"
    own.unlink()
    # With its first settings again all is as it began.
    run_dir.update_config(first, 5)
    assert until(run_dir) == {}
    assert run_dir.load_config() == first


def test_versions_that_ruled_are_kept(tmp_path, config, monkeypatch):
    """The settings are the same, but other sources go on with the run."""
    run_dir = RunDir(tmp_path / "run")
    run_dir.claim(config).close()
    monkeypatch.setattr(run_directory, "versions", lambda: {"commit": "later"})
    for _ in range(2):  # the second finds what the first left
        run_dir.update_config(config, 10)
        assert list(until(run_dir)) == ["config-until-10.json"]
    before, now = (
        json.loads((run_dir.path / name).read_text())["versions"]
        for name in ("config-until-10.json", "config.json")
    )
    assert before["python"] == platform.python_version()
    assert now == {"commit": "later"}


def test_rollouts_are_episodes_of_the_world_at_hand(tmp_path):
    """The settings that a run leaves say how long they are; an older one without a checkpoint, 0, starts alike."""
    path = tmp_path / "run"
    given = [
        "--set=episode_decisions=7",
        "--num-envs=4",
        "--num-minibatches=2",
        f"--run-dir={path}",
    ]
    begun = open_session.open_session(parse_request(PPOConfig, given))
    begun.lock.close()
    assert begun.config.choices_per_update == 7
    kept = json.loads((path / "config.json").read_text())
    assert kept["config"]["rollout_length"] == 7
    kept["config"]["rollout_length"] = 0
    (path / "config.json").write_text(json.dumps(kept))
    again = open_session.open_session(parse_request(PPOConfig, [f"--resume={path}"]))
    again.lock.close()
    assert again.config == begun.config


def test_an_older_run_goes_on_with_rollouts_of_an_episode_of_paper():
    """Its settings say 0, which was 600 choices in any world and 150 of agents; more or fewer are refused."""
    for agents, was in (("none", 600), ("ippo", 150)):
        before = PPOConfig(agents=agents)
        request = Request(before.for_episodes(360), None, None)
        with pytest.raises(InputError, match=f"rollout_length 360, which was {was} until now"):
            open_session._restored(before, None, request, None)


def test_a_process_that_claimed_nothing_removes_nothing(probe, monkeypatch):
    """If compiling fails, processes other than the first leave the directory alone, because it is not theirs."""
    (probe / "config.json").write_text("mine")
    monkeypatch.setattr(open_session, "is_first", lambda: False)
    monkeypatch.setattr(session, "is_first", lambda: False)
    begun = open_session.open_session(parse_request(PPOConfig, TINY))
    monkeypatch.setattr(begun, "_compile", lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        begun.train()
    assert (probe / "config.json").read_text() == "mine"

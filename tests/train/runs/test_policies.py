"""The policies of a run, in its own world and in others."""

import pytest

from medjax.errors import InputError
from medjax.scenarios import prepare
from train.algorithms import environments
from train.algorithms.ppo.settings import PPOConfig
from train.runs.policies import load_weights
from train.runs.run_directory import RunDir
from train.runs.trained_run import to_play


def test_what_does_not_fit_is_said_in_the_words_of_who_asked(tmp_path, monkeypatch):
    """A number of --set or the preset, not the arrays of the network; numbers that leave sizes alone may change."""
    monkeypatch.setattr(
        "train.runs.policies.make_environment",
        lambda config: environments._build(prepare, config)[:2],  # computes no coils
    )
    run = RunDir(tmp_path / "run")
    run.claim(PPOConfig()).close()
    (run.path / "checkpoints").mkdir()
    (run.path / "checkpoints" / "1.npz").write_bytes(b"")
    for scenario, changes, words in (
        (None, {"num_ramps": 3}, "with num_ramps 3 there are .* 4 actions, .* with num_ramps 4$"),
        ("corridor", {}, "with scenario corridor there are .* with scenario paper$"),
        (None, {"cooldown_s": 30}, "1.npz is damaged"),
        ("realistic", {}, "1.npz is damaged"),  # which has as many ramps
    ):
        with pytest.raises(InputError, match=words):
            load_weights(run.path, to_play(run.load_config(), scenario, changes))

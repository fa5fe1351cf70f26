"""Results of a run on a probe: they belong to the weights that the run holds."""

import pytest

from medjax.errors import InputError
from medjax.policies.given import check_policy
from medjax.policies.saved import load_policy
from tests.train.conftest import TINY
from tests.train.runs.conftest import QUIET
from train import export, ppo
from train.runs import results

RESULTS = ("policy.zip", "evaluation.json", "summary.json")


def test_a_run_that_dies_leaves_no_results_of_earlier_weights(probe, after_update):
    """Results stay until there are other weights; the policy's card then names no returns."""
    assert ppo.main([*TINY, "--run-dir=run"]) == 0
    results = [probe / "run" / name for name in RESULTS]
    more = ["--resume=run", "--total-timesteps=128", "--updates-per-call=1"]
    for update, left in ((7, True), (8, False)):  # a checkpoint follows every second update
        after_update(update, lambda: 1 / 0)
        if update == 8:
            more.append("--checkpoint-interval=1")
        with pytest.raises(ZeroDivisionError):
            ppo.main(more)
        assert [path.exists() for path in results] == [left] * 3
    with pytest.raises(InputError, match=r"run holds no policy.zip; python -m train.export"):
        check_policy("run:run")  # rather than play what was learned before
    assert export.main(["--run-dir=run"]) == 0
    assert "evaluation" not in load_policy(probe / "run" / "policy.zip").about.training


def test_ctrl_c_after_the_closing_evaluation_keeps_it(probe, monkeypatch, at_a_terminal, capsys):
    """Here while the curve is drawn."""
    drawn = results.plot_curve

    def interrupted(*given):
        monkeypatch.setattr(results, "plot_curve", drawn)
        raise KeyboardInterrupt

    monkeypatch.setattr(results, "plot_curve", interrupted)
    assert ppo.main([*TINY, "--run-dir=run"]) == 130
    assert capsys.readouterr().err.startswith("interrupted after the last update")
    assert (probe / "run" / "evaluation.json").exists()
    assert "evaluation" in load_policy(probe / "run" / "policy.zip").about.training


def test_rollouts_that_are_no_whole_episodes_are_announced(probe, capsys):
    """Settings of a run in another world may hold such a length."""
    assert ppo.main([*QUIET, "--run-dir=cut"]) == 0
    assert "6 updates of 4 x 4 choices (an episode has 5), " in capsys.readouterr().out
    assert ppo.main([*QUIET, "--rollout-length=10", "--run-dir=whole"]) == 0
    assert "3 updates of 4 x 10 choices, " in capsys.readouterr().out

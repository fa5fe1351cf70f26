"""The soak's command line; tests/test_invariants.py has what it finds and shows."""

import signal

import numpy as np
import pytest

from benchmarks.verification import cases, soak
from benchmarks.verification.invariants import INVARIANTS
from benchmarks.verification.random_worlds import draw_config
from tests.benchmarks.refusal import refused


def test_stopping_prints_the_counts_so_far(monkeypatch, capsys):
    """Ctrl-C in the second case."""

    class Stopped:
        """A case that plays 100 updates; the second one is interrupted."""

        compile_s, config, num_envs = 0.0, draw_config(0, 0), 1

        def __init__(self, seed, number, num_envs):
            self.seed, self.number = seed, number

        def play(self, episode):
            if self.number == 1:
                raise KeyboardInterrupt
            quiet = np.zeros((1, len(INVARIANTS)), np.int32)
            return cases.Played(None, np.array([100]), quiet, np.array([cases.NEVER]), None)

    monkeypatch.setattr(soak, "Case", Stopped)
    with pytest.raises(SystemExit) as ended:
        soak.main(["--updates=200", "--cases=2"])
    assert ended.value.code == 128 + signal.SIGINT  # it must not pass for a whole soak
    out = capsys.readouterr().out
    assert "stopped" in out
    assert "100 vehicle updates" in out


@pytest.mark.parametrize(
    ("argv", "word"),
    [
        ("--updates none", "'none'"),
        ("--updates 0", "'0'"),
        ("--updates inf", "'inf'"),
        ("--seed -1", "--seed"),
        ("--num-envs 0", "--num-envs"),
        ("--case 1", "--environment"),
        ("--case 1 --environment 256", "--environment 256"),
        ("--json /no/such/folder/result.json", "allowed a file"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(argv, word, capsys):
    assert word in refused(soak.main, argv.split(), capsys)

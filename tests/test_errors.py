"""Bad input is one line; a mistake in the code is a traceback, and not called bad input."""

import pytest

import benchmarks.speed.throughput
import medjax
import medjax.render.__main__
import medjax.trajectories
import train.ppo
from medjax.errors import InputError

COMMANDS = {
    "medjax.trajectories": (medjax.trajectories.main, ["--out", "a.csv"]),
    "medjax.render": (medjax.render.__main__.main, ["--out", "a.html"]),
    "train.ppo": (train.ppo.main, ["--run-dir", "run"]),
    "benchmarks.throughput": (benchmarks.speed.throughput.main, ["--num-envs", "4"]),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_mistake_in_the_code_is_not_called_bad_input(command, monkeypatch, tmp_path):
    """Where a function deep inside raises ValueError, so does the command."""

    def broken(*_):
        raise ValueError("a mistake")

    main, arguments = COMMANDS[command]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("medjax.scenarios.check_numbers", broken)
    with pytest.raises(ValueError, match="a mistake"):
        main(arguments)


def test_bad_input_is_a_value_error():
    """So that who catches ValueError catches it; its type tells it from others."""
    with pytest.raises(InputError, match="cooldown_s"):
        medjax.make(cooldown_s=-1)
    assert issubclass(InputError, ValueError)


def test_a_message_is_one_line_whatever_it_names():
    """Names of files may hold line ends and what no terminal shows; an absolute path stays whole."""
    path = "/" + "a" * 300
    assert str(InputError(f"cannot read a\nb\x1b[2J in {path}")) == (
        f"cannot read a b\\x1b[2J in {path}"
    )

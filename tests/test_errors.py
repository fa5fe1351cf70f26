"""Bad input gives one line, a bug in the code a traceback."""

import signal

import pytest

import benchmarks.speed.throughput
import medjax
import medjax.render.__main__
import medjax.trajectories
import train.ppo
from medjax.commandline import command
from medjax.errors import InputError

COMMANDS = {
    "medjax.trajectories": (medjax.trajectories.main, ["--out", "a.csv"]),
    "medjax.render": (medjax.render.__main__.main, ["--out", "a.html"]),
    "train.ppo": (train.ppo.main, ["--run-dir", "run"]),
    "benchmarks.throughput": (benchmarks.speed.throughput.main, ["--num-envs", "4"]),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_bug_is_not_reported_as_bad_input(command, monkeypatch, tmp_path):
    """A ValueError from deep inside leaves the command as it is."""

    def broken(*_):
        raise ValueError("a mistake")

    main, arguments = COMMANDS[command]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("medjax.scenarios.check_numbers", broken)
    with pytest.raises(ValueError, match="a mistake"):
        main(arguments)


def test_bad_input_is_a_value_error():
    with pytest.raises(InputError, match="cooldown_s"):
        medjax.make(cooldown_s=-1)
    assert issubclass(InputError, ValueError)


def test_messages_escape_line_ends_and_control_characters():
    """An absolute path stays whole."""
    path = "/" + "a" * 300
    assert str(InputError(f"cannot read a\nb\x1b[2J in {path}")) == (
        f"cannot read a b\\x1b[2J in {path}"
    )


def test_sigterm_ends_a_command_in_a_line(capsys):
    @command
    def main(argv):
        signal.raise_signal(signal.SIGTERM)
        return 0

    before = signal.getsignal(signal.SIGTERM)
    assert main([]) == 128 + signal.SIGTERM
    assert capsys.readouterr().err == "interrupted\n"
    assert signal.getsignal(signal.SIGTERM) is before

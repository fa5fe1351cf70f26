"""Signals while a command is imported; each in a process of its own that signals itself at a known import."""

import importlib.machinery
import os
import signal
import subprocess
import sys
import time
from typing import ClassVar

import pytest

from medjax import early
from medjax.commandline import command
from tests.documented import ROOT

SIGNALS = ["SIGINT", "SIGTERM"]


@pytest.fixture(autouse=True)
def heard():
    """As at a terminal: a child does not inherit that SIGINT is ignored."""
    numbers = [getattr(signal, name) for name in SIGNALS]
    before = {number: signal.getsignal(number) for number in numbers}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def run(folder, *words):
    """A Python that finds modules in a folder first."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}
    environment.pop("TF_CPP_MIN_LOG_LEVEL", None)
    return subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True
    )


@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize(
    ("module", "imported"),
    [("train.ppo", "yaml"), ("medjax.render", "jax"), ("benchmarks.leaderboard", "jax")],
)
def test_a_signal_while_it_is_imported_ends_a_command_in_a_line(tmp_path, module, imported, name):
    """Before its `main` begins; and XLA is told to be quiet before anything imports JAX, which tells it otherwise."""
    number = getattr(signal, name)
    (tmp_path / f"{imported}.py").write_text(
        "import os, signal\n"
        "print(os.environ.get('TF_CPP_MIN_LOG_LEVEL'), flush=True)\n"
        f"signal.raise_signal({int(number)})\n"
    )
    ended = run(tmp_path, "-m", module, "--help")
    assert (ended.returncode, ended.stdout, ended.stderr) == (128 + number, "3\n", "interrupted\n")


def test_ctrl_c_while_main_imports_jax_ends_it_in_a_line(tmp_path):
    """An extension that is interrupted as it is loaded says so in an error of its own, or crashes."""
    (tmp_path / "jax.py").write_text(
        "import signal\n"
        "try:\n    signal.raise_signal(signal.SIGINT)\n"
        "except KeyboardInterrupt:\n    raise ImportError('while initializing the extension') from None\n"
    )
    ended = run(tmp_path, "-m", "train.ppo", "--run-dir=new")
    assert (ended.returncode, ended.stderr) == (130, "interrupted\n")


class ExtensionFileLoader:
    """Stands for Python's, whose frames are in sight while an extension is initialised."""

    loaded: ClassVar[list[str]] = []

    def exec_module(self, name):
        """Signals in the midst of it."""
        signal.raise_signal(getattr(signal, name))
        self.loaded.append(name)


@pytest.mark.parametrize("name", SIGNALS)
def test_an_extension_that_is_being_loaded_is_loaded_first(name, capsys):
    """It would make an ImportError of what is raised within it."""

    @command
    def main(argv):
        ExtensionFileLoader().exec_module(name)
        time.sleep(60.0)
        return 0

    pythons = importlib.machinery.ExtensionFileLoader.exec_module
    assert pythons.__code__.co_qualname == ExtensionFileLoader.exec_module.__code__.co_qualname
    assert main([]) == 128 + getattr(signal, name)
    assert ExtensionFileLoader.loaded[-1] == name
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.parametrize("name", SIGNALS)
def test_from_main_on_the_command_hears_it(name, capsys):
    """It can save what it has."""
    for each in SIGNALS:
        signal.signal(getattr(signal, each), early.end)
    caught = []

    @command
    def main(argv):
        try:
            signal.raise_signal(getattr(signal, name))
        except KeyboardInterrupt as error:
            caught.append(error)
            raise
        return 0

    assert main([]) == 128 + getattr(signal, name)
    assert len(caught) == 1
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.parametrize("words", [("-c", "import mine.__main__"), ("-m", "mine")])
def test_other_programs_keep_their_signals(tmp_path, words):
    """Whoever imports medjax, at whatever moment."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/__init__.py").write_text("import medjax, train, benchmarks\n")
    (tmp_path / "mine/__main__.py").write_text(
        "import os, signal\n"
        "assert signal.getsignal(signal.SIGINT) is signal.default_int_handler\n"
        "assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL\n"
        "assert 'TF_CPP_MIN_LOG_LEVEL' not in os.environ\n"
    )
    ended = run(tmp_path, *words)
    assert (ended.returncode, ended.stderr) == (0, "")

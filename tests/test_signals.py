"""Ctrl-C and SIGTERM end a command in a line, wherever they reach it."""

import gc
import importlib.machinery
import os
import signal
import subprocess
import sys
import time
from typing import ClassVar

import pytest

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
def test_a_signal_during_garbage_collection_is_not_lost(name, capsys):
    """Python prints and drops what a callback of the collector raises; JAX has one."""
    collected = []

    def callback(phase, info):
        if not collected:
            collected.append(phase)
            signal.raise_signal(getattr(signal, name))

    @command
    def main(argv):
        gc.callbacks.append(callback)
        gc.collect()
        time.sleep(60.0)
        return 0

    try:
        assert main([]) == 128 + getattr(signal, name)
    finally:
        gc.callbacks.remove(callback)
    assert collected == ["start"]
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.parametrize("name", SIGNALS)
def test_a_command_can_save_what_it_has(name, capsys):
    """The signal is raised in `main`; afterwards the handlers are those of before."""
    before = [signal.getsignal(getattr(signal, each)) for each in SIGNALS]
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
    assert [signal.getsignal(getattr(signal, each)) for each in SIGNALS] == before


def test_an_ignored_ctrl_c_stays_ignored():
    """As `nohup` and shells in the background start a command."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    @command
    def main(argv):
        signal.raise_signal(signal.SIGINT)
        return 0

    assert main([]) == 0


@pytest.mark.parametrize("words", [("-c", "import mine.__main__"), ("-m", "mine")])
def test_other_programs_keep_their_signals_and_settings(tmp_path, words):
    """Whoever imports medjax, at whatever moment."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/__init__.py").write_text("import medjax, train, benchmarks\n")
    (tmp_path / "mine/__main__.py").write_text(
        "import os, signal\n"
        "assert signal.getsignal(signal.SIGINT) is signal.default_int_handler\n"
        "assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL\n"
        "assert 'TF_CPP_MIN_LOG_LEVEL' not in os.environ\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    environment.pop("TF_CPP_MIN_LOG_LEVEL", None)
    command = [sys.executable, *words]
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize(
    ("module", "imported"),
    [("train.ppo", "yaml"), ("medjax.render", "jax"), ("benchmarks.leaderboard", "jax")],
)
def test_a_command_silences_xlas_log_before_jax_is_imported(tmp_path, module, imported):
    """JAX sets a default of its own."""
    (tmp_path / f"{imported}.py").write_text(
        "import os\nprint(os.environ.get('TF_CPP_MIN_LOG_LEVEL'), flush=True)\nos._exit(0)\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    environment.pop("TF_CPP_MIN_LOG_LEVEL", None)
    command = [sys.executable, "-m", module, "--help"]
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert ended.stdout == "3\n"

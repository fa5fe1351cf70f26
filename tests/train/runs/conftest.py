"""A run that nothing interrupts, and events that happen in other runs after some update."""

import signal

import pytest

from tests.compiling import quickly
from tests.train.conftest import STAND_INS, TINY
from train import ppo
from train.runs.logs import Progress

QUIET = [*TINY, "--eval-episodes=0", "--updates-per-call=1"]


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """Directory of a run with the options QUIET; tests copy it before they change it."""
    with pytest.MonkeyPatch.context() as patch, quickly():
        for name, stand_in in STAND_INS.items():
            patch.setattr(name, stand_in)
        run = tmp_path_factory.mktemp("whole") / "run"
        assert ppo.main([*QUIET, f"--run-dir={run}"]) == 0
    return run


@pytest.fixture
def at_a_terminal():
    """SIGINT is heeded: whoever starts the tests in the background may leave it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def after_update(monkeypatch):
    """Calls an action once, after an update was shown."""

    def arrange(update, action):
        show = Progress.show

        def show_and_act(self, rows):
            show(self, rows)
            if rows[-1]["update"] == update:
                monkeypatch.setattr(Progress, "show", show)
                action()

        monkeypatch.setattr(Progress, "show", show_and_act)

    return arrange

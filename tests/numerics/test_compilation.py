"""What is said of compiling, and where programs are kept."""

import gc
import os
import signal
import subprocess
import sys
import time
import weakref

import jax
import jax.numpy as jnp
import pytest

import medjax
from medjax.commandline import command
from medjax.numerics import compilation


@pytest.fixture
def prepared(monkeypatch):
    """As a program of one's own is, for the length of a test."""
    listeners = []
    for name in ("register_event_listener", "register_event_duration_secs_listener"):
        monkeypatch.setattr(jax.monitoring, name, listeners.append)
    monkeypatch.setattr(compilation._Messages, "heard", False)
    medjax.prepare_jax()
    medjax.prepare_jax()
    assert len(listeners) == 2  # once each
    monkeypatch.undo()
    begins, ends = listeners
    jax.monitoring.register_event_listener(begins)
    jax.monitoring.register_event_duration_secs_listener(ends)
    yield
    jax.monitoring.unregister_event_listener(begins)
    jax.monitoring.unregister_event_duration_listener(ends)


def test_what_takes_long_is_spoken_of(prepared, monkeypatch, capsys):
    def slow(x):
        for number in range(4):
            x = jnp.sort(x + number) @ x
        return x

    ones = jnp.ones((3, 3))
    jax.jit(lambda x: slow(x) + 1.0)(ones)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(compilation, "SILENT_S", 0.0)
    jax.jit(slow)(ones)
    said = capsys.readouterr().err.splitlines()
    assert said[-1].startswith("compiled ")
    assert said[-1].endswith(" s")
    assert not compilation._Messages.timers


def test_programs_are_kept_where_the_user_keeps_such_things(tmp_path):
    """Unless another place was chosen; a device a core."""
    code = "import medjax, jax; medjax.prepare_jax(); print(jax.config.jax_compilation_cache_dir, jax.device_count())"
    environment = {name: text for name, text in os.environ.items() if not name.startswith("JAX_")}
    cores = len(os.sched_getaffinity(0))
    for chosen, place in (
        ({}, f"{tmp_path}/medjax/xla"),
        ({"JAX_COMPILATION_CACHE_DIR": "x"}, "x"),
    ):
        said = subprocess.run(
            [sys.executable, "-c", code],
            env=environment | {"XDG_CACHE_HOME": str(tmp_path), "JAX_PLATFORMS": "cpu"} | chosen,
            capture_output=True,
            text=True,
            check=True,
        )
        assert said.stdout.split() == [place, str(cores)]


class Slow:
    """Compiles for longer than anybody waits."""

    def compile(self):
        time.sleep(20.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("place", ["collection", "weak reference", "finaliser"])
def test_a_signal_where_errors_are_forgotten_is_heard(place, number):
    """Python prints what is raised there and goes on; JAX has a callback of the collector that runs as it traces."""
    signalled = []

    def signals(*_):
        if not signalled:
            signalled.append(place)
            signal.raise_signal(number)

    class Finalised:
        def __del__(self):
            if place == "finaliser":
                signals()

    @command
    def main(argv):
        value = Finalised()
        if place == "collection":
            gc.callbacks.append(signals)
        if place == "weak reference":
            weakref.finalize(value, signals)
        del value
        gc.collect()
        if place == "collection":
            gc.callbacks.remove(signals)
        time.sleep(5.0)
        return 0

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    handlers = signal.getsignal(signal.SIGTERM)
    try:
        assert main([]) == 128 + number
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        assert signal.getsignal(signal.SIGTERM) is handlers
    finally:
        signal.signal(signal.SIGINT, before)
    assert signalled


def test_a_signal_is_heard_while_something_is_compiled():
    """As at a terminal, where Python has its own handler."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    alarm = signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
    start = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            compilation.compiled(Slow())
    finally:
        signal.signal(signal.SIGINT, before)
        signal.signal(signal.SIGALRM, alarm)
    assert time.monotonic() - start < 10.0


def test_what_compiling_refuses_is_raised():
    class Fails:
        def compile(self):
            raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        compilation.compiled(Fails())

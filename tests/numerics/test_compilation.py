"""Messages about compilation, the cache of programs, and signals meanwhile."""

import hashlib
import os
import signal
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import pytest

import medjax
from medjax.numerics import compilation


@pytest.fixture
def prepared(monkeypatch):
    """`prepare_jax` announces compilations during one test."""
    listeners = []
    for name in ("register_event_listener", "register_event_duration_secs_listener"):
        monkeypatch.setattr(jax.monitoring, name, listeners.append)
    compilation._announce_compiling.cache_clear()
    medjax.prepare_jax()
    medjax.prepare_jax()
    assert len(listeners) == 2  # once each
    monkeypatch.undo()
    compilation._announce_compiling.cache_clear()
    begins, ends = listeners
    jax.monitoring.register_event_listener(begins)
    jax.monitoring.register_event_duration_secs_listener(ends)
    yield
    jax.monitoring.unregister_event_listener(begins)
    jax.monitoring.unregister_event_duration_listener(ends)


def test_long_compilations_are_announced(prepared, monkeypatch, capsys):
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
    assert not compilation._timers


def test_programs_are_cached_in_the_users_cache_directory(tmp_path):
    """Unless the user chose another; and each core is a device."""
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
    """Compiles for a second or so in one call of C, as XLA does: it lets other threads run, and hears no signal."""

    def compile(self):
        hashlib.pbkdf2_hmac("sha256", b"", b"", 4_000_000)


def seconds_until_interrupted(call):
    """Of a call that gets SIGINT after a moment, with Python's own handler, as at a terminal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    alarm = signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
    start = time.monotonic()
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises(KeyboardInterrupt):
            call()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGINT, before)
        signal.signal(signal.SIGALRM, alarm)
    return time.monotonic() - start


def test_a_signal_interrupts_compilation():
    """In the main thread itself the stub would be heard out first."""
    heard_out = seconds_until_interrupted(Slow().compile)
    assert seconds_until_interrupted(lambda: compilation.compiled(Slow())) < 0.5 * heard_out


def test_errors_of_the_compiler_are_raised():
    class Fails:
        def compile(self):
            raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        compilation.compiled(Fails())

"""Fixtures and settings for the whole session."""

import gc
import os
from pathlib import Path

# Files, workers, subprocesses and later runs share compiled programs. Set before JAX is imported, which reads it.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    programs = Path(__file__).parents[1] / ".pytest_cache" / "programs"
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(programs)
    # Small programs too: most of what is compiled are thousands of single operations.
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"

import jax
import jaxtyping
import pytest
from hypothesis import settings

import tests.shape_checker  # noqa: F401, jaxtyping finds it by its name and imports only `tests`

# Before these modules are imported: each call checks its arguments and results against the shapes of its annotations.
SHAPED = ["physics", *(f"traffic.{name}" for name in ("idm", "mobil", "motion", "neighbours"))]
modules = [f"medjax.{name}" for name in SHAPED]
jaxtyping.install_import_hook(modules, "tests.shape_checker.shapes_only")

import medjax
from tests.compiling import quickly
from tests.refusals import AcceptedError
from tests.render.browser import chromium_program

# Two devices on any machine, among which training shares its environments. JAX starts here, so that XLA's options do
# not depend on which test runs first: `prepare_cpu` sets some, which only the commands that tests start take over.
jax.config.update("jax_num_cpu_devices", 2)
jax.devices()

# The same examples in every run; HYPOTHESIS_PROFILE=default draws new ones.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


# Files of half a minute or more go first, so that no worker is left alone with one at the end.
LONG = {
    *("test_invariants", "test_bits", "test_agents_run", "test_notebook", "test_surface"),
    *("test_scenarios", "test_demand", "test_processes", "test_killed", "test_determinism"),
    *("test_report", "test_docs", "test_x64", "test_gradients", "test_site", "test_player"),
    *("test_learner", "test_end_to_end"),
}


def pytest_configure(config):
    """Otherwise pytest-xdist would begin with the files that have the most tests, which are short."""
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: item.path.stem not in LONG)


def pytest_collection_finish():
    """The garbage collector need not look at imported modules again and again while JAX traces."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)


@pytest.fixture(scope="session")
def paper():
    """The default environment and its numbers."""
    return medjax.make("paper")


@pytest.fixture(scope="session")
def started(paper):
    """A state at reset."""
    env, params = paper
    return jax.jit(env.reset)(jax.random.key(0), params)


@pytest.fixture(scope="module")
def quick_compiles():
    """`tests.compiling.quickly` for a whole file."""
    with quickly():
        yield


@pytest.fixture
def nothing_starts(monkeypatch):
    """Fails the test if anything compiles; commands end at their first program, the coils' table."""
    compiled = []

    def listen(event, duration, **_):
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(duration)

    def accepted(*_, **__):
        raise AcceptedError

    monkeypatch.setattr("medjax.scenarios.build_link", accepted)
    jax.monitoring.register_event_duration_secs_listener(listen)
    yield
    jax.monitoring.unregister_event_duration_listener(listen)
    assert not compiled


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium."""
    playwright = pytest.importorskip("playwright.sync_api", reason="drives the browser")
    if chromium_program() is None:
        pytest.skip("no Chromium here (Debian: apt-get install chromium)")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium_program(), args=["--no-sandbox"])
        yield browser
        browser.close()

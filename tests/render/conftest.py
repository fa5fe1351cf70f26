"""One short episode of a small highway, recordings made by hand, and pages of the player."""

import dataclasses

import jax
import numpy as np
import pytest

import medjax
from medjax.episodes.recording import record_episode
from medjax.policies.rules import BASELINES
from medjax.render.player import write_player
from tests.compiling import quickly
from tests.render.browser import shared_pages
from tests.render.made import busy, parked

SMALL = {
    "num_meds": 3,
    "num_evs": 12,
    "num_gas": 20,
    "mainline_per_h": 600.0,
    "ev_share": 0.4,
    "arrival_soc_high": 0.5,
    "episode_decisions": 90,
}


@pytest.fixture(scope="session")
def world():
    return medjax.make("paper", **SMALL)


@pytest.fixture(scope="session")
def recording(world):
    """An episode of the rule `periodic`: MEDs come, EVs charge and run out."""
    env, params = world
    policy = BASELINES["periodic"](env)
    with quickly():
        return record_episode(env, params, policy, name="periodic", seed=3, episode=9)


@pytest.fixture(scope="session")
def freight():
    """Ten minutes of few lorries at changing prices: EVs take plugs, and a vehicle breaks down at 100 s for 120 s."""
    sizes = {"num_meds": 4, "num_evs": 24, "num_gas": 48, "num_incidents": 1}
    incident = {"incident_from_s": 100.0, "incident_until_s": 100.0, "incident_s": 120.0}
    env, params = medjax.make(
        "freight", **sizes, **incident, start_s=13.9 * 3600.0, episode_decisions=60
    )
    policy = BASELINES["periodic"](env)
    with quickly():
        return record_episode(env, params, policy, name="periodic", seed=3)


@pytest.fixture(scope="session")
def other(recording):
    """The same traffic without its MEDs, since playing a second episode would take as long again."""
    frames, decisions = jax.tree.map(np.copy, (recording.frames, recording.decisions))
    frames.active[:, recording.config.med_slots] = False
    frames.ev_med[:] = frames.ev_charging_slot[:] = -1
    frames.ev_is_charging[:] = False
    decisions.sent[:] = 0
    return dataclasses.replace(recording, policy="none", frames=frames, decisions=decisions)


@pytest.fixture(scope="session")
def still():
    """Known vehicles at known places."""
    return parked()


@pytest.fixture(scope="session")
def full():
    """600 decisions of a full highway."""
    return busy()


@pytest.fixture(scope="module")
def pages(browser):
    """The function of `shared_pages`, for all tests of a file."""
    with shared_pages(browser) as page_of:
        yield page_of


@pytest.fixture(scope="module")
def one(recording, tmp_path_factory):
    """The player's page of one recording."""
    path = tmp_path_factory.mktemp("player") / "one.html"
    write_player(path, [recording])
    return path


@pytest.fixture(scope="module")
def two(recording, other, tmp_path_factory):
    """The player's page of two recordings side by side."""
    path = tmp_path_factory.mktemp("player") / "two.html"
    write_player(path, [recording, other])
    return path

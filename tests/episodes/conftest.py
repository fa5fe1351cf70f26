"""A short episode: written in pieces by `python -m medjax.trajectories`, recorded whole, and as a table."""

import pytest

import medjax
import medjax.episodes.options
import medjax.episodes.recording
from medjax.episodes.recording import record_episode, record_pieces
from medjax.episodes.table import vehicle_table
from medjax.policies.rules import paced
from medjax.trajectories import main
from tests.compiling import quickly

WORLD = {
    "num_meds": 3,
    "num_evs": 12,
    "num_gas": 12,
    "mainline_per_h": 800,
    "ev_share": 0.4,
    "arrival_soc_high": 0.3,
    "episode_decisions": 90,
    "slope": 0.002,
}
SET = [text for name, value in WORLD.items() for text in ("--set", f"{name}={value}")]


@pytest.fixture(scope="session")
def played(tmp_path_factory):
    """The pieces that the command played, of 23, 23, 23 and 21 decisions, and the file that it wrote."""
    target = tmp_path_factory.mktemp("out") / "run.csv"
    slots = 25 * 4 * sum(WORLD[name] for name in ("num_meds", "num_evs", "num_gas"))
    made = []

    def record(*args, **kwargs):
        for piece in record_pieces(*args, **kwargs):
            made.append(piece)
            yield piece

    asked = ["--policy", "paced", "--scenario", "paper", "--seed", "3", "--episode", "1"]
    with pytest.MonkeyPatch.context() as patch, quickly():
        patch.setattr(medjax.episodes.recording, "SLOTS_OF_A_PIECE", slots)
        patch.setattr(medjax.episodes.options, "record_pieces", record)
        assert main([*asked, *SET, "--out", str(target)]) == 0
    return made, target


@pytest.fixture(scope="session")
def recording():
    """The same episode in one piece."""
    with quickly():
        env, params = medjax.make("paper", **WORLD)
        return record_episode(env, params, paced(env), name="paced", seed=3, episode=1)


@pytest.fixture(scope="session")
def table(recording):
    return vehicle_table(recording)

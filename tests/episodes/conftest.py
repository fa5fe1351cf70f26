"""One short episode that the command `python -m medjax.trajectories` recorded, and its table."""

import pytest

import medjax.episodes.options
from medjax.episodes.table import vehicle_table
from medjax.trajectories import main

WORLD = {
    "num_meds": 3,
    "num_evs": 12,
    "num_gas": 12,
    "mainline_per_h": 800,
    "ev_share": 0.4,
    "arrival_soc_high": 0.3,
    "episode_decisions": 90,
}
SET = [text for name, value in WORLD.items() for text in ("--set", f"{name}={value}")]


@pytest.fixture(scope="module")
def played(quick_compiles, tmp_path_factory):
    """The recording that the command made, and the file that it wrote."""
    target = tmp_path_factory.mktemp("out") / "run.csv"
    made = []
    record = medjax.episodes.options.record_episode
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            medjax.episodes.options,
            "record_episode",
            lambda *args, **kwargs: made.append(record(*args, **kwargs)) or made[0],
        )
        asked = ["--policy", "paced", "--scenario", "paper", "--seed", "3", "--episode", "1"]
        assert main([*asked, *SET, "--out", str(target)]) == 0
    return made[0], target


@pytest.fixture(scope="module")
def recording(played):
    return played[0]


@pytest.fixture(scope="module")
def table(recording):
    return vehicle_table(recording)

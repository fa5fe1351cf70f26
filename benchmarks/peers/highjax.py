"""HighJax, which is highway-env written in JAX, on its own straight road with a given number of vehicles."""

import json
import subprocess
from pathlib import Path

from benchmarks.peers import Peer, Rate
from medjax.errors import InputError, shown

WORKER = Path(__file__).with_name("highjax_worker.py")
INSTALL = "python3.13 -m venv hj && hj/bin/pip install --ignore-requires-python highjax==0.1.0"
OWN_VEHICLES = 51  # on a road of its default environment, the one that acts included
NUM_ROADS, DECISIONS = 16, 20  # 4, 64 and 256 roads at once are as fast on two cores
PATIENCE_S = 600.0


def ask(python: str, *numbers: int) -> dict[str, float | str]:
    """What the worker prints in the interpreter `python`: versions, and with numbers a measurement.

    Raises:
        InputError: there is no HighJax at that interpreter, or it fails.
    """
    # -P: beside the worker lies this module, which has the name of the package that it imports.
    command = [python, "-P", str(WORKER), *map(str, numbers)]
    why = "it does not start"
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
        why = (done.stderr.strip() or "it gives no figures").splitlines()[-1]
        answer: dict[str, float | str] = json.loads(done.stdout)
    except (OSError, ValueError, subprocess.TimeoutExpired):
        raise InputError(
            f"--highjax is {shown(python)}, which does not run HighJax: {shown(why)}; allowed: the Python of {INSTALL}"
        ) from None
    return answer


class HighJax(Peer):
    """HighJax's highway, many at once in one process on all cores, in an environment of its own."""

    package = "highjax"
    differences = (
        "It moves many roads in one process on all cores, in single precision, as medjax does, compilation left out.",
        "It makes 15 sub-steps of a fifteenth of a second in each decision, medjax four of a quarter; an update is "
        "one vehicle in one of them.",
        "Its road is straight, without ramps, demand or exits; all vehicles stay, and an episode ends after 40 "
        "decisions or when the vehicle that acts has an accident, in which it is reset.",
        "Every vehicle looks through all others for its neighbours and for collisions, so its cost grows with the "
        "square of their number.",
        "It does car following, lane changes, steering, collisions, observation and reward; no batteries, charging, "
        "dispatch or driver noise.",
    )

    def __init__(self, python: str, num_vehicles: int) -> None:
        """Takes the interpreter that has HighJax, and the number of vehicles of a road."""
        self.python, self.num_vehicles = python, num_vehicles
        self.name = f"HighJax, {num_vehicles}"
        self.measured = "unknown"

    def version(self) -> str:
        """The version that the interpreter has."""
        return self.measured

    def measure(self) -> Rate:
        """Times some decisions, after as many for warm-up."""
        answer = ask(self.python, self.num_vehicles, NUM_ROADS, DECISIONS)
        self.measured = str(answer["version"])
        return Rate(float(answer["updates_per_s"]), self.num_vehicles)

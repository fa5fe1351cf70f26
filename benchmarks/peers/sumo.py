"""SUMO on the road of medjax: netconvert's network, IDM, and the same demand, tick and time span."""

import subprocess
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

from benchmarks.peers import Peer, Rate, World
from benchmarks.peers.sumo_road import RAMP_M, Period, build_demand, build_network, finish, start


class Sumo(Peer):
    """The `sumo` program in one process per core, each with its own road."""

    name = "SUMO"
    package = "eclipse-sumo"
    differences = (
        "It moves one road in each process, one process a core at the same time; their rates are added.",
        "It is timed by its own clock over one episode, from a saved state of a road that has filled "
        "for one episode; starting it and loading (about 0.1 s) are left out.",
        "Its lane changes are LC2013, its default: more detailed than MOBIL (it plans for lanes that "
        "end and drivers cooperate), and without a duty to keep right.",
        "It does car following and lane changes only: no MEDs, batteries, charging, driver noise, "
        "observation, reward or reset, and it writes no output but its summary.",
        f"It starts ramp traffic {RAMP_M:g} m before the acceleration lane and counts it there too.",
        "It computes in double precision, medjax in single.",
        "Generous to it: junctions have no lanes of their own, which makes it about a quarter faster.",
    )

    def __init__(self, workload: World) -> None:
        """Builds the network and the demand, and fills one road for each core."""
        self.workload = workload
        config, params, folder = workload.config, workload.params, workload.folder
        whole = Period(0.0, 2.0 * workload.span_s + 1.0, params)
        self.network = build_network(config, params, folder)
        self.demand = build_demand(config, [whole], folder)
        self._together(self._fill(seed) for seed in range(workload.cores))

    def _file(self, seed: int, name: str) -> Path:
        return self.workload.folder / f"road{seed}.{name}"

    def _start(self, seed: int, begin: float, end: float, *options: str) -> subprocess.Popen[str]:
        """Starts SUMO on road `seed` from `begin` to `end` (s); its statistics go to the road's file."""
        command = ["sumo", "--net-file", str(self.network), "--route-files", str(self.demand)]
        command += ["--begin", str(begin), "--end", str(end), "--seed", str(seed)]
        command += ["--step-length", str(self.workload.config.tick_s)]
        command += ["--step-method.ballistic", "true"]  # as in medjax
        command += ["--time-to-teleport", "-1"]  # never removes waiting vehicles
        command += ["--no-step-log", "true", "--no-warnings", "true"]
        command += ["--statistic-output", str(self._file(seed, "statistics.xml")), *options]
        return start(command)

    def _fill(self, seed: int) -> subprocess.Popen[str]:
        """Starts SUMO for one episode on the empty road `seed`, whose state it saves."""
        # SUMO saves a state at the start of a step, so one more step has to follow.
        span, tick = self.workload.span_s, self.workload.config.tick_s
        state = ["--save-state.files", str(self._file(seed, "state.xml.gz"))]
        return self._start(seed, 0.0, span + tick, "--save-state.times", str(span), *state)

    def resume(self, seed: int, *options: str) -> subprocess.Popen[str]:
        """Starts SUMO for one episode on the filled road `seed`."""
        span = self.workload.span_s
        state = str(self._file(seed, "state.xml.gz"))
        return self._start(seed, span, 2.0 * span, "--load-state", state, *options)

    def _together(self, starting: Iterable[subprocess.Popen[str]]) -> None:
        processes = list(starting)
        try:
            for process in processes:
                finish(process)
        finally:
            for process in processes:
                process.kill()

    def read(self, seed: int) -> Rate:
        """The rate that SUMO itself reports for road `seed`, of vehicles running in each step."""
        root = ElementTree.parse(self._file(seed, "statistics.xml")).getroot()
        performance = root.find("performance")
        if performance is None:
            raise RuntimeError("SUMO's statistics have no performance")
        rate = float(performance.attrib["vehicleUpdatesPerSecond"])
        # SUMO reports wall time to 0.01 s only, so the finer real-time factor gives the step rate.
        steps_per_s = float(performance.attrib["realTimeFactor"]) / self.workload.config.tick_s
        return Rate(rate, rate / steps_per_s)

    def measure(self) -> Rate:
        """Times one episode of all roads at the same time."""
        seeds = range(self.workload.cores)
        self._together(map(self.resume, seeds))
        return Rate.added(list(map(self.read, seeds)))

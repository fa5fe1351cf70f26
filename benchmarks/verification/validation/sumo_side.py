"""SUMO's trajectories on medjax's road under medjax's demand, from one process and one file per episode."""

from __future__ import annotations

import subprocess
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.peers.sumo_road import (
    Period,
    build_demand,
    build_network,
    finish,
    lanes_of_network,
    start,
)
from benchmarks.verification.validation.demands import Schedule
from benchmarks.verification.validation.trajectories import Road, Trajectories
from medjax.world.kinds import WIDTHS_M


class SumoRun:
    """Episodes of one schedule, which start when this is built; `trajectories` waits for them."""

    def __init__(self, schedule: Schedule, episodes: int, seed: int, folder: Path) -> None:
        """Starts a process for each episode; `folder` is for their files and must exist."""
        self.schedule = schedule
        self.files = [folder / f"episode{episode}.csv" for episode in range(episodes)]
        config, params = schedule.config, schedule.params_at(0)
        periods = [
            Period(60.0 * minute, 60.0 * (minute + 1), schedule.params_at(minute))
            for minute in range(schedule.all_minutes)
        ]
        network = build_network(config, params, folder)
        demand = build_demand(config, periods, folder)
        self.processes = [
            self._start(network, demand, 1 + seed * episodes + episode, file)
            for episode, file in enumerate(self.files)
        ]

    def _start(self, network: Path, demand: Path, seed: int, file: Path) -> subprocess.Popen[str]:
        begin, end = 60.0 * self.schedule.warm_up_minutes, 60.0 * self.schedule.all_minutes
        command = ["sumo", "--net-file", str(network), "--route-files", str(demand)]
        command += ["--begin", "0", "--end", str(end), "--seed", str(seed)]
        command += ["--step-length", str(self.schedule.config.tick_s)]
        command += ["--step-method.ballistic", "true"]  # as in medjax
        command += ["--time-to-teleport", "-1"]  # never removes waiting vehicles,
        command += ["--collision.action", "warn"]  # nor vehicles that collide
        command += ["--no-step-log", "true", "--no-warnings", "true"]
        command += ["--fcd-output", str(file), "--device.fcd.begin", str(begin)]
        command += ["--fcd-output.attributes", "id,type,speed,pos,lane"]
        return start(command)

    def trajectories(self) -> Iterator[Trajectories]:
        """The trajectories of each episode after the warm-up."""
        for process, file in zip(self.processes, self.files, strict=True):
            finish(process)
            yield read(file, self.schedule)

    def stop(self) -> None:
        """Ends processes that still run."""
        for process in self.processes:
            process.kill()


def read(file: Path, schedule: Schedule) -> Trajectories:
    """Reads SUMO's floating car data (a CSV file), without the warm-up.

    SUMO's vehicles jump from lane to lane, so their lateral positions are unknown.
    """
    params, tick_s = schedule.params_at(0), schedule.config.tick_s
    lanes = lanes_of_network(schedule.config, params)
    lengths = np.asarray(params.drivers.vehicle_length, float)
    vehicles: dict[str, int] = {}
    tick, vehicle, lane, kind = (array("i") for _ in range(4))
    x, speed = array("d"), array("d")
    first = round(60.0 * schedule.warm_up_minutes / tick_s)
    with file.open(encoding="utf-8") as lines:
        next(lines)
        for line in lines:
            time_s, name, type_name, velocity, place, lane_name = line.rstrip("\n").split(";")
            if not name:  # a step without vehicles
                continue
            start_m, lane_number = lanes[lane_name]
            tick.append(round(float(time_s) / tick_s) - first)
            vehicle.append(vehicles.setdefault(name, len(vehicles)))
            lane.append(lane_number)
            kind.append(int(type_name.removeprefix("kind")))
            x.append(start_m + float(place))
            speed.append(float(velocity))
    ticks, ids = np.array(tick), np.array(vehicle)
    rows = np.lexsort((ticks, ids))
    return Trajectories(
        road=Road.of(schedule.config, params),
        tick_s=tick_s,
        num_ticks=round(60.0 * schedule.minutes / tick_s),
        tick=ticks[rows],
        vehicle=ids[rows],
        lane=np.array(lane)[rows],
        x=np.array(x)[rows],
        speed=np.array(speed)[rows],
        length=lengths[np.array(kind)[rows]],
        width=np.array(WIDTHS_M)[np.array(kind)[rows]],
        lateral=None,
    )

"""Records SUMO's trajectories on medjax's road under medjax's demand, by one process and one file per episode."""

from __future__ import annotations

import contextlib
import tempfile
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.peers import sumo_road
from benchmarks.verification.validation.demands import Schedule
from benchmarks.verification.validation.trajectories import Bodies, Road, Trajectories


@contextlib.contextmanager
def sumo(schedule: Schedule, episodes: int, seed: int) -> Iterator[Iterator[Trajectories]]:
    """Starts a process for each episode. The iterator waits for each and yields its trajectories after the warm-up."""
    config, params = schedule.config, schedule.params_at(0)
    periods = [
        sumo_road.Period(60.0 * minute, 60.0 * (minute + 1), schedule.params_at(minute))
        for minute in range(schedule.all_minutes)
    ]
    begin, end = 60.0 * schedule.warm_up_minutes, 60.0 * schedule.all_minutes
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as started:
        folder = Path(name)
        command = ["sumo", "--net-file", str(sumo_road.build_network(config, params, folder))]
        command += ["--route-files", str(sumo_road.build_demand(config, periods, folder))]
        command += ["--begin", "0", "--end", str(end), "--step-length", str(config.tick_s)]
        command += ["--step-method.ballistic", "true"]  # as in medjax
        # With these options SUMO removes neither vehicles that wait for long nor vehicles that collide.
        command += ["--time-to-teleport", "-1", "--collision.action", "warn"]
        command += ["--no-step-log", "true", "--no-warnings", "true"]
        command += ["--device.fcd.begin", str(begin)]
        command += ["--fcd-output.attributes", "id,type,speed,pos,lane"]
        runs = {}
        for episode in range(episodes):
            file = folder / f"episode{episode}.csv"
            own = ["--seed", str(1 + seed * episodes + episode), "--fcd-output", str(file)]
            runs[file] = sumo_road.start([*command, *own])
            started.callback(runs[file].kill)

        def rows() -> Iterator[Trajectories]:
            for file, process in runs.items():
                sumo_road.finish(process)
                yield read(file, schedule)

        yield rows()


def read(file: Path, schedule: Schedule) -> Trajectories:
    """Reads SUMO's floating car data (a CSV file), without the warm-up.

    SUMO's vehicles jump from lane to lane, so their lateral positions are unknown.
    """
    params, tick_s = schedule.params_at(0), schedule.config.tick_s
    lanes = sumo_road.lanes_of_network(schedule.config, params)
    bodies = Bodies.of(params)
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
        length=bodies.length[np.array(kind)[rows]],
        width=bodies.width[np.array(kind)[rows]],
        lateral=None,
    )

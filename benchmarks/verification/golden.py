"""`python -m benchmarks.verification.golden`: records the results of a source tree for bitwise comparison with another.

    python -m benchmarks.verification.golden --out old.npz           in one tree
    python -m benchmarks.verification.golden --out new.npz           in the other tree
    python -m benchmarks.verification.golden --compare old.npz new.npz

A file holds the presets, and rollouts of several worlds under random allowed actions. With `--training` it also holds
the logs, scores and weights of short runs of train.ppo, and the output of train.evaluate and of a short study. Both
files must come from the same machine and version of JAX, since rounding differs between them.
"""

import argparse
import json
import operator
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import medjax
from benchmarks.command import ROOT, argument, benchmark_parser, output_file, run_command, say
from medjax.agents import agents_of
from medjax.commandline import as_path
from medjax.errors import InputError
from medjax.files import replacing, write_text

SEED, ENVS = 14, 4
PROFILE = {"observation": "profile", "episode_decisions": 60, "turnaround_s": 20.0}
ODD = {"num_meds": 6, "num_evs": 33, "num_gas": 100, "num_lanes": 3, "ramp_x_m": [200, 1500]}
# By name: preset, decisions, overrides. Together they exercise everything that a decision can do.
WORLDS: dict[str, tuple[str, int, dict[str, Any]]] = {
    "paper": ("paper", 90, {}),
    "profile": ("paper", 90, PROFILE),
    "realistic": ("realistic", 60, {}),
    "odd": ("paper", 60, {**ODD, "ticks_per_round": 3, "tick_s": 0.3}),
}
STATE = (
    *("vehicles.x", "vehicles.speed", "vehicles.lane", "vehicles.active"),
    *("vehicles.lateral_offset", "evs.energy_j", "evs.med", "evs.charging_slot", "evs.is_charging"),
    *("meds.energy_j", "meds.status", "queue", "detected_per_s"),
)
# Options of short runs of train.ppo, by name: one run trains a dispatcher, the other agents.
BATCHES = {"--num-envs": 64, "--num-minibatches": 8, "--total-timesteps": 65536, "--seed": 3}
ROUNDS = {"--num-envs": 8, "--num-minibatches": 2, "--rollout-length": 60, "--total-timesteps": 960}
AGENTS_ROUNDS = {**ROUNDS, "--agents": "mappo", "--eval-episodes": 2}
TRAINING: dict[str, dict[str, Any]] = {
    "training": {**BATCHES, "--eval-episodes": 6, "--set": "episode_decisions=240"},
    "agents' training": {**AGENTS_ROUNDS, "--set": "episode_decisions=60"},
}
# Options with which train.evaluate plays each run, and commands of short studies of `paper`, by name.
EVALUATED = ("--episodes=3", "--seed=5", "--policies=ppo,budgeted,none", "--baseline=none")
STUDIES = {"planner": ("benchmarks.planner", "--episodes=2", "--futures=12", "--hold=60")}
CLOCKS = ("wall_s", "env_steps_per_s")  # timings in metrics.jsonl, never reproducible
QUIET = {"num_meds": 2, "num_evs": 6, "num_gas": 4, "mainline_per_h": 300, "ramp_per_h": 0}
BUSY = {"ev_share": 0.8, "arrival_soc_high": 0.4, "ramp_x_m": [300.0], "ramp_per_h": [0.0]}
# A piece of `corridor` so short and busy that everything happens within a minute or two.
EXITS = {"exit_x_m": [900.0, 1900.0], "exit_notice_m": 500.0, "exit_view_m": 100.0}
PIECE = {**EXITS, "length_m": 2500.0, "ramp_x_m": [50.0, 1300.0], "slope": 0.01}
CROWD = {"num_evs": 24, "num_gas": 24, "mainline_per_h": 2400.0, "ramp_per_h": 300.0}
NEED = {"ev_share": 0.7, "arrival_soc_low": 0.01, "arrival_soc_high": 0.3, "stop_soc": 0.02}
FLEET = {"num_meds": 4, "size": 4, "cooldown_s": 5.0, "trip_m": 1200.0, "turnaround_s": 10.0}
PACE = {"period_s": 40.0, "battery_scale": 20.0, "rounds_per_decision": 2}
TRIPS = {**PIECE, **CROWD, **NEED, **FLEET, **PACE}
WORLDS["trips"] = ("corridor", 60, TRIPS)
AGENTS = {"agents": ("corridor", 60, TRIPS)}  # worlds in which every MED is an agent
# A gas vehicle breaks down early and drives on before the end.
WHEN = {"incident_from_s": 1.0, "incident_until_s": 4.0, "incident_s": 6.0, "incident_lane": 1}
WHERE = {"incident_from_x_m": 1500.0, "incident_until_x_m": 2500.0}
INCIDENT = {"num_incidents": 1, **WHEN, **WHERE}
SURGES = {"num_surges": 2, "has_detectors": 1, "surge_factor": 8.0, "surge_s": 9.0}
SURGES |= {"surge_from_s": 1.0, "surge_until_s": 12.0}
# Worlds of the golden test: full traffic for a few decisions, a MED that charges EVs on a quiet road, exits, plugs
# there, an incident, and surges that detectors see. On the quiet road few vehicles make decisions, so rounding errors
# stay small for long.
SHORT: dict[str, tuple[str, int, dict[str, Any]]] = {
    "paper": ("paper", 24, {}),
    "quiet": ("paper", 80, {**QUIET, **BUSY}),
    "trips": ("corridor", 30, TRIPS),
    "plugs": ("corridor", 12, TRIPS | {"num_plugs": 1}),
    "incident": ("paper", 30, {"num_gas": 70, "num_evs": 20, **INCIDENT}),
    "surges": ("corridor", 12, TRIPS | SURGES),
}


def rollout(env: Any, decisions: int) -> Callable[[Any, int], dict[str, np.ndarray]]:
    """A program `(params, num_envs)` that plays random allowed actions in environments side by side.

    It returns arrays by name, (num_envs, decisions, ...) each: results of `step`, and STATE after it.
    """

    def one(key: jax.Array, params: Any) -> dict[str, jax.Array]:
        reset_key, key = jax.random.split(key)

        def decide(state: Any, number: jax.Array) -> tuple[Any, dict[str, jax.Array]]:
            act_key, step_key = jax.random.split(jax.random.fold_in(key, number))
            allowed = jnp.where(env.action_mask(state, params), 0.0, -jnp.inf)
            action = jax.random.categorical(act_key, allowed).astype(jnp.int32)
            obs, state, reward, ended, cut, info = env.step(step_key, state, action, params)
            seen = {"obs": obs, "reward": reward, "ended": ended | cut}
            of_state = {name: operator.attrgetter(name)(state) for name in STATE}
            seen |= {name: value for name, value in of_state.items() if value is not None}
            for group in ("metrics", "reward_terms"):
                seen |= {f"{group}.{name}": value for name, value in info[group].items()}
            return state, seen

        return jax.lax.scan(decide, env.reset(reset_key, params)[1], jnp.arange(decisions))[1]

    program = jax.jit(jax.vmap(one, (0, None)))
    keys = partial(jax.random.split, jax.random.key(SEED))
    return lambda params, num_envs: jax.device_get(program(keys(num_envs), params))


def rollouts() -> dict[str, np.ndarray]:
    """Rollouts of WORLDS and AGENTS as WORLD/NAME, and the presets, since these worlds override parts of them."""
    found = {
        f"{name}/preset": np.array(repr((preset.config, preset.numbers, preset.reward)))
        for name, preset in medjax.SCENARIOS.items()
    }
    for world, (preset, decisions, overrides) in (WORLDS | AGENTS).items():
        say(f"playing {world}")
        env, params = (agents_of if world in AGENTS else medjax.make)(preset, **overrides)
        for name, values in rollout(env, decisions)(params, ENVS).items():
            found[f"{world}/{name}"] = values
    return found


def train(run_name: str) -> dict[str, np.ndarray]:
    """Logs, scores and weights of a run of TRAINING, as RUN_NAME/NAME."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        words = [f"{name}={value}" for name, value in TRAINING[run_name].items()]
        say(run_name)
        command = [sys.executable, "-m", "train.ppo", f"--run-dir={run}", *words]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
        found = {name: np.array([str(row[name]) for row in rows]) for name in rows[0]}
        scores = json.loads((run / "evaluation.json").read_text())
        for path, score in jax.tree.leaves_with_path(scores, is_leaf=lambda leaf: leaf is None):
            name = jax.tree_util.keystr(path, simple=True, separator="/")
            found[f"evaluation/{name}"] = np.array(str(score))
        found["printed"] = printed_by("train.evaluate", f"--run-dir={run}", *EVALUATED)
        newest = max((run / "checkpoints").glob("*.npz"), key=lambda path: int(path.stem))
        with np.load(newest) as state:
            found |= {name: state[name] for name in state.files if name.startswith("weights/")}
    return {f"{run_name}/{name}": found[name] for name in found if name not in CLOCKS}


def printed_by(*words: str) -> np.ndarray:
    """Output of a command of this tree."""
    command = [sys.executable, "-m", *words]
    return np.array(
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout
    )


def differences(old: Mapping[str, np.ndarray], new: Mapping[str, np.ndarray]) -> Iterator[str]:
    """A line for each name whose bits differ or that only one file has."""
    for name in sorted({*old} | {*new}):
        if name not in new or name not in old:
            yield f"{name}: only in the {'old' if name in old else 'new'} file"
            continue
        a, b = old[name], new[name]
        if (a.dtype, a.shape) != (b.dtype, b.shape):
            yield f"{name}: {a.dtype} {a.shape} and {b.dtype} {b.shape}"
        elif a.tobytes() != b.tobytes():
            yield f"{name}: {_how(a, b)}"


def _how(a: np.ndarray, b: np.ndarray) -> str:
    """How two arrays of the same shape and type differ."""
    if a.dtype.kind not in "biuf":
        return "differs"
    unlike = (a != b) & ~((a != a) & (b != b))
    text = f"{unlike.sum()} of {a.size} differ"
    if a.ndim > 1 and unlike.any():
        text += f", first in decision {np.nonzero(unlike.reshape(*a.shape[:2], -1))[1].min()}"
    finite = unlike & np.isfinite(a) & np.isfinite(b)
    apart = np.abs(a.astype(np.float64) - b.astype(np.float64))[finite]
    return f"{text}, by at most {apart.max():.3g}" if apart.size else text


def numbers() -> dict[str, Any]:
    """Plays SHORT; returns by world all rewards, and the final metrics and state of vehicles on the road."""
    found = {}
    for world, (preset, decisions, overrides) in SHORT.items():
        env, params = medjax.make(preset, **overrides)
        found[world] = last_of(rollout(env, decisions)(params, 1))
    return found


def last_of(played: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """The numbers that `numbers` keeps of one environment, in few digits. Of vehicles it keeps those on the road."""
    final = {name: values[0, -1] for name, values in played.items()}
    active = final["vehicles.active"]
    meds, evs = final["meds.status"].size, final["evs.med"].size  # slots: MEDs, EVs, the others
    of_class = {"vehicles": active, "evs": active[meds : meds + evs]}
    chosen: dict[str, Any] = {"reward": played["reward"][0]}
    for name, values in final.items():
        if name not in ("obs", "reward", "ended"):
            on_road = of_class.get(name.partition(".")[0])
            chosen[name] = values if on_road is None else values[on_road]
    chosen["vehicles.active"] = np.flatnonzero(active)
    return {name: _few_digits(np.asarray(values)) for name, values in chosen.items()}


def _few_digits(values: np.ndarray) -> Any:
    if values.dtype.kind == "f":
        return np.vectorize(lambda x: float(f"{x:.7g}"))(values).tolist()
    return values.astype(int).tolist()


def archive(name: str, text: str) -> dict[str, np.ndarray]:
    """The arrays of a file that `--out` wrote; raises InputError if it cannot be read."""
    path = as_path(name, text)
    try:
        with np.load(path) as found:
            return dict(found)
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile):
        raise InputError(f"{name} {path} cannot be read, allowed: a file of --out") from None


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Writes the requested file, or prints the differences."""
    if options.compare:
        old, new = options.compare
        lines = list(differences(old, new))
        print(*lines, f"{len(lines)} of {len({*old} | {*new})} differ", sep="\n")
        return {"differ": lines}
    if options.numbers:
        one_a_line = re.sub(r', (?=")', ",\n", json.dumps(numbers()))
        write_text(options.numbers, one_a_line + "\n")
    else:
        found: Any = rollouts()
        for run_name in TRAINING if options.training else ():
            found |= train(run_name)
        for study, words in STUDIES.items() if options.training else ():
            say(study)
            found[f"{study}/printed"] = printed_by(*words)
        with replacing(options.out) as unfinished, unfinished.open("wb") as file:
            np.savez_compressed(file, **found)
    return {"differ": []}


def main(arguments: list[str] | None = None) -> None:
    """The command; its exit code is 1 if the files differ."""
    parser = benchmark_parser("verification.golden", __doc__)
    what = parser.add_mutually_exclusive_group(required=True)
    file = partial(what.add_argument, metavar="FILE.npz")
    file("--out", type=output_file, help="write the results of this tree to this file")
    file("--compare", type=argument(archive), nargs=2, help="compare two such files")
    few = "write the numbers that the golden test expects (tests/data/golden.json)"
    what.add_argument("--numbers", type=output_file, metavar="FILE.json", help=few)
    longer = "with --out: also train, for a minute or two"
    parser.add_argument("--training", action="store_true", help=longer)
    sys.exit(bool(run_command(parser, measure, arguments)["differ"]))


if __name__ == "__main__":
    main()

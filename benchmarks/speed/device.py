"""`python -m benchmarks.device`: everything that is measured on a GPU, by one command.

Each figure comes from a command of its own, one process at a time: throughput by batch size, where a decision's time
goes, kernels, training with few and with many environments, and the tests of what the GPU computes. On a machine
without a GPU the command prints what it would run. `--json` is written after every command, so that an interrupted
run keeps what it measured. One that fails does not stop the others; the exit code is then 1.
"""

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.command import ROOT, benchmark_parser, run_command, say, write
from medjax.commandline import leave
from medjax.files import write_text

# Arguments of `python -m` by name.
COMMANDS = {
    "throughput": "benchmarks.throughput --num-envs 1024 16384 65536",
    "stages": "benchmarks.throughput --num-envs 65536 --stages",
    "kernels": "benchmarks.kernels",
    "training": "benchmarks.training --num-envs 256 --total-timesteps 1500000",
    "training_wide": "benchmarks.training --num-envs 8192 --total-timesteps 60000000",
    "tests": "pytest -q -n 14 --dist loadfile -m 'not slow' tests/physics tests/numerics tests/traffic tests/charging "
    "tests/env tests/test_precision.py",
}
# Several test processes share the GPU, and no process needs more memory than it uses.
SHARE_MEMORY = {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
ASK = "import json; from benchmarks.command import machine; print(json.dumps(machine()))"


def ask_machine() -> dict[str, str]:
    """The `machine()` of a new process: JAX reserves a GPU's memory in the process that asks for it."""
    asked = [sys.executable, "-c", ASK]
    ended = subprocess.run(asked, stdout=subprocess.PIPE, text=True, check=True, cwd=ROOT)
    return dict(json.loads(ended.stdout.splitlines()[-1]))


def run(name: str, folder: Path) -> dict[str, Any]:
    """Runs a command of `COMMANDS`.

    Returns:
      The `command`, its exit code `rc`, its `seconds`, the `output` of stdout, and its `figures`, what it wrote as
      JSON; None if it wrote none.
    """
    arguments, file = shlex.split(COMMANDS[name]), folder / f"{name}.json"
    if arguments[0] != "pytest":
        arguments.append(f"--json={file}")
    start = time.perf_counter()
    ended = subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=ROOT,
        env=os.environ | SHARE_MEMORY,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    )
    return {
        "command": f"python -m {COMMANDS[name]}",
        "rc": ended.returncode,
        "seconds": time.perf_counter() - start,
        "output": ended.stdout,
        "figures": json.loads(file.read_text(encoding="utf-8")) if file.exists() else None,
    }


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Runs all commands on a GPU and prints what they print; without a GPU it prints the commands alone."""
    result: dict[str, Any] = {**ask_machine(), "runs": {}}
    print(f"{result['device']}, JAX {result['jax_version']}")
    if result["backend"] == "cpu":
        print("no GPU; on a machine with one this runs:")
        print("\n".join(f"python -m {command}" for command in COMMANDS.values()))
        return result
    with tempfile.TemporaryDirectory() as folder:
        for name in COMMANDS:
            ended = result["runs"][name] = run(name, Path(folder))
            say(f"{ended['command']}: {ended['seconds']:.0f} s, exit code {ended['rc']}")
            print(f"\n{ended['command']}\n{ended['output']}", flush=True)
            if options.json:
                writing = partial(write_text, text=json.dumps(result, indent=2) + "\n")
                write("benchmarks.device", options.json, writing)
    return result


def main(arguments: list[str] | None = None) -> None:
    result = run_command(benchmark_parser("device", __doc__), measure, arguments)
    if any(ended["rc"] for ended in result["runs"].values()):
        leave(1)

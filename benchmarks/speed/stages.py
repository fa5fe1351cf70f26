"""Time of a decision by stage: XLA's trace, grouped by the named scopes of the step."""

import collections
import re
import tempfile
from pathlib import Path

import jax

from benchmarks.speed.hlo import CONTAINERS, Program
from benchmarks.speed.workload import Workload

# Named scopes of a step; the innermost one counts.
STAGES = (
    "dispatch",
    "entry",
    "booking",
    "noise",
    "neighbours",
    "car_following",
    "docking",
    "lane_changes",
    "motion",
    "misalignment",
    "energy",
    "exits",
    "tally",
    "reward",
    "metrics",
    "observation",
    "auto_reset",
)
OTHER = "other"  # what no scope names


def stage_of(op_name: str) -> str:
    """The innermost stage in an operation's name in JAX, or OTHER."""
    # Under vmap, the scope "entry" is named "vmap(entry)".
    words = re.split(r"[/()]", op_name)
    return next((word for word in reversed(words) if word in STAGES), OTHER)


def instruction_stages(text: str) -> dict[str, str]:
    """Stage of each instruction in the text of a compiled program."""
    return {
        instruction.name: stage_of(instruction.op_name)
        for body in Program(text).bodies.values()
        for instruction in body.values()
        if instruction.opcode not in CONTAINERS
    }


def stage_times(work: Workload) -> dict[str, float]:
    """Seconds that all cores together spend in each stage during one call of the workload.

    Tracing adds about a microsecond to every operation, so stages with many small operations look a little too slow.
    """
    stages = instruction_stages(work.program.as_text() or "")
    work.play()
    seconds: collections.Counter[str] = collections.Counter()
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder):
            work.play()
        (trace,) = Path(folder).rglob("*.xplane.pb")
        for plane in jax.profiler.ProfileData.from_file(str(trace)).planes:
            for line in plane.lines:
                for event in line.events:
                    if event.name in stages:
                        seconds[stages[event.name]] += event.duration_ns * 1e-9
    return dict(seconds)

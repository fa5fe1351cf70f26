"""Time of a decision by stage: XLA's trace, grouped by the named scopes of the step."""

import collections
import re
import tempfile
from pathlib import Path

import jax

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
_INSTRUCTION = re.compile(r"^\s*(?:ROOT )?%?([\w.\-]+) = .*? ([\w\-]+)\(", re.MULTILINE)
# These run other instructions, which are counted on their own.
_CONTAINERS = {"while", "call", "conditional"}


def stage_of(op_name: str) -> str:
    """The innermost stage in an operation's name in JAX, or "other"."""
    # Under vmap, the scope "entry" is named "vmap(entry)".
    words = re.split(r"[/()]", op_name)
    return next((word for word in reversed(words) if word in STAGES), "other")


def instruction_stages(program: str) -> dict[str, str]:
    """Stage of each instruction in the text of a compiled program."""
    stages = {}
    for line in program.splitlines():
        match = _INSTRUCTION.match(line)
        if match and match.group(2) not in _CONTAINERS:
            op_name = re.search(r'op_name="([^"]*)"', line)
            stages[match.group(1)] = stage_of(op_name.group(1) if op_name else "")
    return stages


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

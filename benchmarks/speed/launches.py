"""Launches and bytes of a compiled program, counted without running it.

A launch is an instruction that XLA executes as a whole: on a GPU a kernel, on a CPU a fusion or a single operation.
"""

import collections
import dataclasses
from collections.abc import Iterator

from benchmarks.speed.hlo import CONTAINERS, Body, Instruction, Program
from benchmarks.speed.stages import OTHER, stage_of

# These name or rearrange values and move nothing.
FREE = {"parameter", "constant", "tuple", "get-tuple-element", "bitcast", "after-all"}
# These read a part of their first operand.
PARTIAL_READS = {"slice", "dynamic-slice", "gather"}


@dataclasses.dataclass
class Cost:
    """Launches and bytes by stage; a launch that works for several stages is shared among them."""

    launches: dict[str, float] = dataclasses.field(default_factory=dict)
    bytes: dict[str, float] = dataclasses.field(default_factory=dict)

    @property
    def total_launches(self) -> int:
        """Of all stages."""
        return round(sum(self.launches.values()))

    @property
    def total_bytes(self) -> int:
        """Of all stages."""
        return round(sum(self.bytes.values()))

    def add(self, other: "Cost", times: int = 1) -> None:
        """Adds `times` runs of another program."""
        for mine, its in ((self.launches, other.launches), (self.bytes, other.bytes)):
            for stage, count in its.items():
                mine[stage] = mine.get(stage, 0.0) + times * count


def cost_of(program: Program, name: str, without: str = "") -> Cost:
    """Cost of one run of the computation `name`.

    A loop counts as often as it goes round, and not at all where that depends on the data. Of a conditional the branch
    with the most bytes counts. Conditions of loops do not count.

    Args:
      program: that the computation belongs to.
      name: of the computation.
      without: a computation to leave out wherever it is run.
    """
    total, body = Cost(), program.bodies[name]
    for instruction in body.values():
        if instruction.opcode in CONTAINERS:
            called = (each for each in instruction.called if each != without)
            costs = [cost_of(program, each, without) for each in called]
            dearest = max(costs, key=lambda cost: cost.total_bytes, default=Cost())
            total.add(dearest, _runs(instruction))
        elif instruction.opcode == "fusion":
            total.add(launch(program.bodies[instruction.called[0]]))
        elif instruction.opcode not in FREE:
            total.add(launch(_alone(body, instruction)))
    return total


def loops_of(program: Program, name: str, times: int = 1) -> Iterator[tuple[Instruction, int]]:
    """All loops that the computation `name` reaches, and how often their bodies run in `times` runs of it.

    That is 0 for a loop whose rounds depend on the data; loops inside of it are left out.
    """
    for instruction in program.bodies[name].values():
        if instruction.opcode in CONTAINERS:
            inside = times * _runs(instruction)
            if instruction.opcode == "while":
                yield instruction, inside
            for called in instruction.called if inside else ():
                yield from loops_of(program, called, inside)


def _runs(container: Instruction) -> int:
    """How often a container runs what it calls."""
    return container.rounds or 0 if container.opcode == "while" else 1


def _alone(body: Body, instruction: Instruction) -> Body:
    """A single operation as a fusion of one."""
    given = {name: body[name] for name in instruction.operands}
    inputs = {name: dataclasses.replace(x, opcode="parameter") for name, x in given.items()}
    return inputs | {instruction.name: dataclasses.replace(instruction, is_root=True)}


def launch(body: Body) -> Cost:
    """Cost of one launch of a fused computation.

    The bytes of an input are shared equally among the stages that read it; those of an output belong to the stage that
    computes it. The launch is shared as its bytes are.
    """
    outputs = _outputs(body)
    updates = [_update(body, output) for output in outputs]
    in_place = all(values for _, values in updates)  # else XLA writes all outputs whole
    targets = {name for names, _ in updates for name in names} if in_place else set[str]()
    moved: collections.defaultdict[str, float] = collections.defaultdict(float)

    def share(count: int, stages: set[str]) -> None:
        for stage in stages:
            moved[stage] += count / len(stages)

    for instruction in body.values():
        if instruction.opcode == "parameter":
            readers = [reader for reader in _readers(body, instruction) if reader.opcode != "tuple"]
            if instruction.name in targets:
                readers = [reader for reader in readers if reader not in outputs]
            stages = {stage for reader in readers for stage in _stages(body, reader)}
            share(_read_bytes(body, instruction, readers), stages)
    for output, (_, values) in zip(outputs, updates, strict=True):
        count = sum(body[name].nbytes for name in values) if in_place else output.nbytes
        share(count, _stages(body, output))
    total = sum(moved.values())
    return Cost(
        {stage: count / total for stage, count in moved.items()} if total else {}, {**moved}
    )


def _readers(body: Body, instruction: Instruction) -> list[Instruction]:
    """Who reads a value, also through bitcasts."""
    found = []
    for reader in body.values():
        if instruction.name in reader.operands:
            found += _readers(body, reader) if reader.opcode == "bitcast" else [reader]
    return found


def _source(body: Body, name: str) -> Instruction:
    """Who computes a value, seen through bitcasts."""
    instruction = body[name]
    while instruction.opcode == "bitcast":
        instruction = body[instruction.operands[0]]
    return instruction


def _stages(body: Body, instruction: Instruction) -> set[str]:
    """Stages of an instruction; what XLA added belongs to those who read it."""
    if instruction.op_name:
        return {stage_of(instruction.op_name)}
    readers = _readers(body, instruction)
    return {stage for reader in readers for stage in _stages(body, reader)} or {OTHER}


def _outputs(body: Body) -> list[Instruction]:
    """Who computes each output."""
    root = next(each for each in body.values() if each.is_root)
    names = root.operands if root.opcode == "tuple" else (root.name,)
    return [_source(body, name) for name in names]


def _update(body: Body, output: Instruction) -> tuple[list[str], list[str]]:
    """Inputs into which an output writes some values, and these values; none if the output is new."""
    operands = output.operands
    count = len(operands) // 2  # a scatter has targets, one array of indices, and as many values
    if output.opcode == "dynamic-update-slice":
        targets, values = operands[:1], operands[1:2]
    elif output.opcode == "scatter":
        targets, values = operands[:count], operands[count + 1 :]
    else:
        return [], []
    sources = [_source(body, name) for name in targets]
    if any(source.opcode != "parameter" for source in sources):
        return [], []
    return [source.name for source in sources], list(values)


def _read_bytes(body: Body, parameter: Instruction, readers: list[Instruction]) -> int:
    """Bytes that are read of an input; those who pick a part of it read that part only."""
    parts = 0
    for reader in readers:
        picks = reader.opcode in PARTIAL_READS
        if not picks or _source(body, reader.operands[0]).name != parameter.name:
            return parameter.nbytes
        parts += reader.nbytes
    return min(parts, parameter.nbytes)

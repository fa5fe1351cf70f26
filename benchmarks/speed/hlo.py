"""The text of a compiled program (XLA's HLO), read into its instructions."""

import dataclasses
import functools
import math
import re

# These run other computations, whose instructions count instead.
CONTAINERS = {"while", "call", "conditional"}

_HEAD = re.compile(r"^(ENTRY )?%?([\w.\-]+) \(.*\{$")
_INSTRUCTION = re.compile(r"^\s+(ROOT )?%?([\w.\-]+) = (.*?) ([\w\-]+)\(([^)]*)\)(.*)$")
_CALLED = re.compile(r"\b(?:calls|to_apply|body|true_computation|false_computation)=%?([\w.\-]+)")


@dataclasses.dataclass(frozen=True)
class Instruction:
    """One line of a computation."""

    name: str
    shape: str  # such as "f32[64,208]{1,0}", or several in parentheses
    opcode: str
    operands: tuple[str, ...]
    attributes: str  # what follows the operands
    is_root: bool

    @functools.cached_property
    def op_name(self) -> str:
        """The operation's name in JAX; empty if XLA added the instruction."""
        found = re.search(r'op_name="([^"]*)"', self.attributes)
        return found.group(1) if found else ""

    @functools.cached_property
    def called(self) -> list[str]:
        """Names of the computations that it runs; of a conditional, all branches."""
        branches = re.search(r"branch_computations=\{([^}]*)\}", self.attributes)
        if branches:
            return re.findall(r"[\w.\-]+", branches.group(1))
        return _CALLED.findall(self.attributes)

    @functools.cached_property
    def rounds(self) -> int | None:
        """How often a loop runs its body, if XLA knows it."""
        found = re.search(r'"known_trip_count":\{"n":"(\d+)"', self.attributes)
        return int(found.group(1)) if found else None

    @functools.cached_property
    def nbytes(self) -> int:
        """Bytes of its result."""
        return shape_bytes(self.shape)


Body = dict[str, Instruction]  # of a computation, by name


def shape_bytes(shape: str) -> int:
    """Bytes of all arrays in the text of a shape."""
    bits = 0
    for kind, dims in re.findall(r"(\w+)\[([\d,]*)\]", shape):
        width = re.search(r"\d+", kind)  # f32, bf16, u8, f8e4m3fn; a token has none
        each = 8 if kind == "pred" else int(width.group()) if width else 0
        bits += each * math.prod(int(size) for size in dims.split(",") if size)
    return math.ceil(bits / 8)


class Program:
    """The computations of a compiled program.

    Args:
      text: of `jax.stages.Compiled.as_text()`.
    """

    def __init__(self, text: str) -> None:
        self.bodies: dict[str, Body] = {}
        self.entry = ""
        body: Body = {}
        for line in text.splitlines():
            if head := _HEAD.match(line):
                body = self.bodies.setdefault(head.group(2), {})
                self.entry = head.group(2) if head.group(1) else self.entry
            elif found := _INSTRUCTION.match(line):
                root, name, shape, opcode, given, attributes = found.groups()
                operands = tuple(dict.fromkeys(re.findall(r"%([\w.\-]+)", given)))
                body[name] = Instruction(name, shape, opcode, operands, attributes, bool(root))

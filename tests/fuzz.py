"""Bad values by what a field is documented to hold, so that a new field is fuzzed without anybody's thinking of it.

Ranges of the environment's numbers are read from docs/parameters.md, those of the learner from its options; the
values are made here, not by the checks that are to refuse them.
"""

import dataclasses
import math
import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np

NAN_ON_DEVICE, INF_ON_DEVICE = jnp.float32(math.nan), jnp.float32(math.inf)  # compiled here

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs/parameters.md").read_text(encoding="utf-8")


@dataclasses.dataclass(frozen=True)
class Documented:
    """A row of docs/parameters.md."""

    name: str
    value: str
    low: float
    high: float

    @property
    def whole(self):
        """Sizes, counts and lanes."""
        leaf = self.name.rpartition(".")[2]
        return leaf.startswith("num_") or leaf in WHOLE


WHOLE = ("ticks_per_decision", "size", "service_lane", "episode_decisions")
ALL = [
    Documented(name, value, *(float(end) for end in allowed.split(" to ")))
    for name, value, allowed in re.findall(
        r"^\| `([\w.]+)` \| ([^|]+?) \| ([^|]+?) \|", PAGE, re.MULTILINE
    )
]
COILS = [row for row in ALL if "_coil_" in row.name]
ROWS = [row for row in ALL if row not in COILS]


class Unprintable:
    """Breaks whoever wants to show it."""

    def __repr__(self):
        raise RuntimeError("no")


def deep(levels):
    """A list in a list in a list ..."""
    nested = []
    for _ in range(levels):
        nested = [nested]
    return nested


def heavy():
    """Few objects, and more than memory holds when written out."""
    level = ["x"] * 9
    for _ in range(12):
        level = [level] * 9
    return level


DEEP, HEAVY = deep(10_000), heavy()
NO_NUMBERS = (
    None,
    True,
    np.bool_(False),
    "",
    "3",
    "٣",
    "\ud800\n\0\u202e\x1b[2J",
    "9" * 10_000,
    b"3",
    {},
    {"low": 1},
    set(),
    object(),
    Unprintable(),
    1j,
    np.complex64(1),
    np.array("3"),
    np.array([3], object),
    np.array(3, object),
    np.datetime64(3, "s"),
    lambda: 3,
    float,
    DEEP,
    [deep(300)],
    HEAVY,
    [None, None, None, None],
    ["1", "2", "3", "4"],
    [True] * 4,
    np.zeros((4, 4)),
    np.zeros((0, 3)),
    np.zeros(4, bool),
    np.zeros(4, complex),
    jnp.asarray(np.zeros((2, 2))),
    [0.0] * 100_000,
    range(4),
    iter([1.0]),
)
"""What no number of the environment can be."""


def outside(low, high, whole=False, infinite=False):
    """Numbers that a range leaves out."""
    given = [math.nan, -math.inf, np.float32(math.nan), NAN_ON_DEVICE, -1e39, -1e308]
    given += [-(10**400), 10**400, 10**5000, -(2**63), low - 1, np.int64(low - 1), [math.nan] * 4]
    given += [low - (1e-6 * max(abs(low), 1)), np.float64(low - 1)]
    if low == 0:
        given += [-1e-6, np.float32(-1e-6), -5e-324]
    if low > 0:
        given += [0, 0.0, -0.0, 5e-324, low * 0.99]
    if not infinite:
        given += [math.inf, 1e308, 1e39, np.float64(1e39), INF_ON_DEVICE, 2**63, 2**31]
        given += [2**64, high + 1 if high < 2**50 else 10 * high, high * 1.001, [high * 2] * 4]
    if whole:
        given += [low + 0.5, np.float32(high - 0.5), 1e-3, [low + 0.5] * 4]
    return [value for value in given if not _allowed(value, low, high, whole)]


def _allowed(value, low, high, whole):
    """Whether a bound that is all there is makes a value good after all, as 2**31 where weights go to 1e9."""
    if isinstance(value, list):
        return _allowed(value[0], low, high, whole)
    if isinstance(value, int):
        return low <= value <= high
    number = float(value)
    return low <= number <= high and (not whole or number == int(number))


def bad_values(row):
    """Everything bad for a documented number."""
    return [*NO_NUMBERS, *outside(row.low, row.high, row.whole, infinite=row.high == math.inf)]


TEXTS = (
    "",
    " ",
    "-",
    "--",
    "x",
    "nan",
    "-inf",
    "1e400",
    "-1e39",
    "1e39",
    "9" * 5000,
    "-1",
    "0x10",
    "1,5",
    "1 2",
    "٣",
    "1٣",
    "３",
    "½",
    "²",
    "∞",
    "一",
    "\u202e3",
    "3\u200b",
    "\ud800",
    "\udcff3",
    "3\0",
    "\x1b[31m",
    "line\nline",
    "\r\n",
    "🚚" * 50,
    "w" * 100_000,
    "[" * 100_000,
    '{"a":' * 50_000,
    "[[1]]",
    "null",
    "true",
    "%s%n%d",
    "$(reboot)",
    "__import__('os')",
)
"""Texts that are the value of no number."""

PATHS = (
    "",
    "\n",
    "new\nline",
    "a\0b",
    "a\tb",
    "\ud800",
    "\udcff",
    "\u202erun",
    "\x1b[2J",
    "~",
    "~/run",
    "~root",
    "x" * 256,
    "€" * 100,
    "a/" + "x" * 300 + "/b",
    "a/" * 3000,
    "a/" * 600,
    "file",
    "file/",
    "file/run",
    "file/..",
    "/proc/run",
    "/proc/self/fd/run",
    "/sys/run",
    "/dev/null",
    "/dev/null/run",
    "/dev/full",
    "loop",
    "loop/run",
    "dangling",
    "dangling/run",
    "used",
    "used/",
    "used/../used",
    ".",
    "..",
    "/",
)
"""Run directories that cannot be, where `file` is one, `used` holds one, and `loop` and `dangling` are links."""

FILES = {
    "a.json": [
        "",
        "{",
        "[]",
        "3",
        "nul",
        "null",
        '"x"',
        "{'seed': 1}",
        '{"seed": 1,}',
        "[" * 60000,
        '{"a":' * 12000,
        '{"seed": 1, "seed": 2}',
        '{"seed": NaN}',
        '{"gamma": Infinity}',
        '{"gamma": -Infinity}',
        '{"seed": 1e400}',
        '{"seed": ' + "9" * 5000 + "}",
        '{"config": 3}',
        '{"config": {"gamma": "x"}}',
        '{"": 1}',
        '{"speed": 1}',
        '{"overrides": {"cooldown_s": {"a": [1]}}}',
        '{"overrides": {"name": "x"}}',
        '{"overrides": [1]}',
        '{"overrides": {"cooldown_s": 1, "cooldown_s": 2}}',
        '{"hidden": "12"}',
        '{"hidden": [[1]]}',
        '{"gamma": true}',
        '{"anneal": 1}',
        '{"scenario": ["paper"]}',
        '{"seed": "\\ud800"}',
        "\x00",
        "\ufeff{}",
        " " * 70000,
        '{"seed":' + " " * 70001 + "1}",
    ],
    "a.yaml": [
        "",
        "- 1",
        "3",
        "a: [",
        "a: b: c",
        "\t- x",
        "seed: [",
        "seed: 1\nseed: 2",
        "{seed: 1, seed: 2}",
        "? [seed]\n: 1",
        "seed: !!python/object/apply:os.system [reboot]",
        "seed: !!python/name:os.system",
        "seed: !!bool x",
        "seed: !!timestamp x",
        "seed: !!int x",
        "seed: !!binary x",
        "seed: 2020-13-45",
        "seed: 2020-01-01",
        "seed: .nan",
        "gamma: .inf",
        "seed: 0x",
        "seed: 09",
        "seed: 1e3",
        "1: 2",
        "null: 1",
        "true: 1",
        "seed:",
        "seed: " + "9" * 5000,
        "[" * 60000,
        "- " * 30000,
        "{a: " * 15000,
        "a: &a [x]\nseed: *a",
        "&a seed: *a",
        "a: &a [x,x]\nb: &b [*a,*a,*a]\nc: &c [*b,*b,*b]\nhidden: *c",
        "a: &a {seed: 1}\n<<: *a",
        "seed: |\n  1",
        "hidden: {1: 2}",
        "hidden: [[1]]",
        "overrides: 3",
        "overrides: {name: x}",
        "overrides: {3: 1}",
        "\x00",
        "%YAML 9.9",
        "--- 1\n--- 2",
        "%TAG ! x",
        "\x07",
        "x" * 70000,
        "*x",
        "seed: '",
        'seed: "\\ud8"',
    ],
}
"""Files of settings that are none, by the name that says what they should be."""

"""Writes the tables of docs/parameters.md from the declarations in `medjax.world`."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from medjax.commandline import OneLineParser
from medjax.env.reward import REWARDS
from medjax.world.charging_params import CoilDesign
from medjax.world.numbers import Number
from medjax.world.params import COILS, GROUPS, OTHERS, SIZES, EnvConfig
from medjax.world.presets import SCENARIOS
from medjax.world.weights import PRICES, WEIGHT, WEIGHTS

PAGE = Path(__file__).with_suffix(".md")
TABLE = re.compile(r"(<!-- table: ([\w, .]+) -->\n).*?(<!-- end of table -->)", re.DOTALL)
HEAD = "| name | value | allowed | unit | what it is; source |\n|---|---|---|---|---|\n"
BODIES = ("ev", "med")


def _shown(value: Any) -> str:
    """A number, or those of an array; equal ones once."""
    texts = [f"{number:.6g}" for number in np.ravel(value)]
    return texts[0] if len(set(texts)) == 1 else ", ".join(texts) or "none"


def _row(name: str, value: Any, declared: Number, body: int = 0) -> str:
    text = declared.text[body] if isinstance(declared.text, tuple) else declared.text
    cells = (f"`{name}`", _shown(value), declared.range, declared.unit, text)
    return "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|\n"


def _rows(group: str) -> Iterator[str]:
    """The rows of a group, or of a number without a group."""
    config, coils = EnvConfig(), CoilDesign()
    params = SCENARIOS["paper"].params(config)
    if group == "sizes":
        yield from (_row(name, getattr(config, name), SIZES[name]) for name in SIZES)
    elif group == "coils":
        yield from (_row(name, getattr(coils, name), COILS[name]) for name in COILS)
    elif group == "reward_weights":
        for term in (term for terms in REWARDS.values() for term in terms):
            declared = (WEIGHTS | PRICES).get(term, WEIGHT)
            yield _row(f"{group}.{term}", declared.default, declared)
    elif group in OTHERS:
        yield _row(group, getattr(params, group), OTHERS[group])
    else:
        body = BODIES.index(group) if group in BODIES else 0
        for name, declared in GROUPS[group].items():
            yield _row(f"{group}.{name}", getattr(getattr(params, group), name), declared, body)


def _table(found: re.Match[str]) -> str:
    rows = (row for group in found[2].split(", ") for row in _rows(group))
    return found[1] + HEAD + "".join(rows) + found[3]


def written(page: str) -> str:
    """The page with up-to-date tables; a comment before each names its groups."""
    return TABLE.sub(_table, page)


def main(argv: Sequence[str] | None = None) -> None:
    """The command."""
    OneLineParser(prog="python -m docs.parameters", description=__doc__).parse_args(argv)
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()

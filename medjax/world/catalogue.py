"""One line on each preset; `--help` shows it without importing JAX."""

import argparse
import textwrap
from collections.abc import Mapping

ABOUT = {
    "paper": "the paper's road: 4 km, with batteries so small that charge matters",
    "realistic": (
        "true battery capacities: EVs arrive nearly empty, and some cannot drive the 4 km"
    ),
    "long": (
        "100 km of motorway, true battery capacities: a Leaf uses 19 kWh on it and charges within 50 km"
    ),
    "freight": (
        "30 km on which MEDs charge electric lorries, near break-even; demand surges; in euros"
    ),
    "corridor": (
        "30 km in the afternoon: true capacities, powers, lorries and speeds; chargers at exits; in euros"
    ),
}


def listed(about: Mapping[str, str]) -> str:
    """Names and descriptions, one per line."""
    width = max(map(len, about), default=0)
    return "\n".join(f"{name:<{width}}  {line}" for name, line in about.items())


PRESETS = f"presets:\n{textwrap.indent(listed(ABOUT), '  ')}"  # epilog of --help


class KeepsLines(argparse.HelpFormatter):
    """Help formatter that keeps the line breaks of a parser's description and epilog."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return "\n".join(
            textwrap.fill(line, width, initial_indent=indent, subsequent_indent=f"{indent}    ")
            for line in text.splitlines()
        )

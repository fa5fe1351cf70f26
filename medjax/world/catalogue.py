"""One line on each preset; `--help` shows it without importing JAX."""

import argparse
import textwrap
from collections.abc import Mapping

ABOUT = {
    "paper": "the paper's corridor: batteries scaled so that charge matters within 4 km",
    "realistic": (
        "true packs: EVs arrive with little energy left above empty, so some cannot cross 4 km"
    ),
    "long": (
        "a motorway of 100 km with true packs: the way takes a Leaf 19 kWh, and charging it 50 km"
    ),
    "corridor": (
        "30 km in the afternoon: true packs, powers, lorries and speeds, chargers at every exit; in money"
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

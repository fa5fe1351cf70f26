"""One HTML page that needs nothing else: tables, and pictures in the text of the page itself."""

import base64
import dataclasses
from collections.abc import Sequence
from html import escape
from pathlib import Path

from medjax.files import write_text
from train.evaluation.tables import Table

STYLE = """
body { font: 16px/1.5 sans-serif; color: #222; max-width: 1100px; margin: 2em auto; padding: 0 1em; }
img { max-width: 100%; height: auto; }
table { border-collapse: collapse; margin: 1em 0; }
th, td { padding: 0.25em 0.9em; text-align: right; border-bottom: 1px solid #ddd; }
th:first-child, td:first-child { text-align: left; }
th { border-bottom: 2px solid #888; }
pre { overflow-x: auto; background: #f6f6f6; padding: 1em; }
"""


@dataclasses.dataclass(frozen=True)
class Section:
    """A part of the page."""

    title: str
    text: str
    tables: Sequence[Table] = ()
    pictures: Sequence[Path] = ()  # PNGs
    verbatim: str = ""


def write_page(path: Path, title: str, introduction: str, sections: Sequence[Section]) -> None:
    """Writes the page in full or not at all."""
    parts = [
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>",
        f"<h1>{escape(title)}</h1>\n<p>{escape(introduction)}</p>",
        *map(_section, sections),
        "</body>\n</html>\n",
    ]
    write_text(path, "\n".join(parts))


def _section(section: Section) -> str:
    parts = [f"<h2>{escape(section.title)}</h2>\n<p>{escape(section.text)}</p>"]
    parts += map(_table, section.tables)
    for path in section.pictures:
        data = base64.b64encode(path.read_bytes()).decode("ascii")
        parts.append(f'<img alt="{escape(section.title)}" src="data:image/png;base64,{data}">')
    if section.verbatim:
        parts.append(f"<pre>{escape(section.verbatim)}</pre>")
    return "\n".join(parts)


def _table(table: Table) -> str:
    def row(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = [row(cells, "td") for cells in table[1:]]
    return "\n".join(["<table>", row(table[0], "th"), *body, "</table>"])

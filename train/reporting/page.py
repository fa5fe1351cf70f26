"""One self-contained HTML page, with tables and embedded pictures."""

import base64
import dataclasses
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from medjax.files import write_text
from train.evaluation.tables import Table

# Figures are black on white; a dark page shows them on white cards.
STYLE = """
:root { color-scheme: light dark; --paper: #fff; --ink: #222; --line: #ddd; --strong: #888; --panel: #f6f6f6; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #16191d; --ink: #e8eaed; --line: #3a4048; --strong: #8d959e; --panel: #1e2227; }
}
body { font: 16px/1.5 sans-serif; color: var(--ink); background: var(--paper); max-width: 1100px; margin: 2em auto;
  padding: 0 1em; overflow-wrap: anywhere; }
#conclusion { font-size: 18px; border-left: 4px solid var(--strong); padding-left: 0.8em; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 0.2em 1em; }
dt { font-weight: 600; }
dd { margin: 0; }
figure { margin: 1em 0; }
figcaption { font-weight: 600; margin-top: 0.4em; }
.wide { overflow-x: auto; }
img { display: block; max-width: 100%; height: auto; background: #fff; border-radius: 4px; }
table { border-collapse: collapse; margin: 1em 0; }
th, td { padding: 0.25em 0.9em; text-align: right; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; }
th { border-bottom: 2px solid var(--strong); }
pre { overflow-x: auto; background: var(--panel); padding: 1em; }
@media (max-width: 700px) {
  h1 { font-size: 24px; line-height: 1.2; }
  img { max-width: none; width: 700px; }
  th, td { padding: 0.2em 0.5em; font-size: 14px; }
  td, th { overflow-wrap: normal; }
  td { white-space: nowrap; }
  dl { display: block; }
  dd { margin-bottom: 0.4em; }
  th:first-child, td:first-child { position: sticky; left: 0; background: var(--paper); }
}
"""


@dataclasses.dataclass(frozen=True)
class Picture:
    """A PNG, and a sentence that says what it shows."""

    path: Path
    conclusion: str


@dataclasses.dataclass(frozen=True)
class Section:
    """A part of the page."""

    title: str
    text: str
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    verbatim: str = ""
    terms: Mapping[str, str] = dataclasses.field(default_factory=dict)  # what each means


def write_page(
    path: Path, title: str, conclusion: Sequence[str], sections: Sequence[Section]
) -> None:
    """Writes the page in full or not at all; `conclusion` are the paragraphs that it begins with."""
    begin = "\n".join(f"<p>{escape(each)}</p>" for each in conclusion)
    parts = [
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>",
        f'<h1>{escape(title)}</h1>\n<div id="conclusion">\n{begin}\n</div>',
        *map(_section, sections),
        "</body>\n</html>\n",
    ]
    write_text(path, "\n".join(parts))


def _section(section: Section) -> str:
    parts = [f"<h2>{escape(section.title)}</h2>\n<p>{escape(section.text)}</p>"]
    if section.terms:
        pairs = (
            f"<dt>{escape(term)}</dt><dd>{escape(said)}</dd>"
            for term, said in section.terms.items()
        )
        parts.append("<dl>\n" + "\n".join(pairs) + "\n</dl>")
    parts += map(_table, section.tables)
    for picture in section.pictures:
        data = base64.b64encode(picture.path.read_bytes()).decode("ascii")
        said = escape(picture.conclusion)
        image = f'<img alt="{said}" src="data:image/png;base64,{data}">'
        parts.append(
            f'<figure><div class="wide" tabindex="0">{image}</div>\n'
            f"<figcaption>{said}</figcaption></figure>"
        )
    if section.verbatim:
        parts.append(f"<pre>{escape(section.verbatim)}</pre>")
    return "\n".join(parts)


def _table(table: Table) -> str:
    def row(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = [row(cells, "td") for cells in table[1:]]
    lines = ['<div class="wide" tabindex="0"><table>', row(table[0], "th"), *body, "</table></div>"]
    return "\n".join(lines)

"""Hooks of mkdocs.

LaTeX becomes MathML, tables that commands printed become tables of the page, and a line on when and on what a command
ran is folded away. The search ranks pages above the API reference.
"""

import html
import re
from typing import Any

from latex2mathml.converter import convert

# Output of pymdownx.arithmatex for $...$ and $$...$$.
EQUATION = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)

# A fenced block, and a printed table in it: a heading over a line of dashes.
FENCE = re.compile(r"^```(\w*)\n((?:(?!```).*\n)*)```\n", re.MULTILINE)
TABLE = re.compile(r"^(?P<head>\S.*)\n-{10,}\n(?P<rows>(?:\S.*\n(?!-{10,}\n))+)", re.MULTILINE)

# What python -m docs.reproduce writes behind a command.
NOTE = re.compile(r"^\*Run (?P<date>\S+) in (?P<time>[^:\n]+): (?P<rest>.+)\*$", re.MULTILINE)
FOLDED = """<details class="run" data-search-exclude>
<summary>Took {time}</summary>
Run {date}: {rest}
</details>"""

# A match in the API reference counts this much of one elsewhere; its exact names still come first.
REFERENCE_BOOST = 0.05


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Converts printed tables in fenced blocks to Markdown, and folds notes on runs."""
    if page.file.src_uri.startswith("api/"):
        page.meta["search"] = {"boost": REFERENCE_BOOST}
    folded = NOTE.sub(lambda note: FOLDED.format(**note.groupdict()), markdown)
    return FENCE.sub(_with_tables, folded)


def _with_tables(block: re.Match[str]) -> str:
    """A fenced block as Markdown if it has printed tables whose columns can be told apart; otherwise unchanged."""
    language, printed = block.groups()
    if language or not TABLE.search(printed):
        return block[0]
    parts, end = [], 0
    for table in TABLE.finditer(printed):
        rows = _cells(table["head"], table["rows"].splitlines())
        if rows is None:
            return block[0]
        parts += [_lines(printed[end : table.start()]), _markdown(rows)]
        end = table.end()
    return "\n".join([*parts, _lines(printed[end:]), ""])


def _lines(text: str) -> str:
    """Lines between tables, with line breaks."""
    kept = [html.escape(line, quote=False) for line in text.splitlines() if line.strip()]
    return "\n" + "  \n".join(kept) + "\n" if kept else ""


def _cells(head: str, rows: list[str]) -> list[list[str]] | None:
    """Cells of a heading and its rows; None unless their columns end where those of the heading do."""
    ends = [found.end() for found in re.finditer(r"\S+(?: \S+)*", head)]
    lines = [line.ljust(ends[-1]) for line in [head, *rows]]
    # The first column is left-aligned: the next begins two spaces after the longest name.
    ends[0] = max(len(line.partition("  ")[0]) for line in lines)
    if any(
        len(line.rstrip()) > ends[-1] or line[end : end + 1].strip()
        for line in lines
        for end in ends
    ):
        return None
    places = list(zip([0, *ends], ends, strict=False))
    return [[line[begin:end].strip() for begin, end in places] for line in lines]


def _markdown(rows: list[list[str]]) -> str:
    """A Markdown table; all columns but the first are right-aligned."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(["", lines[0], "|---" + "|---:" * (len(rows[0]) - 1) + "|", *lines[1:], ""])


def on_page_content(content: str, **_: Any) -> str:
    """Converts LaTeX to MathML."""
    return EQUATION.sub(_to_mathml, content)


def _to_mathml(found: re.Match[str]) -> str:
    tag, bracket, latex = found.groups()
    display = "block" if bracket == "[" else "inline"
    mathml = convert(html.unescape(latex).strip(), display=display)
    return f'<{tag} class="equation">{mathml}</{tag}>'

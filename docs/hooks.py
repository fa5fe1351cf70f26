"""What mkdocs does with a page besides rendering it: equations become MathML, which needs no script."""

import html
import re
from typing import Any

from latex2mathml.converter import convert

# What pymdownx.arithmatex leaves of $...$ and of $$...$$.
EQUATION = re.compile(
    r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>',
    re.DOTALL,
)


def on_page_content(content: str, **_: Any) -> str:
    """The page with its LaTeX turned into MathML."""
    return EQUATION.sub(_to_mathml, content)


def _to_mathml(found: re.Match[str]) -> str:
    tag, bracket, latex = found.groups()
    display = "block" if bracket == "[" else "inline"
    mathml = convert(html.unescape(latex).strip(), display=display)
    return f'<{tag} class="equation">{mathml}</{tag}>'

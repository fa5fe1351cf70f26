"""One page with players of a policy's best, median and worst episode, one above the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from medjax.episodes.recording import Recording
from medjax.files import replacing
from medjax.render.player import player_page

STYLE = (
    "body { margin: 0; font: 15px/1.4 system-ui, sans-serif; } h1, h2 { margin: 8px 12px; } "
    "h1 { font-size: 18px; } h2 { font-size: 16px; } iframe { width: 100%; height: 900px; border: 0; }"
    " @media (prefers-color-scheme: dark) { body { background: #16191d; color: #e8eaed; } }"
)


SHOWN = ("best", "median", "worst")  # episodes of the page


def pick(returns: np.ndarray) -> dict[str, int]:
    """The episodes that `SHOWN` names, of returns `(N,)`; an even number has its upper median."""
    order = np.argsort(returns, kind="stable")
    places = order[[-1, len(order) // 2, 0]].tolist()
    return dict(zip(SHOWN, places, strict=True))


def write_grid(
    path: Path, shown: Mapping[str, Sequence[Recording]], returns: np.ndarray, **how: object
) -> None:
    """Writes the page.

    Args:
      path: file to write, in full or not at all.
      shown: by the names of `pick`, an episode's recordings: one, or those of two policies to show side by side.
      returns: (N,) of the first policy in all episodes.
      how: as in `medjax.render.player.write_player`.

    Raises:
      InputError, OSError: as in `write_player`.
    """
    count, policy = len(returns), next(iter(shown.values()))[0].policy
    title = escape(f"{policy}: best, median and worst of {count} episodes")
    parts = [f"<h1>{title}</h1>"]
    for name, recordings in shown.items():
        episode = recordings[0].episode
        said = f"{name.capitalize()} of {count}: episode {episode}, return {returns[episode]:.1f}"
        page = player_page(recordings, **how)  # type: ignore[arg-type]
        parts.append(f"<h2>{said}</h2>")
        parts.append(f'<iframe title="{said}" loading="lazy" srcdoc="{escape(page)}"></iframe>')
    head = f'<meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
    body = "\n".join(parts)
    with replacing(path) as partial:
        text = f'<!DOCTYPE html>\n<html lang="en">\n<head>{head}</head>\n<body>\n{body}\n</body>\n</html>\n'
        partial.write_text(text, encoding="utf-8")

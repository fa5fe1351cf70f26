"""Draws the figures of the pages on the models, with the functions of the models.

    python -m docs.figures [DIRECTORY]      writes docs/images/*.png

from the repository's root; it needs the extra `train` for matplotlib.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import medjax
from docs.figures.coils import draw_efficiency, draw_inductance
from docs.figures.driving import draw_idm, draw_lane_change
from docs.figures.energy import draw_energy
from docs.figures.road import draw_road
from medjax.commandline import OneLineParser
from medjax.world.params import EnvParams

IMAGES = Path(__file__).parents[1] / "images"

FIGURES: dict[str, Callable[[Path, EnvParams], None]] = {
    "road": draw_road,
    "idm": draw_idm,
    "lane_change": draw_lane_change,
    "inductance": draw_inductance,
    "efficiency": draw_efficiency,
    "energy": draw_energy,
}


def draw(directory: Path) -> list[Path]:
    """Draws all figures of the `paper` preset into a directory, which is made. Returns the files."""
    _, params = medjax.make("paper")
    paths = [directory / f"{name}.png" for name in FIGURES]
    for path, figure in zip(paths, FIGURES.values(), strict=True):
        figure(path, params)
    return paths


def main(argv: Sequence[str] | None = None) -> None:
    """The command."""
    parser = OneLineParser(prog="python -m docs.figures", description=__doc__)
    parser.add_argument("directory", nargs="?", type=Path, default=IMAGES, metavar="DIRECTORY")
    for written in draw(parser.parse_args(argv).directory):
        print(written)


if __name__ == "__main__":
    main()

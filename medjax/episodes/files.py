"""Writes trajectory files atomically. The file extension selects the format."""

import csv
import importlib.util
import io
import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO

import numpy as np

from medjax.commandline import as_path
from medjax.episodes.fcd import write_fcd
from medjax.episodes.recording import Recording
from medjax.episodes.table import vehicle_table
from medjax.errors import InputError
from medjax.files import check_output, replacing

EXACT = "%.9g"  # nine digits identify any float32


def write_parquet(pieces: Iterable[Recording], file: IO[bytes]) -> Iterator[int]:
    """Writes `vehicle_table`, and as JSON metadata `medjax` which episode it is. Yields each piece's row count."""
    import pyarrow
    import pyarrow.parquet

    writer = None
    for piece in pieces:
        played = {name: getattr(piece, name) for name in ("scenario", "policy", "seed", "episode")}
        columns = {
            name: pyarrow.array(column.data, mask=np.ma.getmaskarray(column))
            for name, column in vehicle_table(piece).items()
        }
        table = pyarrow.table(columns, metadata={"medjax": json.dumps(played)})
        dictionary = ["kind", "panel"]
        writer = writer or pyarrow.parquet.ParquetWriter(
            file, table.schema, use_dictionary=dictionary
        )
        writer.write_table(table)
        yield table.num_rows
    if writer:
        writer.close()


def write_csv(pieces: Iterable[Recording], file: IO[bytes]) -> Iterator[int]:
    """Writes `vehicle_table`, with enough digits to restore each float32 exactly. Yields each piece's row count."""
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    for number, piece in enumerate(pieces):
        table = vehicle_table(piece)
        if number == 0:
            writer.writerow(table)
        writer.writerows(zip(*(_as_text(column) for column in table.values()), strict=True))
        yield len(table["time_s"])
    text.detach()


def _as_text(column: np.ma.MaskedArray) -> list[object]:
    values = column.tolist()  # None where masked
    if column.dtype.kind != "f":
        return values
    return [None if value is None else EXACT % value for value in values]


FORMATS: dict[str, Callable[[Iterable[Recording], IO[bytes]], Iterator[int]]]
FORMATS = {".parquet": write_parquet, ".csv": write_csv, ".fcd.xml": write_fcd}


def check_target(path: Path) -> str:
    """Returns the extension of `path` in `FORMATS`, after checking that the file can be written.

    Raises:
      InputError: the extension is unknown, path is a directory, or its directory is not writable.
      ImportError: the library that the format needs is missing.
    """
    ending = next((ending for ending in FORMATS if path.name.endswith(ending)), None)
    if ending is None:
        raise InputError(f"cannot write {path}: allowed endings {', '.join(FORMATS)}")
    check_output("trajectories", path)
    if ending == ".parquet" and importlib.util.find_spec("pyarrow") is None:
        raise ImportError('Parquet needs pyarrow: pip install -e ".[trajectories]"')
    return ending


def write_trajectories(recording: Recording | Iterable[Recording], path: str | Path) -> int:
    """Writes a recording to `path`, replacing any existing file.

    Args:
      recording: from `medjax.episodes.recording.record_episode`, or the pieces of `record_pieces`. Only one piece is in
        memory at a time.
      path: with an extension in `FORMATS`.

    Returns:
      Rows written, one per vehicle and tick.

    Raises:
      ValueError, ImportError: as in `check_target`.
    """
    path = as_path("path", path)
    write = FORMATS[check_target(path)]
    pieces = [recording] if isinstance(recording, Recording) else recording
    with replacing(path) as partial, partial.open("wb") as file:
        return sum(write(pieces, file))

"""Encodes pictures into a video file with the ffmpeg of imageio-ffmpeg."""

import contextlib
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from medjax.errors import MissingLibrary

_H264 = ("-c:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p", "-movflags", "+faststart")


def ffmpeg_program() -> str:
    """Path of ffmpeg; raises MissingLibrary if imageio-ffmpeg is not installed."""
    try:
        import imageio_ffmpeg
    except ImportError:
        raise MissingLibrary("imageio-ffmpeg") from None
    return str(imageio_ffmpeg.get_ffmpeg_exe())


@contextlib.contextmanager
def encode(
    path: Path, rate: Fraction, size: tuple[int, int], samples: Sequence[np.ndarray]
) -> Iterator[Callable[[np.ndarray], object]]:
    """Yields a function that adds a picture, `(height, width, 3)` uint8, to the video at path.

    Args:
      path: file to write; its ending, .mp4 or .gif, decides the format.
      rate: pictures per second.
      size: width and height, even for .mp4.
      samples: pictures from which the 256 colours of a GIF are chosen.

    Raises:
      OSError: ffmpeg could not write the file; quotes its message.
    """
    with tempfile.TemporaryDirectory() as scratch, tempfile.TemporaryFile() as log:
        form: Sequence[str] = _H264
        if path.suffix == ".gif":
            # One palette for all pictures, so that unchanged areas cost nothing.
            _save_palette(Path(scratch) / "palette.png", samples)
            use = "movie=palette.png[p];[0:v][p]paletteuse=dither=none:diff_mode=rectangle"
            form = ("-filter_complex", use)
        raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}")
        ways = ("-r", str(rate), "-i", "-", *form, str(path.resolve()))
        process = subprocess.Popen(
            [ffmpeg_program(), "-y", "-loglevel", "error", *raw, *ways],
            cwd=scratch,  # a filter cannot take a path with a colon in it
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=log,
        )
        pipe = process.stdin
        assert pipe is not None
        try:
            with contextlib.suppress(BrokenPipeError):  # ffmpeg's log says more
                yield lambda picture: pipe.write(np.ascontiguousarray(picture).data)
                pipe.close()
            process.wait()
        except BaseException:
            process.kill()
            process.wait()
            raise
        if process.returncode:
            log.seek(0)
            said = log.read().decode("utf-8", "replace").split("\n")[0]
            raise OSError(f"ffmpeg: {said}")


def _save_palette(path: Path, pictures: Sequence[np.ndarray]) -> None:
    """Saves the 256 colours that fit all pictures best, as the 16 x 16 image that ffmpeg reads."""
    from PIL import Image

    together = Image.fromarray(np.concatenate(pictures))
    colors = np.array(together.quantize(256).getpalette("RGB"), np.uint8).reshape(-1, 3)
    square = np.zeros((256, 3), np.uint8)
    square[: len(colors)] = colors
    Image.fromarray(square.reshape(16, 16, 3)).save(path)

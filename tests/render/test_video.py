"""Videos and pictures, read back."""

import dataclasses

import numpy as np
import pytest

from medjax.render.scene import Timeline

Image = pytest.importorskip("PIL.Image", reason="videos need Pillow")
ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="videos need imageio-ffmpeg")
from medjax.render.video import Shot, per_tick, picture_times, write_png, write_video  # noqa: E402

SHOT = Shot(start_s=30.0, duration_s=2.0, width=321, height=240)


@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")  # of the reader
def test_mp4_has_five_pictures_a_tick_at_true_speed(recording, tmp_path):
    write_video(tmp_path / "a.mp4", recording, SHOT)
    reader = ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    about = next(reader)
    pictures = [np.frombuffer(data, np.uint8).reshape(240, 320, 3) for data in reader]
    assert len(pictures) == 40
    assert about["fps"] == 20.0
    assert about["size"] == (320, 240)  # even
    assert about["duration"] == pytest.approx(2.0, abs=0.05)
    assert not np.array_equal(pictures[0], pictures[-1])
    assert list(tmp_path.iterdir()) == [tmp_path / "a.mp4"]


def test_gif_has_true_speed(recording, tmp_path):
    write_video(tmp_path / "a.gif", recording, SHOT)
    with Image.open(tmp_path / "a.gif") as gif:
        assert gif.size == (320, 240)
        total = 0
        for number in range(gif.n_frames):
            gif.seek(number)
            total += gif.info["duration"]
    assert total == pytest.approx(2000, abs=50)  # equal pictures may be merged, their time stays


def test_png_is_the_picture(recording, tmp_path):
    write_png(tmp_path / "a.png", recording, dataclasses.replace(SHOT, follow="EV:1"))
    with Image.open(tmp_path / "a.png") as png:
        assert png.size == (321, 240)


def test_every_tick_is_a_picture(recording):
    times = picture_times(Timeline(recording), 10.0, 5.0)
    assert len(times) == 100
    assert set(np.arange(10.0, 15.0, 0.25)) <= set(times.round(9))
    assert [per_tick(tick) for tick in (0.02, 0.1, 0.25, 0.5)] == [1, 2, 5, 10]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"start_s": 91.0}, "allowed 0 to 90 s"),
        ({"follow": "EV:9999"}, "allowed EV numbers: 1 to"),
        ({"follow": "4001"}, "allowed 0 to 4000 m"),
        ({"width": 100}, "allowed 160 to 8192 px"),
    ],
)
def test_bad_input_leaves_the_old_file(recording, tmp_path, change, says):
    out = tmp_path / "a.mp4"
    out.write_text("old")
    with pytest.raises(ValueError, match=says):
        write_video(out, recording, dataclasses.replace(SHOT, **change))
    assert out.read_text() == "old"
    assert list(tmp_path.iterdir()) == [out]


def test_a_full_disk_is_an_error_and_leaves_nothing(recording, tmp_path, monkeypatch):
    monkeypatch.setattr("medjax.render.encoder.ffmpeg_program", lambda: "false")
    with pytest.raises(OSError, match="ffmpeg"):
        write_video(tmp_path / "a.mp4", recording, SHOT)
    assert not list(tmp_path.iterdir())

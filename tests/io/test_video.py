"""mp4 files: read back with ffmpeg they have the pictures, the size and the colours that were put in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from videos import read_back

from tnst_mi.errors import InputError
from tnst_mi.io.pictures.video import open_video


@pytest.mark.parametrize("rows, columns", [(48, 64), (33, 47), (18, 30)])
def test_every_picture_is_there_in_order_and_in_its_colours(tmp_path: Path, rows: int, columns: int) -> None:
    colours = np.array([[0.9, 0.1, 0.1], [0.1, 0.8, 0.2], [0.15, 0.2, 0.9], [1.5, 1.0, 1.0], [-1.0, 0.0, 0.0]])
    with open_video(tmp_path / "a.mp4", frames_per_second=10.0) as video:
        for colour in colours:
            video.add(np.broadcast_to(colour, (rows, columns, 3)))
    pictures, about = read_back(tmp_path / "a.mp4")
    assert pictures.shape == (5, rows + rows % 2, columns + columns % 2, 3)
    assert about["codec"] == "h264" and about["fps"] == 10.0 and about["pix_fmt"].startswith("yuv420p")
    expected = 255 * np.clip(colours, 0, 1)
    np.testing.assert_allclose(pictures.mean((1, 2)), expected, atol=4)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


def test_rows_run_downwards_and_grey_stays_grey(tmp_path: Path) -> None:
    ramp = np.repeat(np.linspace(0, 1, 32)[:, None], 40, axis=1)
    with open_video(tmp_path / "a.mp4") as video:
        video.add(ramp)
    picture = read_back(tmp_path / "a.mp4")[0][0]
    np.testing.assert_allclose(picture[..., 1], 255 * ramp, atol=6)
    assert np.ptp(picture.astype(int), axis=-1).max() <= 3


def test_a_video_that_is_not_finished_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_text("an earlier one")
    with pytest.raises(KeyboardInterrupt), open_video(tmp_path / "a.mp4") as video:
        video.add(np.zeros((16, 16)))
        raise KeyboardInterrupt
    with (
        pytest.raises(InputError, match="16 x 18 pixels after ones of 16 x 16"),
        open_video(tmp_path / "b.mp4") as video,
    ):
        video.add(np.zeros((16, 16)))
        video.add(np.zeros((18, 16)))
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.mp4": "an earlier one"}


def test_a_video_that_could_not_be_written_is_no_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The encoder does not tell that a disk is full: the pictures in the file are counted."""
    monkeypatch.setattr("imageio_ffmpeg.count_frames_and_secs", lambda path: (2, 0.1))
    with pytest.raises(OSError, match="ffmpeg wrote 2 of 3 pictures"), open_video(tmp_path / "a.mp4") as video:
        for _ in range(3):
            video.add(np.zeros((16, 16), np.float32))
    assert not any(tmp_path.iterdir())

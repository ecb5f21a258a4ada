"""H.264 videos in mp4 files, encoded by the ffmpeg that the package imageio-ffmpeg bundles."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import write_failure, written_whole
from tnst_mi.io.pictures.png import eight_bits

#: Optional, since the package is large; without it there are no videos.
_ffmpeg: Any = importlib.import_module("imageio_ffmpeg") if importlib.util.find_spec("imageio_ffmpeg") else None

#: Frames per second of videos, and of the smoke that they show, unless the user says otherwise.
FRAMES_PER_SECOND = 24.0

#: Tags written into the file; without them, players guess the colour matrix from the size of the picture.
_COLOURS = ["-vf", "scale=out_color_matrix=bt709"]
_COLOURS += ["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "iec61966-2-1"]

_PLAYS_WHILE_LOADING = ["-movflags", "+faststart"]


def can_encode() -> bool:
    """Whether the package that bundles ffmpeg is installed."""
    return _ffmpeg is not None


class Video:
    """A video that is being written; `add` its pictures one by one."""

    def __init__(self, path: Path, frames_per_second: float) -> None:
        self._path, self._frames_per_second = path, frames_per_second
        self._encoder: Any = None
        self._shape: tuple[int, int] = (0, 0)
        self._count = 0

    def add(self, image: np.ndarray) -> None:
        """Append a picture (H, W) or (H, W, 3), row 0 at the top; 0 is black, 1 and above full brightness.

        All pictures must have the size of the first. An odd width or height is made even, as the format requires, by
        repeating the last column or row.

        Raises:
            InputError: the picture differs in size from the first.
            OSError: the encoder has ended, for instance because of a full disk.
        """
        rows, columns = image.shape[:2]
        pixels = eight_bits(image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2))
        pixels = np.pad(pixels, ((0, rows % 2), (0, columns % 2), (0, 0)), mode="edge")
        if self._encoder is None:
            self._shape = (rows, columns)
            self._encoder = self._started(pixels.shape[1], pixels.shape[0])
        if (rows, columns) != self._shape:
            first = f"{self._shape[1]} x {self._shape[0]}"
            raise InputError(f"video: a picture of {columns} x {rows} pixels after ones of {first}, expected one size")
        try:
            self._encoder.send(np.ascontiguousarray(pixels))
        except OSError as error:
            self._encoder = None
            raise write_failure(self._path, "ffmpeg has ended early") from error
        self._count += 1

    def _started(self, columns: int, rows: int) -> Any:
        encoder = _ffmpeg.write_frames(
            str(self._path),
            (columns, rows),
            fps=self._frames_per_second,
            codec="libx264",
            quality=8,
            macro_block_size=2,
            ffmpeg_log_level="error",
            output_params=_COLOURS + _PLAYS_WHILE_LOADING,
        )
        encoder.send(None)
        return encoder

    def close(self) -> None:
        """Finish the file.

        Raises:
            OSError: pictures are missing, for instance because of a full disk, which the encoder does not report.
        """
        if self._encoder is None:
            return
        self._encoder.close()
        self._encoder = None
        try:
            count, _ = _ffmpeg.count_frames_and_secs(str(self._path))
        except (OSError, RuntimeError):
            count = 0
        if count != self._count:
            raise write_failure(self._path, f"ffmpeg wrote {count} of {self._count} pictures")


@contextmanager
def open_video(path: Path, frames_per_second: float = 24.0) -> Iterator[Video]:
    """A `Video` whose file appears, complete, only if the block ends without an exception.

    Args:
        path: the file, ending in .mp4.
        frames_per_second: how fast it plays.

    Raises:
        InputError: no encoder is installed.
    """
    if not can_encode():
        raise InputError(f"{path}: videos need the package imageio-ffmpeg, which is not installed: pip install it")
    with written_whole(path) as temporary:
        video = Video(temporary, frames_per_second)
        try:
            yield video
        except BaseException:
            with suppress(OSError):
                video.close()
            raise
        video.close()

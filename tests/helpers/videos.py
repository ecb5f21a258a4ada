"""Reading back the videos that tests have written."""

from __future__ import annotations

from pathlib import Path

import imageio_ffmpeg
import numpy as np


def read_back(path: Path) -> tuple[np.ndarray, dict[str, object]]:
    """All pictures (N, H, W, 3), and what the file says about itself."""
    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    columns, rows = about["size"]
    return np.stack([np.frombuffer(frame, np.uint8).reshape(rows, columns, 3) for frame in reader]), about

"""What Blender finds in our VDB files."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tnst_mi.frame import Frame
from tnst_mi.io.sequence import save_frame

SCRIPT = Path(__file__).parents[2] / "scripts" / "open_in_blender.py"


pytestmark = pytest.mark.skipif(shutil.which("blender") is None, reason="Blender is not installed")


@pytest.fixture
def smoke(tmp_path: Path) -> Path:
    """Smoke that is red below and green above."""
    density = np.zeros((6, 8, 6), np.float32)
    density[1:5, 1:7, 1:5] = 1.0
    colour = np.zeros((*density.shape, 3), np.float32)
    colour[:, :4, :, 0] = colour[:, 4:, :, 1] = 1.0
    file = tmp_path / "smoke.vdb"
    save_frame(file, Frame(density, grids={"Cd": colour}))
    return file


def opened(*arguments: str | Path) -> list[str]:
    """The lines that the script prints."""
    ran = subprocess.run([sys.executable, SCRIPT, *arguments], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout.splitlines()


def test_blender_finds_colours_on_the_voxels_of_the_density(smoke: Path) -> None:
    told = dict(line.strip().split(": ", 1) for line in opened(smoke) if ": " in line)
    assert told["Cd"] == f"vector_{told['density']}", "three components"
    assert told["density"].startswith("float, cell (1, 1, 1)")


def test_a_picture_shows_them(smoke: Path, tmp_path: Path) -> None:
    opened(smoke, "--render", tmp_path / "seen.png")
    picture = np.asarray(Image.open(tmp_path / "seen.png").convert("RGB"), float)
    rows, columns, _ = picture.shape
    above, below = (picture[int(part * rows), columns // 2] for part in (0.35, 0.65))
    assert above[1] > 2 * above[0] and below[0] > 2 * below[1]

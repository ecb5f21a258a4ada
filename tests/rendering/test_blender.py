"""The studio in Blender: the same picture as Mitsuba's, with fire, from a turned view."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.machine import blender
from tnst_mi.machine.blender import require_blender, run_in_blender
from tnst_mi.rendering.blender import BlenderPainter
from tnst_mi.rendering.fire import find_fire
from tnst_mi.rendering.pictures import PathTracedPainter

needs_blender = pytest.mark.skipif(shutil.which("blender") is None, reason="Blender is not installed")

SIZE, VIEW, FRONT = (48, 48), (40.0, 12.0), (0.0, 0.0)


def burning() -> Frame:
    """A body of smoke that is nowhere symmetric, with a fire in its lower left."""
    z, y, x = np.mgrid[:14, :18, :16] + 0.5
    density = np.exp(-(((z - 6) / 3) ** 2 + ((y - 10) / 4) ** 2 + ((x - 9) / 3) ** 2))
    flame = np.exp(-(((z - 9) / 2) ** 2 + ((y - 5) / 2) ** 2 + ((x - 4) / 2) ** 2))
    density[density < 0.02], flame[flame < 0.02] = 0, 0
    return Frame(density, grids={"flame": flame})


@needs_blender
def test_blender_and_mitsuba_show_the_same() -> None:
    """Two renderers of the same scene with nothing in common; also fire is as bright, and where it should be."""
    frame = burning()
    fire = find_fire([frame])
    assert fire is not None
    theirs = BlenderPainter(frame.density.shape, [VIEW], "medium", SIZE, 256, 0, fire).paint(frame, VIEW, 0)
    ours = PathTracedPainter([frame], [VIEW], "medium", "volpath", SIZE, 128, 0, False, fire).paint(frame, VIEW, 0)
    assert theirs.shape == ours.shape == (48, 48, 3)

    def blocks(image: np.ndarray) -> np.ndarray:
        """Means over 8 × 8 pixels, whose noise is an eighth of a pixel's."""
        return image.reshape(6, 8, 6, 8, 3).mean((1, 3))

    np.testing.assert_allclose(theirs.mean((0, 1)), ours.mean((0, 1)), rtol=0.03)
    np.testing.assert_allclose(blocks(theirs), blocks(ours), rtol=0.15)
    # There is something to see: the fire is red, in the lower left from the front.
    assert blocks(ours)[..., 0].max() > 2 * np.median(blocks(ours)[..., 0])


def coloured(white: Frame) -> Frame:
    """The same smoke, red on the left and blue on the right, in whole numbers."""
    colour = np.zeros((*white.density.shape, 3), np.uint8)
    colour[:, :, :9, 0] = colour[:, :, 9:, 2] = 255
    return Frame(white.density, grids={"tint": colour})


@needs_blender
def test_smoke_has_its_colour_where_the_frame_has_it() -> None:
    """The smoke reaches further to the left than to the right of the two middle columns of the picture."""
    frame = coloured(burning())
    painter = BlenderPainter(frame.density.shape, [FRONT], "medium", (12, 12), 8, 0, None, "tint")
    left, right = painter.paint(frame, FRONT, 0)[4:7].reshape(3, 4, 3, 3).mean((0, 2))[1:3]
    assert left[0] > 1.5 * left[2] and right[2] > 1.5 * right[0]


@needs_blender
def test_colours_are_those_of_mitsuba() -> None:
    """Another frame of the sequence, which lacks the grid, is white in both."""
    white = burning()
    frame = coloured(white)
    theirs = BlenderPainter(frame.density.shape, [FRONT], "medium", SIZE, 128, 0, None, "tint")
    ours = PathTracedPainter(
        [frame, white], [FRONT], "medium", "volpath", SIZE, 128, 0, denoise=False, fire=None, colour="tint"
    )
    for shown in (frame, white):
        pictures = [painter.paint(shown, FRONT, 0) for painter in (theirs, ours)]
        blocks = [picture.reshape(6, 8, 6, 8, 3).mean((1, 3)) for picture in pictures]
        np.testing.assert_allclose(blocks[0], blocks[1], rtol=0.12, atol=0.005)
        np.testing.assert_allclose(blocks[0].mean((0, 1)), blocks[1].mean((0, 1)), rtol=0.03)


def test_the_time_of_a_picture_grows_with_its_samples_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """One sample takes 1 s, four take 2.5 s: each adds 0.5 s."""
    monkeypatch.setattr(blender.shutil, "which", lambda program: program)
    monkeypatch.setattr(BlenderPainter, "_rendered", lambda *_: (np.zeros((24, 24, 3)), [1.0, 2.5]))
    frame = burning()
    few, many = (
        BlenderPainter(frame.density.shape, [VIEW], "thin", (24, 24), samples, 0, None).seconds(frame, VIEW)
        for samples in (8, 108)
    )
    assert many - few == pytest.approx(50.0, abs=0.1)


@needs_blender
def test_what_scripts_say_and_how_they_end(tmp_path) -> None:
    script = tmp_path / "script.py"
    script.write_text("import sys\nprint('Fra:1 progress')\nprint('told', sys.argv[-1])\nsys.exit(7)\n")
    lines: list[str] = []
    assert run_in_blender(script, ["what"], lines.append) == 7
    assert "told what" in lines and not any("progress" in line for line in lines)


def test_a_failure_of_blender_is_told(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "blender"
    program.write_text("#!/bin/sh\necho no such luck\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    frame = burning()
    painter = BlenderPainter(frame.density.shape, [VIEW], "thin", (24, 24), 1, 0, None)
    with pytest.raises(RuntimeError, match="Blender ended with code 3: no such luck"):
        painter.paint(frame, VIEW, 0)


def test_a_computer_without_blender(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blender.shutil, "which", lambda program: None)
    with pytest.raises(InputError, match=r"no program blender: install Blender \(apt-get install blender\)"):
        require_blender()

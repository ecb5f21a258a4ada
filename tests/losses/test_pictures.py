"""Style and content pictures: grey values, cropping and resizing, damaged files, the shipped styles."""

from __future__ import annotations

import importlib.util
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageOps

from tnst_mi.errors import InputError
from tnst_mi.losses.pictures import GreyImage, centred_box, read_image, resized

CHECKOUT = Path(__file__).resolve().parents[2]
STYLES = CHECKOUT / "tnst_mi" / "data" / "styles"


def saved(path: Path, pixels: np.ndarray, mode: str | None = None) -> Path:
    image = Image.fromarray(pixels)
    (image if mode is None else image.convert(mode)).save(path)
    return path


def keys_bicubic(signal: np.ndarray, n: int) -> np.ndarray:
    """Oracle: resample one row by Keys' kernel (a = -1/2), widened when shrinking."""
    scale = len(signal) / n
    stretch = max(scale, 1.0)
    centres = (np.arange(n) + 0.5) * scale
    t = np.abs(np.arange(len(signal)) + 0.5 - centres[:, None]) / stretch
    kernel = np.where(t < 1, 1.5 * t**3 - 2.5 * t**2 + 1, -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2) * (t < 2)
    return (kernel / kernel.sum(1, keepdims=True)) @ signal


def test_grey_is_the_plain_mean_of_the_three_channels(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    image = read_image(saved(tmp_path / "colour.png", pixels))
    assert image.name == "colour.png" and image.alpha is None and image.grey.dtype == np.float32
    np.testing.assert_allclose(image.grey, pixels.astype(float).sum(-1) / 765.0, atol=1e-7)


@pytest.mark.parametrize("mode", ["L", "1", "P", "LA", "CMYK"])
def test_other_kinds_of_pixels_agree_with_their_rgb_form(tmp_path: Path, mode: str) -> None:
    pixels = np.kron(np.random.default_rng(1).integers(0, 2, (4, 6)), np.ones((3, 3))).astype(np.uint8) * 255
    path = saved(tmp_path / "picture.tif", pixels, mode)
    image = read_image(path)
    np.testing.assert_array_equal(image.grey, pixels / 255.0)
    assert (image.alpha is None) == (mode != "LA")


def test_sixteen_bit_grey_keeps_its_precision(tmp_path: Path) -> None:
    pixels = np.array([[0, 1, 256], [40000, 65534, 65535]], np.uint16)
    np.testing.assert_allclose(read_image(saved(tmp_path / "deep.png", pixels)).grey, pixels / 65535, atol=1e-7)


def test_alpha_is_kept_apart_and_does_not_darken_the_grey(tmp_path: Path) -> None:
    pixels = np.random.default_rng(2).integers(0, 256, (4, 5, 4), dtype=np.uint8)
    image = read_image(saved(tmp_path / "masked.png", pixels))
    np.testing.assert_allclose(image.grey, pixels[..., :3].astype(float).sum(-1) / 765.0, atol=1e-7)
    np.testing.assert_allclose(image.alpha, pixels[..., 3] / 255.0, atol=1e-7)


def test_a_palette_with_a_transparent_entry_gives_a_mask(tmp_path: Path) -> None:
    image = Image.fromarray(np.array([[0, 1], [1, 0]], np.uint8)).convert("P")
    image.putpalette([255, 255, 255, 30, 60, 90])
    image.save(tmp_path / "palette.png", transparency=0)
    read = read_image(tmp_path / "palette.png")
    np.testing.assert_array_equal(read.alpha, [[0, 1], [1, 0]])
    np.testing.assert_allclose(read.grey[read.alpha == 1], 60 / 255, atol=1e-7)


def test_a_photograph_is_turned_as_its_camera_says(tmp_path: Path) -> None:
    pixels = np.zeros((8, 16), np.uint8)
    pixels[:, :8] = 255
    exif = Image.Exif()
    exif[0x0112] = 6  # stored lying on its left side
    Image.fromarray(pixels).save(tmp_path / "photo.png", exif=exif)
    grey = read_image(tmp_path / "photo.png").grey
    assert grey.shape == (16, 8)
    assert (grey[:8] == 1.0).all() and (grey[8:] == 0.0).all()


@pytest.mark.parametrize("shape", [(40, 60), (60, 40), (30, 90)])
@pytest.mark.parametrize("height, width", [(96, 64), (64, 96), (50, 50)])
def test_the_crop_is_the_largest_centred_part_of_the_right_aspect(
    shape: tuple[int, int], height: int, width: int
) -> None:
    left, top, right, bottom = centred_box(shape, height, width)
    assert (right - left) / (bottom - top) == pytest.approx(width / height)
    assert left == pytest.approx(shape[1] - right) and top == pytest.approx(shape[0] - bottom)
    assert min(left, top) == pytest.approx(0.0) and min(left, top) >= 0.0


def test_fitting_shows_the_middle_of_the_picture_and_of_its_mask() -> None:
    grey = np.zeros((40, 120), np.float32)
    grey[:, 50:70] = 1.0
    image = GreyImage("bar", grey, 1.0 - grey).fitted(20, 20)
    assert image.grey.shape == image.alpha.shape == (20, 20)
    assert (image.grey[:, 7:13] > 0.99).all() and (image.grey[:, [0, 1, 2, 17, 18, 19]] < 0.01).all()
    np.testing.assert_allclose(image.alpha, 1.0 - image.grey, atol=1e-6)
    np.testing.assert_allclose(image.grey, image.grey[:, ::-1], atol=1e-6)


@pytest.mark.parametrize("n", [5, 16, 31, 48])
def test_resizing_is_antialiased_bicubic(n: int) -> None:
    signal = 0.3 + 0.4 * np.random.default_rng(3).random(24)
    expected = np.clip(keys_bicubic(signal, n), 0.0, 1.0)
    rows = resized(np.tile(np.float32(signal), (4, 1)), 4, n)
    np.testing.assert_allclose(rows, np.tile(expected, (4, 1)), atol=1e-5)


def test_resizing_keeps_an_image_of_the_right_size_and_clips_overshoot() -> None:
    plane = np.random.default_rng(4).random((9, 11)).astype(np.float32)
    np.testing.assert_array_equal(resized(plane, 9, 11), plane)
    step = np.zeros((4, 8), np.float32)
    step[:, 4:] = 1.0
    assert keys_bicubic(step[0], 24).max() > 1.05, "the kernel overshoots at a step"
    assert resized(step, 4, 24).max() == 1.0 and resized(step, 4, 24).min() == 0.0


def write_truncated(path: Path) -> None:
    Image.fromarray(np.random.default_rng(5).integers(0, 256, (64, 64), dtype=np.uint8)).save(path, "PNG")
    path.write_bytes(path.read_bytes()[:2000])


DAMAGED = {
    "a text file": (lambda path: path.write_text("not a picture"), "known format"),
    "an empty file": (lambda path: path.write_bytes(b""), "known format"),
    "a PostScript file": (
        lambda path: path.write_text("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n"),
        "format",
    ),
    "a truncated picture": (write_truncated, "unreadable"),
    "one pixel": (lambda path: Image.new("RGB", (1, 1)).save(path, "PNG"), "1 x 1"),
    "one row": (lambda path: Image.new("RGB", (9, 1)).save(path, "PNG"), "9 x 1"),
    "floats": (lambda path: Image.new("F", (4, 4)).save(path, "TIFF"), "floating-point"),
    "wholly transparent": (lambda path: Image.new("RGBA", (4, 4)).save(path, "PNG"), "alpha"),
    "a folder": (lambda path: path.mkdir(), "no such picture"),
    "missing": (lambda path: None, "no such picture"),
}


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_picture_that_cannot_be_used_is_named_in_one_line(tmp_path: Path, kind: str) -> None:
    write, complaint = DAMAGED[kind]
    path = tmp_path / "style.png"
    write(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=complaint) as error:
            read_image(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("side", [11, 15, 100])
def test_a_picture_beyond_the_pixel_limit_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, side: int
) -> None:
    Image.new("RGB", (side, side)).save(tmp_path / "huge.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 120)
    with pytest.raises(InputError, match=r"huge.png: the picture has more than 120 pixels"):
        read_image(tmp_path / "huge.png")


@pytest.mark.parametrize("name", ["spirals", "net", "flames", "cells"])
def test_shipped_styles_are_contrasty_and_their_motifs_survive_on_smoke_images(name: str) -> None:
    path = STYLES / f"{name}.png"
    grey = read_image(path).grey
    assert path.stat().st_size < 400_000
    assert grey.shape == (512, 512) and grey.min() == 0.0 and grey.max() == 1.0
    assert (grey < 0.2).mean() > 0.2 and (grey > 0.6).mean() > 0.1 and grey.std() > 0.25
    power = np.abs(np.fft.fft2((grey - grey.mean()) * np.outer(np.hanning(512), np.hanning(512)))) ** 2
    cycles = np.hypot(*np.meshgrid(np.fft.fftfreq(512, 1 / 512), np.fft.fftfreq(512, 1 / 512)))
    assert power[(cycles >= 5) & (cycles <= 40)].sum() > 0.7 * power.sum()
    small = resized(grey, 96, 96)
    assert small.std() > 0.75 * grey.std()


def test_the_script_draws_the_shipped_pictures(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("draw_styles", CHECKOUT / "scripts" / "draw_styles.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    drawn = np.asarray(script.draw("net"), float)
    shipped = np.asarray(ImageOps.grayscale(Image.open(STYLES / "net.png")), float)
    assert np.abs(drawn - shipped).mean() < 0.1, "of 255; other processors may round differently"

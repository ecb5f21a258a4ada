"""Pictures of high dynamic range, and of formats that need more than Pillow: read, tone mapped, or with the remedy."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, features

from tnst_mi.errors import InputError
from tnst_mi.io.pictures.exr import write_exr
from tnst_mi.io.pictures.radiance import read_radiance
from tnst_mi.losses.pictures import read_image
from tnst_mi.losses.tone_mapping import tone_mapped

PICTURE = np.random.default_rng(0).lognormal(0.0, 2.0, (20, 30, 3)).astype(np.float32)


def rgbe(picture: np.ndarray) -> np.ndarray:
    """Ward's encoding: mantissas of 8 bits with the exponent of the largest."""
    _, exponent = np.frexp(picture.max(-1))
    mantissa = np.floor(np.ldexp(picture, 8 - exponent[..., None])).astype(np.uint8)
    return np.concatenate([mantissa, (exponent[..., None] + 128).astype(np.uint8)], axis=-1)


def decoded(packed: np.ndarray) -> np.ndarray:
    values = packed[..., :3] * 2.0 ** (packed[..., 3:].astype(np.float64) - 136)
    return np.where(packed[..., 3:] == 0, 0.0, values)


def header(rows: int, columns: int, axes: str = "-Y {} +X {}", more: str = "") -> bytes:
    return f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{more}\n{axes.format(rows, columns)}\n".encode()


def runs(row: np.ndarray) -> bytes:
    """A component of a scanline in runs and literal stretches of single bytes."""
    out, i = b"", 0
    while i < len(row):
        length = 1
        while i + length < len(row) and row[i + length] == row[i] and length < 127:
            length += 1
        out += bytes((128 + length, row[i])) if length > 1 else bytes((1, row[i]))
        i += length
    return out


def compressed(packed: np.ndarray) -> bytes:
    columns = packed.shape[1]
    return b"".join(
        bytes((2, 2, columns >> 8, columns & 255)) + b"".join(runs(row[:, c]) for c in range(4)) for row in packed
    )


# --- Radiance ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pack", [lambda packed: packed.tobytes(), compressed])
def test_radiance_pictures(tmp_path: Path, pack: object) -> None:
    picture = PICTURE.copy()
    picture[3:5, 4:20] = picture[3, 4]  # something to compress
    packed = rgbe(picture)
    packed[7, 8] = 0
    (tmp_path / "a.hdr").write_bytes(header(20, 30) + pack(packed))
    read = read_radiance(tmp_path / "a.hdr", 1 << 20)
    np.testing.assert_array_equal(read, decoded(packed).astype(np.float32))
    np.testing.assert_allclose(np.delete(read, 7, 0), np.delete(picture, 7, 0), rtol=1, atol=picture.max() / 128)


def test_repeated_pixels_of_old_files(tmp_path: Path) -> None:
    """(1, 1, 1, n) repeats; a second one counts 256 times as much."""
    data = bytes((10, 20, 30, 130)) + bytes((1, 1, 1, 4)) + bytes((1, 1, 1, 1)) + bytes((9, 9, 9, 129))
    (tmp_path / "a.pic").write_bytes(header(1, 262) + data)
    read = read_radiance(tmp_path / "a.pic", 1 << 20)
    assert (read[0, :261] == read[0, 0]).all() and read[0, 261, 0] == 9 * 2.0**-7


def test_axes_of_radiance_pictures(tmp_path: Path) -> None:
    packed = rgbe(PICTURE)
    for axes, expected in (("-Y {} +X {}", packed), ("+Y {} +X {}", packed[::-1]), ("-Y {} -X {}", packed[:, ::-1])):
        (tmp_path / "a.hdr").write_bytes(header(20, 30, axes) + packed.tobytes())
        np.testing.assert_array_equal(read_radiance(tmp_path / "a.hdr", 1 << 20), decoded(expected).astype(np.float32))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"#?RADIANCE\n", "not a Radiance picture, truncated, or damaged"),
        (header(99999, 99999), "has 99999 x 99999 pixels, expected at most 8388608; make it smaller"),
        (header(0, 5), "has 5 x 0 pixels"),
        (header(4, 4), "a scanline is truncated"),
        (header(1, 8) + bytes((2, 2, 0, 8, 0)), "a scanline is damaged"),
        (header(1, 8) + bytes((2, 2, 0, 8, 255, 1)), "a scanline is damaged"),
        (header(1, 8) + bytes((2, 2, 0, 8, 136)), "a scanline is damaged"),
        (header(1, 4) + bytes((1, 1, 1, 4)), "a scanline is damaged"),
        (header(4, 4, "+X {} -Y {}"), "expected a line with its size"),
        (header(4, 4).replace(b"rgbe", b"xyze"), "holds XYZ colours"),
    ],
)
def test_damaged_radiance_pictures(tmp_path: Path, data: bytes, message: str) -> None:
    (tmp_path / "a.hdr").write_bytes(data)
    with pytest.raises(InputError, match=message) as error:
        read_image(tmp_path / "a.hdr")
    assert "\n" not in str(error.value)


@settings(max_examples=150)
@given(data=st.binary(max_size=200), columns=st.integers(1, 20))
def test_any_scanlines_are_read_or_refused(tmp_path_factory: pytest.TempPathFactory, data: bytes, columns: int) -> None:
    path = tmp_path_factory.getbasetemp() / "any.hdr"
    path.write_bytes(header(3, columns) + bytes((2, 2, 0, columns)) + data)
    try:
        assert read_radiance(path, 1 << 20).shape == (3, columns, 3)
    except InputError:
        pass


# --- OpenEXR ----------------------------------------------------------------------------------------------


def test_exr_and_radiance_agree(tmp_path: Path) -> None:
    packed = rgbe(PICTURE)
    write_exr(tmp_path / "a.exr", decoded(packed).astype(np.float32), {})
    (tmp_path / "a.hdr").write_bytes(header(20, 30) + packed.tobytes())
    exr, hdr = read_image(tmp_path / "a.exr"), read_image(tmp_path / "a.hdr")
    np.testing.assert_array_equal(exr.grey, hdr.grey)
    assert exr.remarks == hdr.remarks == ("has a high dynamic range: tone mapped (Reinhard, log mean 0.18, then sRGB)",)


def test_linear_pictures_of_a_display_are_not_tone_mapped(tmp_path: Path) -> None:
    """A picture saved as PNG and, linear, as OpenEXR is the same to the network."""
    values = np.arange(256, dtype=np.float64).reshape(16, 16) / 255
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    write_exr(tmp_path / "a.exr", linear.astype(np.float32), {})
    picture = read_image(tmp_path / "a.exr")
    np.testing.assert_allclose(picture.grey, values, atol=1e-6)
    assert "tone mapped" not in picture.remarks[0]


def test_grey_exr_layers_and_alpha(tmp_path: Path) -> None:
    write_exr(tmp_path / "grey.exr", PICTURE[..., 0], {})
    write_exr(tmp_path / "same.exr", np.repeat(PICTURE[..., :1], 3, -1), {})
    np.testing.assert_allclose(
        read_image(tmp_path / "grey.exr").grey, read_image(tmp_path / "same.exr").grey, atol=1e-6
    )
    alpha = np.random.default_rng(1).uniform(0.2, 1, PICTURE.shape[:2]).astype(np.float32)
    alpha[0] = 0
    channels = {f"View.Combined.{c}": PICTURE[..., i] * alpha for i, c in enumerate("RGB")}
    channels = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels | {"View.Combined.A": alpha}) as file:
        file.write(str(tmp_path / "layers.exr"))
    image = read_image(tmp_path / "layers.exr")
    np.testing.assert_allclose(image.alpha, alpha)
    opaque = PICTURE.copy()
    opaque[0] = 0
    np.testing.assert_allclose(image.grey, tone_mapped(opaque).mean(-1), atol=1e-5)


def test_damaged_exr_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_exr(tmp_path / "a.exr", PICTURE, {})
    whole = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(whole[: len(whole) // 2])
    write_exr(tmp_path / "nan.exr", np.full((4, 4), np.nan, np.float32), {})
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Z": PICTURE[..., 0].copy()}) as file:
        file.write(str(tmp_path / "depth.exr"))
    for name, message in (("cut", "cut.exr: "), ("nan", "48 values are not finite"), ("depth", "has the channels Z")):
        with pytest.raises(InputError, match=message):
            read_image(tmp_path / f"{name}.exr")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    with pytest.raises(InputError, match="more than 100 pixels; make it smaller"):
        read_image(tmp_path / "a.exr")


# --- Tone mapping -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_the_unit_does_not_matter(unit: float) -> None:
    np.testing.assert_allclose(tone_mapped(PICTURE * np.float32(unit)), tone_mapped(PICTURE), atol=1e-5)


def test_tone_mapping_keeps_the_order_and_its_ends() -> None:
    """Black stays black, the brightest is white, and a uniform picture is Reinhard's closed form."""
    ramp = np.repeat(np.geomspace(1e-3, 1e3, 50)[None, :, None], 3, -1)
    ramp[0, 0] = 0
    shown = tone_mapped(ramp)[0, :, 0]
    assert shown[0] == 0 and shown[-1] == pytest.approx(1, abs=1e-6)
    assert (np.diff(shown) > 0).all()
    # L = L_white gives L (1 + 1 / L) / (1 + L) = 1.
    np.testing.assert_allclose(tone_mapped(np.full((2, 2, 3), 7.0)), 1.0, atol=1e-6)
    assert not tone_mapped(np.zeros((2, 2, 3))).any()


# --- Other formats ----------------------------------------------------------------------------------------


@pytest.mark.skipif(not features.check("avif"), reason="this Pillow reads no AVIF")
def test_avif(tmp_path: Path) -> None:
    pixels = np.random.default_rng(2).integers(0, 256, (8, 8, 3), np.uint8).repeat(8, 0).repeat(8, 1)
    Image.fromarray(pixels).save(tmp_path / "a.avif", quality=100)
    assert np.abs(read_image(tmp_path / "a.avif").grey - pixels.mean(-1) / 255).mean() < 0.02


def test_what_pillow_lacks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.heic").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(100))
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    with pytest.raises(InputError, match=r"a.heic: HEIC needs pillow-heif \(pip install pillow-heif\); or save it as"):
        read_image(tmp_path / "a.heic")
    (tmp_path / "a.avif").write_bytes(b"\0\0\0\x18ftypavif\0\0\0\0mif1avif" + bytes(100))
    Image.init()
    monkeypatch.delitem(Image.OPEN, "AVIF", raising=False)
    monkeypatch.setattr(Image, "init", lambda: None)
    with pytest.raises(InputError, match=r"a.avif: AVIF needs Pillow 11.3 or later"):
        read_image(tmp_path / "a.avif")


def test_a_nearly_flat_picture_is_remarked_upon(tmp_path: Path) -> None:
    pixels = np.full((16, 16), 128, np.uint8)
    pixels[0] = 131
    Image.fromarray(pixels).save(tmp_path / "flat.png")
    (remark,) = read_image(tmp_path / "flat.png").remarks
    assert remark == "is nearly flat (grey from 0.50 to 0.51), which leaves little to take on"
    pixels[::2] = 0
    Image.fromarray(pixels).save(tmp_path / "stripes.png")
    assert read_image(tmp_path / "stripes.png").remarks == ()

"""Undamaged files of smoke, recipes, cameras and pictures, small ones in every variant that the readers know."""

from __future__ import annotations

import gzip
import importlib.util
import io
import json
import struct
import tomllib
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from PIL import Image, ImageCms, features

from tnst_mi import Frame, Recipe, save_frames
from tnst_mi.geometry.affine import Affine
from tnst_mi.io.grids.uni import FLAGS, INTEGER, MAC, REAL, VECTOR, write_uni
from tnst_mi.io.grids.vdb import DenseGrid, write_vdb
from tnst_mi.io.grids.vol import write_vol
from tnst_mi.io.pictures.exr import write_exr

_VDB_OF_OTHERS = Path(__file__).parents[2] / "tests" / "data" / "vdb"

_SHAPE = (6, 9, 7)
_RNG = np.random.default_rng(0)
DENSITY = np.where(_RNG.random(_SHAPE) < 0.5, _RNG.random(_SHAPE), 0.0).astype(np.float32)
VELOCITY = _RNG.normal(size=(*_SHAPE, 3)).astype(np.float32)
OBSTACLE = _RNG.random(_SHAPE) < 0.2


def npz(arrays: Mapping[str, Any], method: int = zipfile.ZIP_STORED) -> bytes:
    """An npz file, whose members are compressed by any method of zip."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, array in arrays.items():
            archive.writestr(f"{name}.npy", npy(array))
    return stream.getvalue()


def npy(array: Any) -> bytes:
    """An npy file."""
    stream = io.BytesIO()
    np.save(stream, np.asanyarray(array))
    return stream.getvalue()


def npz_files(folder: Path) -> Iterator[bytes]:
    """Frames as npz files."""
    yield _written(folder / "a.npz", lambda path: save_frames(path, Frame(DENSITY, VELOCITY, OBSTACLE)))
    frame = {"density": DENSITY, "velocity": VELOCITY, "obstacle": OBSTACLE}
    yield npz(frame)
    yield npz({"x": DENSITY})
    yield npz({"arr_0": DENSITY[None, ..., None].astype(np.float64)})
    yield npz({"density": np.asfortranarray(DENSITY), "u": DENSITY, "v": DENSITY, "w": DENSITY, "flags": DENSITY})
    yield npz({"density": (DENSITY * 255).astype(np.uint8), "velocity": np.moveaxis(VELOCITY, -1, 0)})
    yield npz({"density": DENSITY[0], "vel": VELOCITY[0, ..., :2], "note": np.array("text"), "list": np.array([{}])})
    for method in (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        yield npz(frame, method)
    yield npz({"density": np.zeros((200, 200, 200), np.float32)}, zipfile.ZIP_DEFLATED)


def obstacle_files(folder: Path) -> Iterator[bytes]:
    """Obstacles as npz files, for a density in another one."""
    for obstacle in (OBSTACLE, OBSTACLE.astype(np.int32) * 2, OBSTACLE.astype(np.float32)):
        yield npz({"obstacle": obstacle})
        yield npz({"flags": obstacle, "other": DENSITY}, zipfile.ZIP_DEFLATED)


def npy_files(folder: Path) -> Iterator[bytes]:
    """Densities as npy files."""
    for array in (DENSITY, DENSITY.astype(">f8"), np.asfortranarray(DENSITY), (DENSITY * 9).astype(np.uint16)):
        yield npy(array)


def vdb_files(folder: Path) -> Iterator[bytes]:
    """Frames as .vdb files that we write."""
    turned = Affine(np.array([[0.0, 0, 0.1], [0.1, 0, 0], [0, 0.1, 0]]), np.array([1.0, 2, 3]))
    sheared = Affine(np.array([[0.1, 0.02, 0], [0, 0.1, 0], [0, 0, 0.2]]), np.zeros(3))
    tiles = np.zeros((24, 24, 24), np.float32)
    tiles[:16, :16, :16] = 1.0
    box = {"tnst_mi_box_min": ("vec3i", (-1, -1, -1)), "tnst_mi_box_max": ("vec3i", (9, 9, 9))}
    several = [DenseGrid("density", DENSITY), DenseGrid("velocity", VELOCITY, half=True)]
    several.append(DenseGrid("obstacle", OBSTACLE.astype(np.float32)))
    variants: list[tuple[list[DenseGrid], Mapping[str, tuple[str, Any]], str]] = [
        (several, box, "none"),
        (several, {"creator": ("string", "Blender/OpenVDBWriter")}, "blosc"),
        ([DenseGrid("density", DENSITY, (5, -9, 3), transform=turned)], {}, "none"),
        ([DenseGrid("density", DENSITY, transform=sheared), DenseGrid("vel", VELOCITY, transform=turned)], {}, "zip"),
        ([DenseGrid("density", tiles, half=True), DenseGrid("density", tiles, (40, 0, 0))], {}, "none"),
        ([DenseGrid(f"vel.{axis}", DENSITY) for axis in "xyz"] + several[:1], {}, "none"),
        ([DenseGrid("density", DENSITY, background=0.5)], {}, "none"),
    ]
    for grids, metadata, compression in variants:
        yield _written(folder / "a.vdb", lambda path, what=(grids, metadata, compression): write_vdb(path, *what))
    yield _written(folder / "a.vdb", lambda path: save_frames(path, Frame(DENSITY, VELOCITY, OBSTACLE)))


def vdb_files_of_others(folder: Path) -> Iterator[bytes]:
    """Files of OpenVDB's own module and of Blender."""
    for path in sorted(_VDB_OF_OTHERS.glob("*.vdb.gz")):
        yield gzip.decompress(path.read_bytes())


def uni_files(folder: Path) -> Iterator[bytes]:
    """Grids as .uni files of all three versions."""
    kinds = ((DENSITY, REAL), (VELOCITY, VECTOR | MAC), (OBSTACLE.astype(np.int32) * 2, INTEGER | FLAGS))
    for values, kind in kinds:
        newest = _written(folder / "a.uni", lambda path, what=(values, kind): write_uni(path, *what))
        yield newest
        content = gzip.decompress(newest)
        yield gzip.compress(b"MNT2" + content[4:], mtime=0)
        yield gzip.compress(b"MNT1" + content[4:28] + content[292:], mtime=0)
    yield gzip.compress(b"MNT1" + struct.pack("<6i", 7, 9, 6, REAL, 1, 8) + DENSITY.astype("<f8").tobytes(), mtime=0)


def vol_files(folder: Path) -> Iterator[bytes]:
    """Grids as .vol files in all three encodings."""
    for values in (DENSITY, VELOCITY):
        yield _written(folder / "a.vol", lambda path, values=values: write_vol(path, values))
    for encoding, dtype in ((2, "<f2"), (3, "u1")):
        header = struct.pack("<3sB5i6f", b"VOL", 3, encoding, 7, 9, 6, 1, *(0.0,) * 3, *(1.0,) * 3)
        yield header + DENSITY.astype(dtype).tobytes()


def recipe_files(folder: Path) -> Iterator[bytes]:
    """Recipes."""
    yield Recipe().to_toml().encode()
    yield b'style = ["flames", "net"]\neta = 0.01\nlam = {0 = 0.5, 30 = 1.0}\nwindow = 5\nframes = "1:20"\n'
    yield b'semantic = ["inception_4b/output:3,5"]\nazimuth = [-10, 10]\nweights = "patterns"\nlight = "key"\n'
    yield b"\xef\xbb\xbfseed = 3\r\noctaves = 3\r\nstyle = ['C:\\smoke\\fire.png']\r\n"
    yield b'content = ["flames"]\ndensity_scale = "auto"\nup = "z"\nflip = "x"\nmatch = ["logits:map.npy"]\n'
    yield b".".join([b"a"] * 20_000) + b" = 1\n"


def camera_files(folder: Path) -> Iterator[bytes]:
    """Cameras in TOML."""
    yield b'up_axis = "z"\nfov = 40\naspect = 1.5\n[frames.49]\nposition = [3, -4, 2]\ntarget = [0, 0, 1]\n'
    yield b"matrix = [[1, 0, 0, 3.5], [0, 1, 0, 2], [0, 0, 1, 9], [0, 0, 0, 1]]\nheight = 5\nresolution = [6, 4]\n"
    yield b"focal_length = 5\nsensor_width = 6\naspect = 2\nshift = [0, -2]\nposition = [0, 1, 2]\ntarget = [0, 0, 0]\n"


def camera_json_files(folder: Path) -> Iterator[bytes]:
    """The same in JSON."""
    for text in camera_files(folder):
        yield json.dumps(tomllib.loads(text.decode())).encode()


def picture_files(folder: Path) -> Iterator[bytes]:
    """Pictures in the formats that Pillow reads."""
    colour = (_RNG.random((12, 15, 4)) * 255).astype(np.uint8)
    rgb, grey = Image.fromarray(colour[..., :3]), Image.fromarray(colour[..., 0])
    yield _encoded(Image.fromarray(colour), "PNG")
    yield _encoded(rgb, "PNG")
    yield _encoded(rgb.quantize(8), "PNG", transparency=0)
    yield _encoded(Image.fromarray(colour[..., 0].astype(np.uint16) * 257), "PNG")
    yield _encoded(grey.convert("1"), "PNG")
    exif = Image.Exif()
    exif[274] = 6  # turned
    yield _encoded(rgb, "JPEG", exif=exif)
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    for format in ("PNG", "JPEG", *(("WEBP",) if features.check("webp") else ())):
        yield _encoded(rgb, format, exif=exif, icc_profile=profile)
    yield _encoded(rgb.convert("CMYK"), "JPEG")
    yield _encoded(rgb, "JPEG", progressive=True)
    for compression in ("raw", "tiff_lzw", "tiff_adobe_deflate", "packbits") if features.check("libtiff") else ("raw",):
        yield _encoded(rgb, "TIFF", compression=compression)
    for format in ("BMP", "PPM"):
        yield _encoded(rgb, format)
    yield _encoded(rgb.quantize(8), "GIF", save_all=True, append_images=[grey])
    yield b"P2 3 2 255\n0 1 2\n3 4 5\n"
    for format in ("WEBP", "AVIF"):
        if features.check(format.lower()):
            yield _encoded(rgb, format)
    if importlib.util.find_spec("pillow_heif") is not None:
        importlib.import_module("pillow_heif").register_heif_opener()
        yield _encoded(rgb, "HEIF")


def exr_files(folder: Path) -> Iterator[bytes]:
    """OpenEXR pictures."""
    colours = _RNG.random((12, 15, 3)).astype(np.float32)
    yield _written(folder / "a.exr", lambda path: write_exr(path, colours, {"exposure": 1.0}))
    yield _written(folder / "a.exr", lambda path: write_exr(path, colours[..., 0], {}))
    for compression in (OpenEXR.NO_COMPRESSION, OpenEXR.RLE_COMPRESSION, OpenEXR.PIZ_COMPRESSION):
        header = {"compression": compression, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, {"RGB": colours.astype(np.float16)}) as file:
            yield _written(folder / "a.exr", lambda path, file=file: file.write(str(path)))
    # Many layers, of which one is used: as many as are read, and more.
    for layers, edge in ((20, 500), (40, 1000)):
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        empty = {f"layer{number}.Y": np.zeros((edge, edge), np.float16) for number in range(layers)}
        with OpenEXR.File(header, empty) as file:
            yield _written(folder / "a.exr", lambda path, file=file: file.write(str(path)))


def radiance_files(folder: Path) -> Iterator[bytes]:
    """Radiance pictures: pixel by pixel, and in runs."""
    start, pixel = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n", bytes((9, 120, 30, 129))
    yield start + b"-Y 3 +X 4\n" + pixel * 12
    yield start + b"+Y 3 -X 4\n" + (pixel + bytes((1, 1, 1, 3))) * 3
    yield start + b"-Y 2 +X 10\n" + (bytes((2, 2, 0, 10)) + b"".join(bytes((138, value)) for value in pixel)) * 2
    yield b"#?RGBE\n\n-Y 1 +X 9\n" + bytes((2, 2, 0, 9)) + (bytes((9,)) + bytes(range(1, 10))) * 4


def _written(path: Path, write: Callable[[Path], Any]) -> bytes:
    write(path)
    return path.read_bytes()


def _encoded(image: Image.Image, format: str, **options: Any) -> bytes:
    stream = io.BytesIO()
    image.save(stream, format, **options)
    return stream.getvalue()

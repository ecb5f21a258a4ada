"""Pictures of smoke from known cameras, to reconstruct it from: EXR files, and cameras.toml that names them.

    python scripts/render_views.py scenes/obstacle --out views/ [--views 36] [--held-out 8] [--noise 1%] …

Perspective cameras stand on a sphere around the grid, one for each picture: evenly in azimuth, from 25° below to 45°
above. Those that are held out stand between them. The scene is the grid itself, in cells, its centre at the origin and
y up.
Pictures are those of emission and absorption in density × cells, in colour if frames have a grid Cd; or, with
--integrator prbvolpath, of scattered light, in radiance. A folder gives all of its frames, or those of --frames
FIRST:LAST.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import mitsuba as mi
import numpy as np

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.io import open_frames
from tnst_mi.io.atomic import written_whole
from tnst_mi.io.cameras.scene_camera import looking
from tnst_mi.io.pictures.exr import write_exr
from tnst_mi.machine.disk import require_writable
from tnst_mi.recipe.paths import LIGHTS
from tnst_mi.rendering.coloured_renderer import ColouredRenderer
from tnst_mi.rendering.renderer import Renderer
from tnst_mi.rendering.scattering import Lighting, ScatteringRenderer
from tnst_mi.rendering.smoke_colour import colour_name, colours_of

#: Vertical field of view in degrees.
FOV = 36.0

#: Fraction of a turn between elevations, that of the golden ratio: neighbours in azimuth never stand at one height.
GOLDEN = 0.618034


def places(count: int, radius: float, turned: float = 0.0) -> list[np.ndarray]:
    """Where cameras stand: (x, y, z) of each, evenly around the origin, from another azimuth if `turned`."""
    found = []
    for number in range(count):
        azimuth = 2 * math.pi * (number + turned) / count
        elevation = math.radians(-25 + 70 * ((GOLDEN * number + turned) % 1))
        x, z = math.sin(azimuth) * math.cos(elevation), math.cos(azimuth) * math.cos(elevation)
        found.append(radius * np.array([x, math.sin(elevation), z]))
    return found


def camera_at(place: np.ndarray) -> tnst_mi.Camera:
    """The camera that looks from there at the origin, with a square picture."""
    return tnst_mi.Camera(looking(place, np.zeros(3), np.array([0.0, 1.0, 0.0])), True, FOV, 1.0)


def radius_around(shape: Sequence[int]) -> float:
    """How far cameras have to stand to see all of a grid (D, H, W)."""
    return math.hypot(*shape) / 2 / math.sin(math.radians(FOV) / 2)


def with_noise(image: np.ndarray, deviation: float, seed: Sequence[int]) -> np.ndarray:
    """An image with normal noise of a standard deviation."""
    return image + np.random.default_rng(list(seed)).normal(0.0, deviation, image.shape).astype(np.float32)


def write_views(
    out: Path,
    frames: Sequence[tnst_mi.Frame],
    renderer: Renderer,
    counts: tuple[int, int],
    noise: float,
    gamma: float,
    others: str = "",
) -> Path:
    """Render all frames and write pictures and cameras.toml, whose path is returned.

    Args:
        out: folder.
        frames: of one shape; numbered ones get a picture each.
        renderer: of densities.
        counts: of cameras that are used, and that are held out.
        noise: standard deviation of the noise of the former, in parts of the largest value.
        gamma: for the file of cameras.
        others: further settings there, in TOML.
    """
    d, h, w = frames[0].density.shape
    radius = radius_around((d, h, w))
    stands = [*places(counts[0], radius), *places(counts[1], radius, 0.37)]
    names = [f"view_{n:02d}" if n < counts[0] else f"held_out_{n - counts[0]:02d}" for n in range(len(stands))]
    numbered = len(frames) > 1
    for index, frame in enumerate(frames):
        images = _images(frame, renderer, [camera_at(place) for place in stands])
        for number, (name, image) in enumerate(zip(names, images, strict=True)):
            if number < counts[0] and noise:
                image = with_noise(image, noise * float(images.max()), (index, number))
            write_exr(out / (f"{name}_{frame.number:04d}.exr" if numbered else f"{name}.exr"), image, {})
    rows, columns = renderer.size
    text = f'up_axis = "y"\nfov = {FOV}\nresolution = [{columns}, {rows}]\ntarget = [0, 0, 0]\n\n[reconstruction]\n'
    text += f"box = [{-w / 2}, {-h / 2}, {-d / 2}, {w / 2}, {h / 2}, {d / 2}]\ncells = {max(d, h, w)}\n"
    text += f"gamma = {gamma:g}\n{others}"
    for number, (name, place) in enumerate(zip(names, stands, strict=True)):
        text += f'\n[views.{name}]\nimage = "{name}{"_####" if numbered else ""}.exr"\n'
        text += f"position = [{', '.join(f'{x:.6f}' for x in place)}]\n"
        text += "held_out = true\n" if number >= counts[0] else ""
    with written_whole(out / "cameras.toml") as temporary:
        temporary.write_text(text, "utf-8")
    return out / "cameras.toml"


def _images(frame: tnst_mi.Frame, renderer: Renderer, cameras: Sequence[tnst_mi.Camera]) -> np.ndarray:
    """(V, H, W) of grey smoke, and (V, H, W, 3) of smoke in colour."""
    density, name = mi.TensorXf(frame.density), colour_name(frame.grids)
    if name is None or not isinstance(renderer, ColouredRenderer):
        return renderer.render(density, cameras).numpy()
    return renderer.colour_images(density, mi.TensorXf(colours_of(frame.grids, name, frame.name)), cameras).numpy()


def main() -> int:
    """Render the views that the command line asks for, and return the exit code."""
    try:
        print(_written(_parsed()))
    except InputError as error:
        print(f"render_views.py: {error}", file=sys.stderr)
        return 2
    return 0


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("input", type=Path, help="density file or folder of numbered ones")
    parser.add_argument("--out", type=Path, required=True, help="folder for pictures and cameras.toml")
    parser.add_argument("--frames", help="FIRST:LAST of a sequence (default: all)")
    parser.add_argument("--views", type=int, default=36, help="cameras to reconstruct from (default: %(default)s)")
    parser.add_argument("--held-out", type=int, default=8, help="cameras that judge (default: %(default)s)")
    parser.add_argument("--size", type=int, help="rows and columns of a picture (default: the grid's longest edge)")
    parser.add_argument(
        "--gamma", type=float, default=0.1, help="extinction per unit of density and cell (default: %(default)s)"
    )
    parser.add_argument(
        "--noise", default="0%", help="standard deviation, in parts of the largest value (default: 0%%)"
    )
    parser.add_argument(
        "--integrator",
        choices=("emission_absorption", "prbvolpath"),
        default="emission_absorption",
        help="what smoke does with light (default: %(default)s)",
    )
    parser.add_argument(
        "--albedo", type=float, default=0.9, help="prbvolpath: share of light that is scattered (default: %(default)s)"
    )
    parser.add_argument("--light", default="key", help="prbvolpath: key or environment (default: %(default)s)")
    parser.add_argument("--spp", type=int, default=256, help="prbvolpath: paths per pixel (default: %(default)s)")
    parser.add_argument("--overwrite", action="store_true", help="write into a folder that is not empty")
    return parser.parse_args()


def _written(given: argparse.Namespace) -> Path:
    """Write what was asked for; gives the file of cameras.

    Raises:
        InputError: something cannot be used.
    """
    require_writable(given.out, given.input, None if given.overwrite else "give another folder, or --overwrite")
    try:
        span = None if given.frames is None else tuple(int(part) for part in given.frames.split(":"))
        noise = float(given.noise.rstrip("%")) / (100 if given.noise.endswith("%") else 1)
    except ValueError:
        told = f"--frames {given.frames}, --noise {given.noise}"
        raise InputError(f"{told}: expected two numbers such as 49:72, and one such as 1%") from None
    tnst_mi.activate()
    frames = list(open_frames(given.input, span))
    shape = frames[0].density.shape
    side = given.size or max(shape)
    if given.integrator == "prbvolpath":
        lighting = Lighting(given.albedo, 0.0, LIGHTS / f"{given.light}.xml", given.spp)
        renderer: Renderer = ScatteringRenderer(shape, given.gamma, 1.0, lighting, (side, side))
        others = f'integrator = "prbvolpath"\nalbedo = {given.albedo}\nlight = "{given.light}"\n'
    else:
        renderer = ColouredRenderer(shape, given.gamma, "exact", 1.0, size=(side, side))
        others = "" if colour_name(frames[0].grids) is None else 'channel = "rgb"\n'
    return write_views(given.out, frames, renderer, (given.views, given.held_out), noise, given.gamma, others)


if __name__ == "__main__":
    sys.exit(main())

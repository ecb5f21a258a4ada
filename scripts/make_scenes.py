"""Make the sample frames of the bundled scenes from our full simulations.

    python scripts/make_scenes.py SOURCE [FOLDER]

SOURCE holds some of suzanne/frame_0010.npz, smokejet/frame_0057.npz to frame_0065.npz and obstacle/frame_0056.npz with
their meta.json, as simulated on 64 x 96 x 64 cells (`density` float32, `velocity` float16 in cells per frame). Suzanne
is kept as it is; the jet is averaged down to 48 x 72 x 48 cells and rounded so that its nine frames stay small; the
frame with the obstacle is rounded. Of smokejet_hires/frame_0066.npz (200 x 300 x 200 cells) the front view becomes
scenes/paper/fine_jet.png. scenes/ is written into FOLDER, by default the checkout.

The frame with the obstacle is simulated by `python scripts/simulate.py obstacle --frames 56 --out SOURCE/obstacle`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from simulate import CONVENTIONS

from tnst_mi import render
from tnst_mi.io.pictures.png import write_png

CHECKOUT = Path(__file__).resolve().parents[1]
SUZANNE_FRAMES = (10,)
SMOKEJET_FRAMES = tuple(range(57, 66))
SMOKEJET_SCALE = 0.75
# The jet is rounded to multiples of these: invisible in density, and the spacing of float16 between 2 and 4.
DENSITY_STEP = 2.0**-12
VELOCITY_STEP = 2.0**-9
OBSTACLE_FRAME = 56
OBSTACLE_VELOCITY_STEP = 2.0**-6
FINE_FRAME = 66
# γ times cells across: that of 0.1 on 64 cells.
FINE_GAMMA_CELLS = 6.4


def averaging_matrix(cells: int, coarse_cells: int) -> np.ndarray:
    """Return (coarse_cells, cells): each row averages exactly over the extent of one coarse cell."""
    size = cells / coarse_cells
    left = np.arange(coarse_cells)[:, None] * size
    fine = np.arange(cells)[None, :]
    return np.clip(np.minimum(left + size, fine + 1) - np.maximum(left, fine), 0.0, None) / size


def averaged_down(field: np.ndarray, scale: float) -> np.ndarray:
    """Average a (D, H, W) or (D, H, W, 3) field over cells that are 1 / scale as long."""
    result = np.float64(field)
    for axis in range(3):
        cells = field.shape[axis]
        matrix = averaging_matrix(cells, round(cells * scale))
        result = np.moveaxis(np.tensordot(matrix, result, (1, axis)), 0, axis)
    return result


def smokejet_frame(density: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Resample one frame; velocities stay in cells per frame, which are larger cells now."""
    density = averaged_down(density, SMOKEJET_SCALE)
    velocity = SMOKEJET_SCALE * averaged_down(velocity, SMOKEJET_SCALE)
    density = DENSITY_STEP * np.round(density / DENSITY_STEP)
    velocity = VELOCITY_STEP * np.round(velocity / VELOCITY_STEP)
    return np.float32(density), np.float16(velocity)


def read_frame(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read `density` and `velocity` of one source frame."""
    with np.load(path, allow_pickle=False) as arrays:
        return arrays["density"], arrays["velocity"]


def write_meta(folder: Path, source: dict, frames: tuple[int, ...], shape: tuple[int, ...], processing: str) -> None:
    """Write where the frames come from and what their numbers mean."""
    depth, height, width = shape
    meta = {
        "name": source["name"],
        "licence": "MIT; simulated for this project",
        "solver": source["solver"],
        "solver_build": source["solver_build"],
        "blender_version": source["blender_version"],
        "source": source["source"],
        "simulation_parameters": source["params"],
        "processing": processing,
        "frames": list(frames),
        "shape_dhw": [depth, height, width],
        "domain_size_m_xyz": source["domain_size_m_xyz_yup"],
        "cell_size_m": source["domain_size_m_xyz_yup"][1] / height,
        "frames_per_second": source["params"]["fps"],
        **CONVENTIONS,
    }
    (folder / "meta.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")


def make_suzanne(source: Path, folder: Path) -> None:
    """Copy one frame of the monkey head released as smoke, unchanged in value."""
    folder.mkdir(parents=True, exist_ok=True)
    for frame in SUZANNE_FRAMES:
        density, velocity = read_frame(source / f"frame_{frame:04d}.npz")
        np.savez_compressed(folder / f"frame_{frame:04d}.npz", density=density, velocity=velocity)
    meta = json.loads((source / "meta.json").read_text(encoding="utf-8"))
    write_meta(folder, meta, SUZANNE_FRAMES, density.shape, "none: the frame as simulated")


def make_smokejet(source: Path, folder: Path) -> None:
    """Average nine consecutive frames of the jet down to 3/4 of the cells per axis."""
    folder.mkdir(parents=True, exist_ok=True)
    for frame in SMOKEJET_FRAMES:
        density, velocity = smokejet_frame(*read_frame(source / f"frame_{frame:04d}.npz"))
        np.savez_compressed(folder / f"frame_{frame:04d}.npz", density=density, velocity=velocity)
    meta = json.loads((source / "meta.json").read_text(encoding="utf-8"))
    processing = (
        "64 x 96 x 64 cells averaged exactly over each of 48 x 72 x 48 cells, velocity times 0.75; "
        f"density rounded to multiples of {DENSITY_STEP:g}, velocity to {VELOCITY_STEP:g}"
    )
    write_meta(folder, meta, SMOKEJET_FRAMES, density.shape, processing)


def make_obstacle(source: Path, folder: Path) -> None:
    """Round one frame of the jet that meets a sphere."""
    name = f"frame_{OBSTACLE_FRAME:04d}.npz"
    with np.load(source / name, allow_pickle=False) as arrays:
        density, velocity, obstacle = (arrays[key] for key in ("density", "velocity", "obstacle"))
    velocity = OBSTACLE_VELOCITY_STEP * np.round(np.float32(velocity) / OBSTACLE_VELOCITY_STEP)
    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / name, density=np.float16(density), velocity=np.float16(velocity), obstacle=obstacle)
    meta = json.loads((source / "meta.json").read_text(encoding="utf-8"))
    meta |= {
        "licence": "MIT; simulated for this project",
        "processing": "density less than 1e-6 set to 0, and rounded to float16; "
        f"velocity rounded to multiples of {OBSTACLE_VELOCITY_STEP:g}",
        "frames": [OBSTACLE_FRAME],
    }
    (folder / "meta.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")


def make_fine_jet(source: Path, folder: Path) -> None:
    """Render the front view of a finer jet, white where it is brightest: the style of turbulence transfer."""
    density = read_frame(source / f"frame_{FINE_FRAME:04d}.npz")[0]
    image = render(np.float32(density), gamma=FINE_GAMMA_CELLS / density.shape[2])
    write_png(folder / "fine_jet.png", image / image.max())


#: By the folder of a simulation, what makes something of it, and the folder of scenes/ that this goes to.
MAKERS = {
    "suzanne": (make_suzanne, "suzanne"),
    "smokejet": (make_smokejet, "smokejet"),
    "obstacle": (make_obstacle, "obstacle"),
    "smokejet_hires": (make_fine_jet, "paper"),
}


def main() -> None:
    """Make the scenes that are in the folder given on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path, help="folder with some of the simulations above")
    parser.add_argument("folder", nargs="?", type=Path, default=CHECKOUT, help="default: the checkout")
    arguments = parser.parse_args()
    found = [name for name in MAKERS if (arguments.source / name).is_dir()]
    if not found:
        raise SystemExit(f"{arguments.source}: has none of the folders {', '.join(MAKERS)}")
    for name in found:
        make, scene = MAKERS[name]
        make(arguments.source / name, arguments.folder / "scenes" / scene)


if __name__ == "__main__":
    main()

"""Simulate smoke with Blender's Mantaflow, straight to a folder of frames that every command reads.

    python scripts/simulate.py smokejet|suzanne|obstacle --resolution 96 --frames 60 [--out FOLDER]
    python scripts/simulate.py mesh --mesh bunny.obj --resolution 96 --frames 24 [--out FOLDER]
    python scripts/simulate.py fire --resolution 40 --frames 10 [--out FOLDER]

The domain is 3 m high and 2 m wide and deep; --resolution is its height in cells (300 for the size of the paper's
scenes). smokejet is a jet, obstacle the same jet with a solid sphere in its way, suzanne and mesh are shapes filled
with smoke that rises. With --resolution 96 they are the simulations that scenes/ is made of. fire is a burning ring in
a domain as an artist sets it up: adaptive, with noise, its object turned.

Needs the program Blender (`apt-get install blender`; 3.4.1 is what this was tried with; the `bpy` wheel cannot bake).
The frames are FOLDER/frame_0001.npz and so on: `density` (float32), `velocity` (float16, cells per frame) and, where
something solid is in the scene, `obstacle`; meta.json tells what they are. A run that was interrupted or killed is
continued by the same command: the solver's state is in FOLDER/.work until the last frame is there. fire is for trying
what reads Blender's own files: FOLDER/cache is the OpenVDB cache that Blender wrote; interrupted, it begins anew.

Exit codes: 0 done, 1 Blender failed, 2 bad input, 3 interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from tqdm import tqdm

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import remove_unfinished, written_whole
from tnst_mi.io.grids.npz import write_arrays
from tnst_mi.io.grids.uni import read_uni
from tnst_mi.io.interpretation.orientation import from_z_up
from tnst_mi.io.interpretation.staggered import centred_velocity

BAKE = Path(__file__).with_name("blender_bake.py")
SCENES = ("smokejet", "suzanne", "obstacle", "mesh", "fire")
#: Scenes whose result is Blender's own cache.
KEPT_AS_CACHES = ("fire",)
RESOLUTIONS = (24, 2048)
LAST_FRAME = 9999

#: Mantaflow's time units per frame of Blender, at 25 frames per second.
TIME_UNITS_PER_FRAME = 0.1
#: Less density than this is none: what Blender leaves out of its VDB files.
LEAST_DENSITY = 1e-6
#: Velocities are rounded to multiples of this, the spacing of float16 between 2 and 4, which makes for small files.
VELOCITY_STEP = 2.0**-9
#: What the numbers of our frames mean, for meta.json.
CONVENTIONS = {
    "axis_order": "density[z, y, x], velocity[z, y, x, component], components (x, y, z); y up, "
    "right-handed; values at cell centres",
    "units": "density: 1 at the source; velocity: cells of this grid per frame, positive towards +axis",
    "time_relation": "the velocity of frame t carries the density of frame t to frame t + 1",
}


class BlenderError(RuntimeError):
    """Blender ended before the last frame was there."""


@dataclass(frozen=True)
class Simulation:
    """What to simulate, and where to.

    Attributes:
        scene: one of SCENES.
        resolution: height of the domain in cells.
        frames: number of frames, the first being 1.
        out: the folder.
        mesh: Wavefront OBJ file, for the scene mesh.
        blender: the program.
    """

    scene: str
    resolution: int
    frames: int
    out: Path
    mesh: Path | None
    blender: str

    @property
    def work(self) -> Path:
        """Folder of what is needed until the simulation is complete."""
        return self.out / ".work"

    @property
    def cache(self) -> Path:
        """Folder of Blender's cache."""
        return self.work / "cache"

    @property
    def log(self) -> Path:
        """What Blender says."""
        return self.work / "blender.log"

    @property
    def kept_cache(self) -> Path:
        """Where the cache goes that is the result."""
        return self.out / "cache"

    @property
    def keeps_cache(self) -> bool:
        """Whether the result is Blender's cache, not frames."""
        return self.scene in KEPT_AS_CACHES

    def file(self, frame: int) -> Path:
        """Where a frame goes."""
        return self.out / f"frame_{frame:04d}.npz"

    def settings(self) -> dict[str, Any]:
        """What must be the same for a simulation to be gone on with."""
        mesh = self.mesh and hashlib.sha256(self.mesh.read_bytes()).hexdigest()
        return {"scene": self.scene, "resolution": self.resolution, "mesh": mesh}

    def check(self) -> None:
        """Refuse what cannot be simulated.

        Raises:
            InputError: a number is out of range, the mesh is missing or not wanted, or Blender is not there.
        """
        low, high = RESOLUTIONS
        if not low <= self.resolution <= high:
            raise InputError(f"--resolution {self.resolution}: expected {low} to {high} cells along the height")
        if not 1 <= self.frames <= LAST_FRAME:
            raise InputError(f"--frames {self.frames}: expected 1 to {LAST_FRAME}")
        if (self.mesh is not None) != (self.scene == "mesh"):
            raise InputError(f"{self.scene}: the scene mesh needs --mesh FILE.obj, and no other takes it")
        if self.mesh is not None and (self.mesh.suffix.lower() != ".obj" or not self.mesh.is_file()):
            raise InputError(f"--mesh {self.mesh}: expected a Wavefront OBJ file (.obj)")
        if shutil.which(self.blender) is None:
            raise InputError(
                f"--blender {self.blender}: no such program; install Blender (apt-get install blender) or say where it "
                "is (the Python package bpy cannot bake)"
            )

    def begin(self) -> int:
        """Prepare the folder and return the first frame to simulate.

        Raises:
            InputError: the folder holds another simulation, or frames of which nobody knows whose they are.
        """
        if self.kept_cache.exists():
            raise InputError(f"{self.out}: has a cache already; remove the folder, or give another one as --out")
        record = self.work / "settings.json"
        if not record.exists():
            # Frames come after the record, so these are complete, or not ours.
            if any(self.out.glob("*.npz")):
                raise InputError(f"{self.out}: has frames already; remove the folder, or give another one as --out")
            self.work.mkdir(parents=True, exist_ok=True)
            with written_whole(record) as temporary:
                temporary.write_text(json.dumps(self.settings()), encoding="utf-8")
            return 1
        with contextlib.suppress(ValueError):
            if json.loads(record.read_text(encoding="utf-8")) == self.settings():
                remove_unfinished(self.out)
                frame = next(frame for frame in range(1, LAST_FRAME + 2) if not self.file(frame).exists())
                # The state that the next frame starts from is that of the frame before.
                if cached(self.cache, frame - 1):
                    return frame
                # Blender would take what it finds for its own.
                shutil.rmtree(self.cache, ignore_errors=True)
                return 1
        raise InputError(f"{self.out}: holds another simulation; remove the folder, or give another one as --out")

    def leave_nothing(self) -> None:
        """Remove what `begin` made."""
        shutil.rmtree(self.work)
        with contextlib.suppress(OSError):
            self.out.rmdir()


def cached(cache: Path, frame: int) -> list[Path]:
    """Blender's files of one frame."""
    return [*cache.glob(f"data/*_{frame:04d}.uni"), *cache.glob(f"config/*_{frame:04d}.uni")]


def read_cached_frame(cache: Path, frame: int) -> tuple[dict[str, np.ndarray], str]:
    """Read one frame from Blender's cache: the arrays of our files, and what the solver says of its build.

    Returns:
        `density` (D, H, W) float32; `velocity` (D, H, W, 3) float16 in cells per frame at cell centres; and `obstacle`
        (D, H, W) bool if the scene has solids. y up.

    Raises:
        InputError: a file is missing or damaged.
    """

    def file(grid: str) -> Path:
        return cache / "data" / f"{grid}_{frame:04d}.uni"

    header, density = read_uni(file("density"))
    velocity = centred_velocity(read_uni(file("vel"))[1]) * np.float32(TIME_UNITS_PER_FRAME)
    arrays = {
        "density": from_z_up(np.where(density < LEAST_DENSITY, np.float32(0.0), density)),
        "velocity": np.float16(VELOCITY_STEP * np.round(from_z_up(velocity) / VELOCITY_STEP)),
    }
    # The signed distance from the solids of the scene; the flags of the cells would count the closed floor too.
    if file("phiObsIn").exists():
        arrays["obstacle"] = from_z_up(read_uni(file("phiObsIn"))[1] < 0.0)
    return arrays, header.build


def origin_of(simulation: Simulation, facts: dict[str, Any]) -> dict[str, Any]:
    """Where a simulation comes from, for meta.json."""
    return {
        "name": simulation.mesh.stem if simulation.mesh else simulation.scene,
        "solver": "Mantaflow (Blender bundled), baked by the Blender fluid modifier",
        "blender_version": facts["blender_version"],
        "source": f"{simulation.mesh.name}: {facts['source']}" if simulation.mesh else facts["source"],
        "simulation_parameters": facts["simulation_parameters"],
        "frames_per_second": facts["frames_per_second"],
    }


def write_meta(simulation: Simulation, meta: dict[str, Any]) -> None:
    """Write where the result comes from and what it is."""
    with written_whole(simulation.out / "meta.json") as temporary:
        temporary.write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")


def keep_frame(simulation: Simulation, facts: dict[str, Any], frame: int) -> None:
    """Write a frame that Blender has in its cache, and let go of the one before it there."""
    arrays, build = read_cached_frame(simulation.cache, frame)
    write_arrays(simulation.file(frame), arrays)
    depth, height, width = arrays["density"].shape
    cell = facts["domain_height_m"] / height
    what = {
        "solver_build": build,
        "processing": f"density less than {LEAST_DENSITY:g} set to 0; velocity rounded to multiples of "
        f"{VELOCITY_STEP:g}, and float16",
        "frames": list(range(1, frame + 1)),
        "shape_dhw": [depth, height, width],
        "domain_size_m_xyz": [round(extent * cell, 6) for extent in (width, height, depth)],
        "cell_size_m": cell,
        **CONVENTIONS,
    }
    write_meta(simulation, origin_of(simulation, facts) | what)
    for file in cached(simulation.cache, frame - 1):
        file.unlink()


def keep_cache(simulation: Simulation, facts: dict[str, Any]) -> None:
    """Make the cache of a complete simulation the result."""
    what = {
        "frames": list(range(1, simulation.frames + 1)),
        "domain": facts["domain"],
        "axis_order": "Z up in the cache and the domain's centre, y up in the gravity",
    }
    write_meta(simulation, origin_of(simulation, facts) | what)
    simulation.cache.rename(simulation.kept_cache)


@contextlib.contextmanager
def baking(simulation: Simulation, begin: int) -> Iterator[Iterator[tuple[str, str]]]:
    """Run Blender from a frame on and give what `blender_bake.py` tells, kind and rest; Blender ends with the block."""
    program = Path(shutil.which(simulation.blender) or simulation.blender).absolute()
    command = [str(program), "--background", "--factory-startup", "--python-exit-code", "1"]
    command += ["--python", str(BAKE), "--", simulation.scene, str(simulation.cache.resolve())]
    command += ["--resolution", str(simulation.resolution), "--frames", str(simulation.frames), "--begin", str(begin)]
    command += ["--mesh", str(simulation.mesh.resolve())] if simulation.mesh else []
    command += ["--format", "OPENVDB" if simulation.keeps_cache else "UNI"]

    def told(lines: Iterable[str]) -> Iterator[tuple[str, str]]:
        with simulation.log.open("a", encoding="utf-8") as log:
            for line in lines:
                log.write(line)
                if line.startswith("bake: "):
                    kind, _, rest = line.removeprefix("bake: ").rstrip().partition(" ")
                    yield kind, rest

    # In a session of its own, Blender is not reached by a Ctrl-C that is meant for us.
    process = subprocess.Popen(
        command,
        # Mantaflow leaves its noise in the folder that it runs in.
        cwd=simulation.work,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    try:
        yield told(process.stdout)
    finally:
        # A half-written cache file does no harm: the frame it belongs to is baked again.
        process.kill()
        process.wait()
        process.stdout.close()


def simulate(simulation: Simulation) -> None:
    """Simulate, with a progress bar on stderr.

    Raises:
        InputError: as `Simulation.check` and `Simulation.begin`; or the mesh cannot be used.
        BlenderError: Blender failed.
    """
    simulation.check()
    frame = simulation.begin() - 1
    if frame < simulation.frames:
        bar = tqdm(total=simulation.frames, initial=frame, unit="frame", desc=simulation.scene, dynamic_ncols=True)
        with bar, baking(simulation, frame + 1) as told:
            for kind, rest in told:
                if kind == "scene":
                    facts = json.loads(rest)
                elif kind == "frame" and int(rest) == frame + 1:
                    frame += 1
                    if not simulation.keeps_cache:
                        keep_frame(simulation, facts, frame)
                    bar.update()
                elif kind == "refused":
                    simulation.leave_nothing()
                    raise InputError(f"{simulation.mesh or simulation.scene}: {rest}")
    if frame < simulation.frames:
        said = f"{simulation.log} holds what it said"
        raise BlenderError(f"Blender ended after frame {frame} of {simulation.frames}; {said}")
    if simulation.keeps_cache:
        keep_cache(simulation, facts)
    shutil.rmtree(simulation.work)


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, like all of ours."""

    def error(self, message: str) -> NoReturn:
        """Raise what argparse would print below its usage."""
        raise InputError(f"{message} (--help explains)")


def parsed(arguments: list[str] | None) -> Simulation:
    """Read the command line.

    Raises:
        InputError: there is no such scene or option, or a number is none.
    """
    parser = Parser(prog="simulate.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=SCENES)
    parser.add_argument("--resolution", type=int, default=96, help="cells along the height (default: 96)")
    parser.add_argument("--frames", type=int, default=60, help="how many, the first being 1 (default: 60)")
    parser.add_argument("--mesh", type=Path, help="Wavefront OBJ file, y up, for the scene mesh")
    parser.add_argument("--out", type=Path, help="folder for the frames (default: SCENE_RESOLUTION)")
    parser.add_argument("--blender", default="blender", help="the program (default: the one on the path)")
    given = parser.parse_args(arguments)
    out = given.out or Path(f"{given.mesh.stem if given.mesh else given.scene}_{given.resolution}")
    return Simulation(given.scene, given.resolution, given.frames, out, given.mesh, given.blender)


def main(arguments: list[str] | None = None) -> int:
    """Simulate what the command line asks for, and return the exit code."""
    try:
        simulation = parsed(arguments)
        simulate(simulation)
    except InputError as error:
        print(f"simulate.py: {error}", file=sys.stderr)
        return 2
    except (BlenderError, OSError) as error:
        print(f"simulate.py: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("simulate.py: interrupted; the same command goes on", file=sys.stderr)
        return 3
    print(f"{simulation.out}: {simulation.frames} frames")
    return 0


if __name__ == "__main__":
    sys.exit(main())

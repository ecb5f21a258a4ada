"""Where figures get their smoke, how large they are, and the stylizations that they show, each made once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.resampling import resample_potential
from tnst_mi.frame import Frame
from tnst_mi.io.sequence import load_frames
from tnst_mi.recipe.paths import STYLES
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.folder import holds_run
from tnst_mi.run.job import Run as RunningJob
from tnst_mi.run.prepare import prepare
from tnst_mi.run.stored_arrays import StoredArrays

_HERE = Path(__file__).resolve().parents[2]

#: Folders with smoke, pictures and recipes: those bundled, and those that may lie beside the checkout.
SCENES, ASSETS = _HERE / "scenes", _HERE.parent / "shared"


#: What figures do as the paper does, unless they say otherwise.
_AS_THE_PAPER = {"lam": 1.0, "transport": "step", "motif_size": "cells"}

#: Cells left around the smoke of a close-up, which stylization may move out a little.
_ROOM = 6


@dataclass(frozen=True)
class Run:
    """A stylization that is done: what went in, what came out, and its run.json."""

    frames: Sequence[Frame]
    densities: Sequence[np.ndarray]
    velocities: Sequence[np.ndarray]
    record: dict[str, Any]
    out: Path

    @cached_property
    def density(self) -> np.ndarray:
        """The stylized density of the first frame, (D, H, W)."""
        return self.densities[0]

    @cached_property
    def velocity(self) -> np.ndarray:
        """The velocity of the first frame, (D, H, W, 3) in cells per frame."""
        return self.velocities[0]

    @cached_property
    def recipe(self) -> Recipe:
        """The recipe as run."""
        return Recipe.from_toml(self.out / "recipe.toml")

    @property
    def exposure(self) -> float:
        """The factor from rendered images to [0, 1] that the run had."""
        return self.record["exposure"]


@dataclass(frozen=True)
class Setting:
    """What all figures of one call share.

    Attributes:
        size: "small" (grids of 64×96×64 that come with the package or beside it) or "paper" (200×300×200, from `data`).
        out: where pictures, numbers and, in `runs`, stylizations go.
        data: folder with simulations of one's own (`scripts/simulate.py`), one folder each; None for those at hand.
        weights: as a recipe's `weights`; None searches for them.
        earlier: seconds that went into each stylization before this call, by its name; 0 for those made now.
    """

    size: str
    out: Path
    data: Path | None = None
    weights: str | None = None
    earlier: dict[str, float] = field(default_factory=dict)

    def smoke(self, name: str, first: int, last: int | None = None) -> list[Frame]:
        """The frames of a simulation from number `first` to `last`, both included; one where `last` is None.

        Raises:
            InputError: there is no such simulation, or it lacks a frame.
        """
        numbers = range(first, (first if last is None else last) + 1)
        folders = [self.data / name] if self.data is not None else [SCENES / name, ASSETS / "data" / name]
        for folder in folders:
            files = [folder / f"frame_{number:04d}.npz" for number in numbers]
            if all(file.exists() for file in files):
                return [load_frames(file)[0] for file in files]
        wanted = f"frame {first} is" if len(numbers) == 1 else f"frames {first} to {last} are"
        raise InputError(
            f"{name}: {wanted} in none of {', '.join(map(str, folders))}; "
            f"make them with scripts/simulate.py {name}, and name its folder with --data"
        )

    def close_up(self, frame: Frame, finer: float = 1.5) -> Frame:
        """The smoke of a frame cut out of its grid and resampled on finer cells, without its velocity.

        Small grids have much room and few cells for the smoke; it then fills them. At paper size the frame as it is.
        """
        if self.size == "paper":
            return frame
        box = []
        for axis in range(3):
            cells = np.flatnonzero(frame.density.sum(axis=tuple({0, 1, 2} - {axis})) > 1.0)
            box.append(slice(max(int(cells[0]) - _ROOM, 0), int(cells[-1]) + 1 + _ROOM))
        part = frame.density[tuple(box)]
        shape = tuple(int(finer * size) for size in part.shape)
        density = np.maximum(resample_potential(part, 1.0, shape, 1 / finer), 0)
        return Frame(density, name=frame.name, number=frame.number)

    def style(self, name: str) -> str | None:
        """A picture by its name: one that ships with the package, or one beside the checkout; None if neither is."""
        if (STYLES / f"{name}.png").exists():
            return name
        found = [*(ASSETS / "styles").glob(f"{name}.*")]
        return str(found[0]) if found else None

    def stylized(self, name: str, frames: Frame | Sequence[Frame], recipe: Recipe | None = None, **keys: Any) -> Run:
        """The stylization of frames by a recipe and some of its keys: made, resumed, or found as it was left.

        Args:
            name: of its folder below `out/runs`.
            frames: one frame or a sequence.
            recipe: the recipe; None for the defaults, but with the paper's transport and images.
            keys: keys of the recipe that are replaced.
        """
        frames = [frames] if isinstance(frames, Frame) else list(frames)
        here = Path.cwd()
        recipe = recipe or Recipe.from_dict(_AS_THE_PAPER)
        recipe = recipe.updated({"weights": self.weights, **keys}, f"{name}: ", here)
        out = self.out / "runs" / name
        try:
            job = RunningJob(prepare(frames, recipe, out, resume=holds_run(out)))
        except InputError:
            if not holds_run(out):
                raise
            # What is there is of other frames, another recipe or other weights.
            job = RunningJob(prepare(frames, recipe, out, overwrite=True))
        self.earlier.setdefault(name, job.record.get("seconds", 0.0))
        for _ in job:
            pass
        if job.record["status"] != "done":
            raise KeyboardInterrupt
        names = [record["name"] for record in job.record["frames"]]
        arrays = (StoredArrays(out, kind, names) for kind in ("density", "velocity"))
        return Run(job.prepared.frames_named(names), *arrays, job.record, out)

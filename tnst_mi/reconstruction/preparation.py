"""Everything that a reconstruction needs to know before it begins: settings, grid, views, frames and velocities."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError, naming
from tnst_mi.fields.grid import Octave, octaves
from tnst_mi.io.sequence import FrameFiles, open_frames
from tnst_mi.recipe.paths import located, shipped_lights
from tnst_mi.reconstruction.camera_sets.posed_view import (
    CameraSet,
    PosedView,
    file_of_any_frame,
    file_of_frame,
    require_files,
)
from tnst_mi.reconstruction.camera_sets.reading import read_camera_set
from tnst_mi.reconstruction.checks.exposure import require_brightness
from tnst_mi.reconstruction.checks.needed_memory import require_memory_for_cells, require_memory_for_pictures
from tnst_mi.reconstruction.checks.plausible_pictures import require_plausible
from tnst_mi.reconstruction.checks.usable_views import (
    remarks_of_views,
    require_backgrounds_of_use,
    require_box_in_sight,
)
from tnst_mi.reconstruction.photographs import Photograph, read_values, read_weights, require_size, strength
from tnst_mi.reconstruction.resuming.light_files import light_files
from tnst_mi.reconstruction.settings import ReconstructionSettings
from tnst_mi.reconstruction.volume import GridPlace, grid_in_box
from tnst_mi.rendering.cameras.shots import camera_in_cells
from tnst_mi.resources import expanded

#: What --velocities can be besides a folder: each is estimated, or each frame starts from the one before as it is.
ESTIMATE, NONE = "estimate", "none"

#: Where nothing says which views are held out, those of these numbers are, as usual for view synthesis since LLFF
#: (Mildenhall et al. 2019); of fewer views, none.
_EVERY = 8

#: By how much pixels may be wider than high or the other way round: pictures that were made smaller to whole pixels.
_UNEVEN = 0.01

#: What is said where colours are found.
_COLOUR_SAID = (
    "colour: smoke of a colour is taken to be as bright in its strongest channel as white smoke (--channel luminance "
    "finds the density alone)"
)


@dataclass(frozen=True)
class Preparation:
    """What is known before the first step.

    Attributes:
        settings: with those of the file of cameras.
        cameras: the file of cameras.
        views: of it, with what is held out.
        place: the full grid.
        levels: from the coarsest grid to the full one.
        frames: their numbers; a single None where pictures have none.
        velocities: of the simulation, frame by frame; None where they are not known.
        estimates: whether those that are not known are estimated, from each frame to the next.
        format: of the densities that are written, such as "npz".
        remarks: what was assumed, to be said.
    """

    settings: ReconstructionSettings
    cameras: CameraSet
    views: Sequence[PosedView]
    place: GridPlace
    levels: Sequence[Octave]
    frames: Sequence[int | None]
    velocities: FrameFiles | None
    estimates: bool
    format: str
    remarks: tuple[str, ...]

    @property
    def identity(self) -> str:
        """Tells reconstructions apart: a hash of the settings, of where cameras stand, and of what files there are."""
        cameras = [(view.name, *_files(view), view.layer, view.held_out, _numbers(view)) for view in self.views]
        known = self.estimates if self.velocities is None else str(self.velocities.source.absolute())
        told = [asdict(self.settings), cameras, self.place.shape, list(self.frames), known, self.format]
        return hashlib.sha256(json.dumps(told, default=str).encode("utf-8")).hexdigest()

    def require_pictures(self) -> None:
        """Check that the pictures, masks and backgrounds of all frames are there, before hours go into the first.

        Raises:
            InputError: some are not, or the name of a picture has no place for the number of the frame.
        """
        require_files(self.views, self.frames)

    def sources(self, index: int) -> list[Path]:
        """The files that a frame is made from, by its place among the frames; those of its cameras are known already.

        Raises:
            InputError: the name of a picture has no place for the number of the frame.
        """
        number = self.frames[index]
        found = [file for view in self.views for file in view.files(number)]
        before = self.frames[index - 1] if index else None
        if self.velocities is not None and before in self.velocities.numbers:
            found += self.velocities.sources(self.velocities.numbers.index(before))
        if self.settings.integrator == "prbvolpath" and self.settings.light not in shipped_lights():
            found += light_files(Path(self.settings.light))
        # Of a frame's velocity, some files need not exist; a picture that is missing is told of by whoever reads it.
        return [file for file in dict.fromkeys(found) if file.is_file()]

    def photographs(self, number: int | None) -> list[Photograph]:
        """The pictures of a frame.

        Raises:
            InputError: one cannot be used, or has values that no smoke has; or none that is used shows anything.
        """
        found = [self._photograph(view, number) for view in self.views]
        used = [photograph for photograph in found if not photograph.held_out]
        of_frame = "" if number is None else f" of frame {number}"
        if not any((photograph.weights > 0).any() for photograph in used):
            raise InputError(f"{self.cameras.file}: masks leave nothing of any picture{of_frame} that is not held out")
        if not any((photograph.values[photograph.weights > 0] > 0).any() for photograph in used):
            first = next(file_of_frame(view.image, number) for view in self.views if not view.held_out)
            remedy = "" if number is None else f"; give --frames without {number}"
            raise InputError(
                f"{first}: it and all other pictures{of_frame} are black, expected smoke that is brighter than what is "
                f"behind it{remedy}"
            )
        with naming(self.cameras.file):
            require_box_in_sight(found, self.place.shape)
        require_plausible([file_of_frame(view.image, number) for view in self.views], found, self.settings)
        return found

    def velocity(self, number: int | None) -> np.ndarray | None:
        """The velocity (D, H, W, 3) of a frame, in cells per frame; None if none is known of it.

        Raises:
            InputError: it is of another grid.
        """
        if self.velocities is None or number not in self.velocities.numbers:
            return None
        frame = self.velocities[self.velocities.numbers.index(number)]
        if frame.velocity is not None and frame.density.shape != self.place.shape:
            raise InputError(
                f"{frame.name}: its velocity is on a grid of {_cells(frame.density.shape)} cells (D × H × W), expected "
                f"{_cells(self.place.shape)}, those of the reconstruction (box and cells)"
            )
        return frame.velocity

    @property
    def _numbers_of_pixel(self) -> int:
        """Of a picture, and of what is behind the smoke: its value, and in colour three more."""
        pictures = 1 + any(view.background is not None for view in self.views)
        return pictures * (4 if self.settings.channel == "rgb" else 1)

    def _photograph(self, view: PosedView, number: int | None) -> Photograph:
        s, file = self.settings, file_of_frame(view.image, number)
        image = read_values(file, s.channel, s.transfer, view.layer_in(file))
        rows, columns = image.shape[:2]
        if view is self.views[0]:
            require_memory_for_pictures(len(self.views), (rows, columns), self._numbers_of_pixel)
        weights = np.ones((rows, columns), np.float32)
        if view.mask is not None:
            weights = read_weights(file_of_any_frame(view.mask, number), weights.shape, view.layer_in(view.mask))
        values, colours = _split(image, weights)
        background, behind = None, None
        if view.background is not None:
            empty = file_of_any_frame(view.background, number)
            seen = read_values(empty, s.channel, s.transfer, view.layer_in(empty))
            require_size(empty, seen[..., 0] if seen.ndim == 3 else seen, weights.shape)
            background, behind = _split(seen, weights)
        with naming(Path(f"{self.cameras.file}: view {view.name}")):
            stands = view.camera((columns, rows)).turned(self.cameras.up, self.place.placement.up)
            camera = camera_in_cells(stands, self.place.placement, self.place.shape)
            if abs(camera.aspect * rows / columns - 1) > max(0.5 / min(rows, columns), _UNEVEN):
                raise InputError(
                    f"its camera has an aspect of {camera.aspect:.4g}, and {file.name} {columns} × {rows} pixels; "
                    "expected the same proportions"
                )
        return Photograph(view.name, camera, values, weights, background, view.held_out, colours, behind)


def prepare(
    cameras: Path,
    given: Mapping[str, Any] | ReconstructionSettings,
    frames: str | None,
    velocities: str | Path | None,
    format: str = "npz",
) -> Preparation:
    """Read the file of cameras and check all that can be checked before pictures are read.

    Args:
        cameras: the file.
        given: settings that win over those of the file; or all of them.
        frames: "FIRST:LAST", the numbers of the frames; None for pictures without numbers.
        velocities: a folder of frames with velocities, ESTIMATE, or NONE, which None is too.
        format: of the densities that will be written.

    Raises:
        InputError: something cannot be used.
    """
    found = read_camera_set(cameras)
    if isinstance(given, ReconstructionSettings):
        settings = given
    else:
        settings = ReconstructionSettings().updated(found.settings, f"{cameras}: reconstruction: ").updated(given)
    settings.require_consistent()
    if settings.integrator == "prbvolpath":
        settings = replace(settings, light=located("light", settings.light, "", Path.cwd()))
    if settings.box is None:
        raise InputError(
            f"{cameras}: does not say where the smoke is; give the box around it in the cameras' scene, as "
            "--box X0,Y0,Z0,X1,Y1,Z1 or as box under [reconstruction]"
        )
    require_backgrounds_of_use(found, settings)
    views, said = _held_out(found.views, settings.hold_out)
    place = grid_in_box(settings.box, settings.cells, found.up)
    require_memory_for_cells(math.prod(place.shape))
    said += remarks_of_views(found, views, place)
    numbers = _numbers_of(frames)
    known = None if velocities is None or velocities in (ESTIMATE, NONE) else open_frames(expanded(Path(velocities)))
    if known is not None and numbers == [None]:
        raise InputError(f"--velocities {velocities}: is of sequences; give --frames FIRST:LAST")
    said_of_velocities = _said_of_velocities(numbers, known, velocities)
    require_brightness(file_of_frame(views[0].image, numbers[0]), settings)
    return Preparation(
        settings,
        found,
        views,
        place,
        octaves(place.shape, _levels(settings.levels, place.shape), 2.0),
        numbers,
        known,
        velocities == ESTIMATE,
        format,
        (*found.remarks, *said, *((_COLOUR_SAID,) if settings.channel == "rgb" else ()), *said_of_velocities),
    )


def _held_out(views: Sequence[PosedView], hold_out: int | str) -> tuple[list[PosedView], list[str]]:
    """The views with what is held out, and what is to be said of that."""
    said = []
    if hold_out == "auto" and any(view.held_out for view in views):
        chosen = [view.held_out for view in views]
    else:
        every = int(hold_out) if hold_out != "auto" else _EVERY if len(views) >= _EVERY else 0
        chosen = [bool(every) and number % every == 0 for number in range(len(views))]
        if hold_out == "auto":
            what = f"every {_EVERY}th is held out" if every else "none is held out, so that none judges the result"
            said.append(f"views: {what} (--hold-out N holds out every Nth, 0 none)")
    if all(chosen):
        raise InputError(f"--hold-out {hold_out}: leaves none of {len(views)} views to use; hold out fewer")
    return [replace(view, held_out=out) for view, out in zip(views, chosen, strict=True)], said


def _said_of_velocities(
    numbers: Sequence[int | None], known: FrameFiles | None, velocities: str | Path | None
) -> list[str]:
    """What is to be said of the velocities of a sequence."""
    if known is not None:
        lacking = [str(number) for number in numbers[:-1] if number not in known.numbers]
        if lacking:
            return [f"{velocities}: has no frame {', '.join(lacking)}, so the one after starts from it as it is"]
    elif velocities == ESTIMATE and len(numbers) > 1:
        return [
            "velocities: none are given, so each is estimated from two frames (--velocities FOLDER gives those of a "
            "simulation, --velocities none starts each frame from the one before as it is)"
        ]
    return []


def _levels(wanted: int, shape: Sequence[int]) -> int:
    """As many grids as there can be with four cells or more along the longest edge of the coarsest."""
    return max(1, min(wanted, int(np.log2(max(shape) / 4)) + 1))


def _numbers_of(frames: str | None) -> list[int | None]:
    if frames is None:
        return [None]
    first, colon, last = frames.partition(":")
    try:
        span = range(int(first), int(last if colon else first) + 1)
    except ValueError:
        span = range(0)
    if not 0 < len(span) <= 100_000:
        raise InputError(f"--frames {frames}: expected FIRST:LAST, such as 49:72")
    return list(span)


def _cells(shape: Sequence[int]) -> str:
    return " × ".join(map(str, shape))


def _split(image: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """What is taken for the light of white smoke, and the colours of a picture that has some."""
    return (image, None) if image.ndim == 2 else (strength(image, weights), image)


def _files(view: PosedView) -> list[str | None]:
    return [None if file is None else str(file.absolute()) for file in (view.image, view.mask, view.background)]


def _numbers(view: PosedView) -> list[Any]:
    camera = view.camera((1, 1))
    return [camera.to_scene.round(9).tolist(), camera.perspective, camera.field, camera.aspect, camera.shift]

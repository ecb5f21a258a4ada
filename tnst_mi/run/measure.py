"""Measurements of the frames of a run before they are stylized: their identity, and their density."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import ReferenceDensity
from tnst_mi.frame import Frame
from tnst_mi.geometry.placement import Placement
from tnst_mi.io.cameras.reading import file_and_name
from tnst_mi.io.files.frame_numbers import first_gap
from tnst_mi.io.sequence import checked_shapes
from tnst_mi.network.download import file_hash
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.targets import Target, mask_files, targets_of
from tnst_mi.rendering.cameras.shots import ShotView
from tnst_mi.rendering.fire import is_temperature
from tnst_mi.rendering.smoke_colour import are_colours
from tnst_mi.run.carry import movable, read_chosen
from tnst_mi.run.folder import DAMAGE, ELSEWHERE, is_file_name
from tnst_mi.run.inputs import frame_digest, grid_digest


@dataclass(frozen=True)
class Measure:
    """Measurements of a frame before it is stylized.

    Attributes:
        name: of the frame.
        number: of the frame.
        mass: the sum of its density.
        densest: the largest value of its density.
        sha256: of its arrays, see `frame_digest`.
        moves: whether it has a velocity.
        movable: the names of all that can move with the smoke.
        others: the SHA-256 of its other grids that do, by name.
        placement: where it lies in its scene, without what results keep of its file.
        colours: the names of its other grids that can be colours.
        hottest: the largest value of each of its other grids that has temperatures, if it is above 0, by name.
    """

    name: str
    number: int | float | None
    mass: float
    densest: float
    sha256: str
    moves: bool
    movable: tuple[str, ...] = ()
    others: Mapping[str, str] = field(default_factory=dict)
    placement: Placement | None = None
    hottest: Mapping[str, float] = field(default_factory=dict)
    colours: tuple[str, ...] = ()

    @property
    def identity(self) -> str:
        """The SHA-256 of all that results are made of: the arrays, and the other grids that move with the smoke."""
        if not self.others:
            return self.sha256
        parts = [self.sha256, *(f"{name!r} {digest}" for name, digest in self.others.items())]
        return hashlib.sha256("\n".join(parts).encode("utf-8", "surrogateescape")).hexdigest()


def measured(frames: Iterable[Frame], carry: str = "none") -> tuple[list[Measure], ReferenceDensity]:
    """Read every frame once, so that bad ones are found before any work; also returns their reference density.

    Args:
        frames: the frames.
        carry: which of their other grids are read too, see `run.carry.chosen`.

    Raises:
        InputError: a frame cannot be read or differs in shape, or its name is a duplicate or cannot name files.
    """
    measures, reference = [], ReferenceDensity()
    for frame in checked_shapes(frames):
        reference.add(frame.density)
        densest, moves = float(frame.density.max()), frame.velocity is not None
        others, hottest, colours = {}, {}, []
        for name, values in read_chosen(frame, carry):
            others[name] = grid_digest(values)
            colours += [name] if are_colours(values) else []
            if values.ndim == 3 and is_temperature(name) and 0 < (largest := float(values.max())) < math.inf:
                hottest[name] = largest
        place = None if frame.placement is None else replace(frame.placement, own=None, source=None)
        names, digest = tuple(movable(frame)), frame_digest(frame)
        measures.append(
            Measure(
                frame.name,
                frame.number,
                frame.mass,
                densest,
                digest,
                moves,
                names,
                others,
                place,
                hottest,
                tuple(colours),
            )
        )
    counts = Counter(measure.name for measure in measures)
    for name in counts:
        if not is_file_name(name):
            raise InputError(f"frames: the name {name!r} cannot name files, expected one without / and \\")
        if counts[name] > 1:
            raise InputError(f"frames: the name {name!r} is there more than once, expected one name per frame")
    return measures, reference


def require_coherent(measures: Sequence[Measure], recipe: Recipe) -> None:
    """Check that a window of several frames is possible: velocities lead from each frame to the next.

    Raises:
        InputError: there is only one frame, one lacks its velocity, or their numbers are not equally far apart.
    """
    if recipe.window == 1:
        return
    needed = f"which window = {recipe.window} needs"
    if len(measures) == 1:
        raise InputError(f"{measures[0].name}: is a single frame, expected a sequence, {needed}; set window to 1")
    for measure in measures[:-1]:
        if not measure.moves:
            raise InputError(f"{measure.name}: has no velocity, {needed}; add it to the frames, or set window to 1")
    if gap := first_gap([measure.number for measure in measures]):
        number, following, expected = gap
        raise InputError(f"frames: {following} comes after {number}, expected {expected} there, {needed}")


def require_same_input(measures: Sequence[Measure], recipe: Recipe, run: dict[str, Any], out: Path) -> None:
    """Check that a run to be resumed had these frames: each of them, finished or not, affects the others.

    Raises:
        InputError: the frames, their order, or the files that the recipe names have changed.
    """
    now, remedy = digests(measures), "resume with the same input, or use --overwrite"
    for path, digest in file_digests(recipe).items():
        if run["files"].get(path) != digest:
            raise InputError(f"{out}: its run had another {path} than there is now; {remedy}")
    if set(run["inputs"]) != set(now):
        other = sorted(set(run["inputs"]) ^ set(now))[0]
        where = "its run" if other in run["inputs"] else "the input now"
        raise InputError(f"{out}: only {where} has a frame {other}; {remedy}")
    for name, digest in now.items():
        if run["inputs"][name] != digest:
            raise InputError(f"{out}: its run had another {name} than the input has now; {remedy}")
    if list(run["inputs"]) != list(now):
        raise InputError(f"{out}: its run had the frames in another order; {remedy}")


def require_same_masks(
    targets: Sequence[Target], records: Sequence[dict[str, Any]], run: dict[str, Any], out: Path
) -> None:
    """Check that a run to be resumed had these masks: what they are read from need not be part of its other digests.

    Args:
        targets: the targets; none of them has another recipe than in that run.
        records: the records of the targets that have regions, now, see `run.record.target_record`.
        run: the record of the run, with these frames.
        out: its folder.

    Raises:
        InputError: a mask has changed, or the record does not say what it was.
    """
    now = [record["mask_sha256"] for record in records]
    try:
        earlier = [dict(zip(run["inputs"], record["mask_sha256"], strict=True)) for record in run.get("targets", ())]
        if len(earlier) != len(now):
            raise ValueError(len(earlier))
    except DAMAGE:
        raise InputError(f"{out / 'run.json'}: does not say which masks its run had; {ELSEWHERE}") from None
    for target, digests_now, before in zip(targets, now, earlier, strict=False):
        for frame, digest in zip(before, digests_now, strict=True):
            if before[frame] != digest:
                whose = f" of target {target.number}" if target.number else ""
                raise InputError(
                    f"{out}: its run had another mask{whose} in {frame} than there is now; resume with the same masks, "
                    "or use --overwrite"
                )


def shot_record(measures: Sequence[Measure], shots: Sequence[ShotView]) -> dict[str, Any]:
    """What the record of a run says of its camera: by the name of each frame, the view of it; nothing without one."""
    views = {measure.name: list(shot.view) for measure, shot in zip(measures, shots, strict=True)} if shots else {}
    return {"shots": views} if views else {}


def require_same_shots(now: dict[str, Any], run: dict[str, Any], out: Path) -> None:
    """Check that the camera of a run to be resumed saw the smoke from the same places.

    The smoke may have been moved in its scene, which changes no digest of its arrays.

    Args:
        now: the record as it would be now, see `shot_record`.
        run: the record of the run.
        out: its folder.

    Raises:
        InputError: it did not.
    """
    if run.get("shots") != now.get("shots"):
        raise InputError(
            f"{out}: its run saw the smoke from elsewhere than its camera is now; resume with the smoke and the camera "
            "where they were, or use --overwrite"
        )


def digests(measures: Sequence[Measure]) -> dict[str, str]:
    """The SHA-256 of the frames, with the other grids that move with their smoke, by their names."""
    return {measure.name: measure.identity for measure in measures}


def file_digests(recipe: Recipe) -> dict[str, str]:
    """The SHA-256 of the pictures, maps, masks, light and cameras that a recipe names, by their paths."""
    paths = [*recipe.style, *recipe.content, *(str(file) for _, file in recipe.maps), recipe.light]
    paths += mask_files(recipe)
    paths += [] if recipe.camera is None else [str(file_and_name(recipe.camera)[0])]
    for target in targets_of(recipe):
        paths += [*target.recipe.style, *target.recipe.content, *(str(file) for _, file in target.recipe.maps)]
    return {path: file_hash(Path(path), "sha256") for path in dict.fromkeys(paths) if Path(path).is_file()}

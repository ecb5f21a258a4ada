"""The grid of a run: cubes along the scene's axes, of one size and number in all frames, on which all files are read.

Files differ in their voxels. Those of most files are the run's cells; other files whose voxels coincide with them are
read value by value, the rest is resampled. The run's box holds the smoke of all frames or, where smoke travels through
a much larger one, moves with it in whole cells.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.geometry.affine import EDGE_TOLERANCE, PLACE_TOLERANCE, Affine, between
from tnst_mi.geometry.boxes import Box, extents, grown, image, intersection, size, union, words
from tnst_mi.io.grids.vdb.clumps import Clump, smoke_box, stray
from tnst_mi.io.grids.vdb.limits import LARGEST_BOX, is_out_of_proportion
from tnst_mi.io.grids.vdb.span import Span
from tnst_mi.io.interpretation.conventions import Boxing

#: Cells around the smoke that a stylization can change: as far as the blur of its mask reaches.
REACH = 5

# A smaller box is worth it if it has at most this share of the cells.
_WORTH = 0.5

_SHOWN = 3


@dataclass(frozen=True, eq=False)
class RunGrid:
    """The grid on which the frames of a run are read.

    Attributes:
        cells: from its cells to the scene.
        box: the cells of a frame; where the box moves, those of the first.
        lows: where the box moves, the lowest cell of each frame, by the names of files without endings.
        drifts: by how many cells per frame it moves after each frame, likewise.
        notes: what is assumed, in words.
        up: the axis of the scene that is up, "y" or "z", which files without voxels do not tell.
        up_because: the evidence for it, in words.
    """

    cells: Affine
    box: Box
    lows: Mapping[str, np.ndarray] = field(default_factory=dict)
    drifts: Mapping[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    up: str = "y"
    up_because: str = ""

    def box_of(self, name: str) -> Box:
        """The cells of a frame."""
        low = self.lows.get(name, self.box[0])
        return low, low + extents(self.box) - 1

    def drift_of(self, name: str) -> np.ndarray | None:
        """By how many cells per frame (X, Y, Z) the box moves from a frame to the next; None if it rests."""
        return self.drifts.get(name)


def run_grid(spans: Sequence[Span], boxing: Boxing | None = None, beside: Sequence[Span] = ()) -> RunGrid:
    """Choose the grid of a run.

    Args:
        spans: what each file spans, in the order of the frames.
        boxing: which part of the grids is read.
        beside: what the files of velocities alone span.

    Raises:
        InputError: no file has an active voxel or tells its domain, or the box is too large or out of proportion
            to the files.
    """
    crop, ignore_stray = (boxing.crop, boxing.ignore_stray) if boxing is not None else (False, False)
    cells = _cells_of_most(spans)
    # A single pass over the files: from here on all boxes are in cells of the run.
    boxes = [_in_cells(span.box, span, cells) for span in spans]
    with_room = [span for span in beside if between(cells, span.scene).whole]
    whole = union([*boxes, *(_in_cells(span.box, span, cells) for span in with_room)])
    if whole is None:
        raise InputError(f"{spans[0].path}: no active voxel in it, so the size of the grid is unknown")
    smoke = [_in_cells(smoke_box(span.clumps, ignore_stray), span, cells) for span in spans]
    notes = [*_resampling_notes(spans, beside, cells), *_stray_notes(spans, ignore_stray)]
    box, lows = whole, dict[str, np.ndarray]()
    if crop:
        reached = [None if part is None else intersection(grown(part, REACH), whole) for part in smoke]
        cropped = union(reached)
        if cropped is not None and size(cropped) <= _WORTH * size(box):
            notes.append(
                f"the grid is cropped to the smoke of all frames and {REACH} cells around it: {words(cropped)} of "
                f"{words(whole)} cells (--crop off takes all)"
            )
            box = cropped
        moving = _moving(reached)
        if moving is not None and size(moving[0]) <= _WORTH * size(box):
            box, lows = moving[0], {span.path.stem: low for span, low in zip(spans, moving[1], strict=True)}
            notes.append(
                f"the smoke travels: a grid of {words(box)} cells moves with it in whole cells (--crop off takes "
                f"{words(whole)} cells at rest)"
            )
    telling = next((span for span in spans if span.box is not None), spans[0])
    grid = RunGrid(cells, box, lows, _drifts(spans, lows), tuple(notes), telling.up, telling.up_because)
    _require_small(grid, spans, crop)
    return grid


def _cells_of_most(spans: Sequence[Span]) -> Affine:
    """Cubes along the axes that coincide with the voxels of most files; of the finest of these, if that is a tie."""
    candidates: list[tuple[Affine, int]] = []
    for span in spans:
        # Files without smoke have a say only if there are no others.
        votes = 0 if span.box is None else len(spans)
        for index, (cells, count) in enumerate(candidates):
            if _coincide(cells, span.scene):
                candidates[index] = cells, count + votes + 1
                break
        else:
            candidates.append((Affine.scaling(span.scene.edge, span.scene.offset), votes + 1))
    most = max(count for _, count in candidates)
    return min((cells for cells, count in candidates if count == most), key=lambda cells: cells.edge)


def _coincide(cells: Affine, voxels: Affine) -> bool:
    """Whether cubes along the axes of the voxels' size, centred where voxels are, are these cells."""
    if not math.isclose(cells.edge, voxels.edge, rel_tol=EDGE_TOLERANCE):
        return False
    apart = (voxels.offset - cells.offset) / cells.edge
    return bool(np.abs(apart - np.rint(apart)).max() <= PLACE_TOLERANCE)


def _in_cells(box: Box | None, span: Span, cells: Affine) -> Box | None:
    """The cells that a box of a file's voxels reaches."""
    if box is None:
        return None
    cells_of = between(span.scene, cells)
    return image(box, cells_of, 0.0 if cells_of.whole else 0.5)


def _moving(reached: Sequence[Box | None]) -> tuple[Box, list[np.ndarray]] | None:
    """The box that holds the smoke of any one frame, and its lowest cell in each."""
    known = [box for box in reached if box is not None]
    if len(known) < 2:
        return None
    largest = np.max([extents(box) for box in known], axis=0)
    lows: list[np.ndarray] = []
    low = known[0][0]
    for box in reached:
        # It stays where it is while there is no smoke.
        low = low if box is None else box[0] - (largest - extents(box)) // 2
        lows.append(low)
    return (lows[0], lows[0] + largest - 1), lows


def _drifts(spans: Sequence[Span], lows: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """By how many cells per frame the box moves after each frame; frames without a number are consecutive.

    No frame follows the last one, which goes on as the one before.
    """
    drifts: dict[str, np.ndarray] = {}
    for span, following in itertools.pairwise(spans if lows else ()):
        frames = 1.0
        if span.number is not None and following.number is not None:
            frames = following.number - span.number
        drift = (lows[following.path.stem] - lows[span.path.stem]) / frames
        drifts[span.path.stem] = drifts[following.path.stem] = drift
    return drifts


def _require_small(grid: RunGrid, spans: Sequence[Span], crop: bool) -> None:
    """Check that memory for the box is in proportion to the largest file; names what makes it large."""
    components, stored = (
        max(counts) for counts in zip(*((span.components, span.bytes) for span in spans), strict=True)
    )
    if size(grid.box) <= LARGEST_BOX and not is_out_of_proportion(grid.box, components, stored):
        return
    widest = max(spans, key=lambda span: len(stray(span.clumps)) or len(span.clumps))
    what = f"{widest.path}: its grid spans {words(grid.box)} cells in a file of {stored} bytes"
    if strays := stray(widest.clumps):
        raise InputError(f"{what}: {_named_strays(strays, widest.clumps)}; --ignore-stray drops them")
    if not crop and any(span.clumps for span in spans):
        raise InputError(
            f"{what}, expected at most {LARGEST_BOX}, in proportion to the file; --crop on takes the smoke"
        )
    mass = sum(clump.mass for clump in widest.clumps) or 1.0
    shown = [f"{clump.mass / mass:.0%} at {_place(clump)}" for clump in widest.clumps[:_SHOWN]]
    raise InputError(f"{what}: {', '.join(shown)}; expected at most {LARGEST_BOX}; split the file")


def _resampling_notes(spans: Sequence[Span], beside: Sequence[Span], cells: Affine) -> Iterator[str]:
    """What is not read value by value."""
    for span in spans:
        if span.stored is not None:
            yield (
                f"the voxels are {span.scene.edge:.4g} large, not {span.stored.edge:.4g} as {span.path.name} says: "
                "Blender's Adaptive Domain gives each file a size and place of its own, which results keep"
            )
            break
    moved = [span for span in spans if not between(cells, span.scene).whole]
    edge = f"{cells.edge:.4g}"
    if moved:
        first = moved[0]
        others = f" and {len(moved) - 1} other files" if len(moved) > 1 else ""
        voxels = "×".join(f"{length:.4g}" for length in first.scene.edges)
        turned = "" if first.scene.axes() is not None or _upright(first.scene) else ", turned or sheared"
        blender = ""
        if first.blender:
            blender = (
                " (Blender: Adaptive Domain changes them from frame to frame; the config/ of the same bake, beside the "
                "folder of the files, would tell where they are)"
            )
        yield (
            f"resampled to cubes of {edge}: the voxels of {first.path.name}{others} are {voxels}{turned}{blender}; "
            "results return to each file's own voxels"
        )
    for span in spans:
        off = np.ptp(span.scene.edges) / span.scene.edge
        if span not in moved and off > EDGE_TOLERANCE:
            yield f"the voxels of {span.path.name} are taken as cubes: their edges differ by {off:.2%}"
            break
    for span in [*spans, *beside]:
        if span in moved or len(span.velocity) != 1:
            continue
        velocity = span.velocity[0]
        if not between(cells, velocity).whole:
            voxels = "×".join(f"{length:.4g}" for length in velocity.edges)
            at = ", ".join(f"{place:.4g}" for place in velocity.offset)
            yield f"velocity resampled to the cells of {edge}: its voxels are {voxels} at ({at}), in {span.path.name}"
            break
    for span in spans:
        if span.outside:
            yield (
                f"{span.path.name}: the density outside of its active voxels is {span.outside:g}; it is taken as 0 "
                "beyond the grid"
            )
            break


def _upright(scene: Affine) -> bool:
    return bool((np.count_nonzero(scene.matrix, axis=0) == 1).all())


def _stray_notes(spans: Sequence[Span], ignored: bool) -> Iterator[str]:
    found = [span for span in spans if stray(span.clumps)]
    if not found:
        return
    span = found[0]
    others = f" (and in {len(found) - 1} other files)" if len(found) > 1 else ""
    strays = _named_strays(stray(span.clumps), span.clumps)
    remedy = "left out" if ignored else "they make the grid larger: --ignore-stray drops them"
    yield f"{span.path.name}: {strays}{others}; {remedy}"


def _named_strays(strays: Sequence[Clump], clumps: Sequence[Clump]) -> str:
    share = sum(clump.mass for clump in strays) / sum(clump.mass for clump in clumps)
    voxels = sum(clump.voxels for clump in strays)
    places = ", ".join(_place(clump) for clump in strays[:_SHOWN]) + (", …" if len(strays) > _SHOWN else "")
    return f"{voxels} stray voxel{'s' * (voxels > 1)} at {places} with {share:.2g} of the smoke"


def _place(clump: Clump) -> str:
    return f"({', '.join(map(str, clump.box[0].tolist()))})"

"""What a file spans: where its voxels lie in the scene, and where in them its smoke is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tnst_mi.geometry.affine import Affine
from tnst_mi.geometry.boxes import Box
from tnst_mi.io.grids.vdb.clumps import Clump


@dataclass(frozen=True, eq=False)
class Span:
    """What a file spans, in voxels of its density (of its velocity, if it has no density).

    Attributes:
        path: the file.
        scene: from voxels to the scene.
        box: the domain that it declares with all active voxels of the density, else the box around the active voxels
            of density and velocity; None if it has neither.
        clumps: where its smoke is.
        velocity: from the voxels of the velocity, or of each of its components, to the scene; () if there is none.
        stored: from voxels to the scene as the file has it, where that is untrue; else None.
        blender: whether it comes from Blender, whose domains may be adaptive.
        outside: the density outside of the active voxels.
        number: of the frame, or None.
        components: of the values of all its grids that are read together.
        bytes: of the file.
    """

    path: Path
    scene: Affine
    box: Box | None
    clumps: tuple[Clump, ...] = ()
    velocity: tuple[Affine, ...] = ()
    stored: Affine | None = None
    blender: bool = False
    outside: float = 0.0
    number: float | None = None
    components: int = 1
    bytes: int = 0

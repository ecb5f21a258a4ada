"""The media of a scene and the shapes around them, checked and resolved once."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.rendering.march.medium import GridMedium, HomogeneousMedium
from tnst_mi.rendering.march.ray_path import passes_straight


class SceneMedia:
    """The media of a scene.

    Args:
        scene: the scene.
        named: the medium that the sensor names, if it names one.

    Attributes:
        media: every medium once, in the order of the scene's shapes, and last the sensor's if no shape has it.
        only_boundaries: the scene has no shapes but those around its media.
        box: the only medium of the shapes, if the only shape around one is the box of its grid; else None. No rays need
            to be traced to find such a medium.

    Raises:
        RuntimeError: the scene has no medium, or one that the integrator cannot march through.
    """

    def __init__(self, scene: mi.Scene, named: mi.Medium | None = None) -> None:
        self._shapes = scene.shapes()
        self._boundaries = [shape for shape in self._shapes if shape.interior_medium() is not None]
        of_shapes = _distinct([m for shape in self._shapes for m in (shape.interior_medium(), shape.exterior_medium())])
        found = _distinct([*of_shapes, named])
        if not found:
            raise RuntimeError("emission_absorption: the scene has no medium, expected one")
        self.media = [HomogeneousMedium(m) if m.is_homogeneous() else GridMedium(m) for m in found]
        self.only_boundaries = len(self._boundaries) == len(self._shapes)
        # Media in shape groups are found by tracing rays alone.
        instances = any(shape.class_name() == "Instance" for shape in self._shapes)
        self._may_be_box = len(self._boundaries) == len(of_shapes) == 1 and not instances
        self._meshes = [mi.traverse(shape) for shape in self._boundaries if isinstance(shape, mi.Mesh)]
        self._look_at_shapes()

    def belongs_to(self, scene: mi.Scene, named: mi.Medium | None) -> bool:
        """Whether these are the media of `scene`, among them the one that the sensor names."""
        shapes = scene.shapes()
        same = len(shapes) == len(self._shapes) and all(a is b for a, b in zip(shapes, self._shapes, strict=True))
        return same and (named is None or any(medium.medium is named for medium in self.media))

    def refresh(self) -> None:
        """Follow what `parameters.update()` may have changed: extinctions, scales, and the vertices of meshes."""
        for medium in self.media:
            medium.refresh()
        # Those seen last are kept alive, so that no other array can reuse their index.
        if [a.index for a in self._positions()] != [b.index for b in self._seen_positions]:
            self._look_at_shapes()

    def _positions(self) -> list[mi.Float]:
        """The vertices of the shapes that are meshes. Copies: the parameters are references."""
        return [mi.Float(mesh["vertex_positions"]) for mesh in self._meshes]

    def _look_at_shapes(self) -> None:
        self._seen_positions = self._positions()
        for shape in self._boundaries:
            self._check(shape)
        self.box: GridMedium | None = None
        if self._may_be_box:
            shape, medium = self._boundaries[0], self.media[0]
            self.box = medium if isinstance(medium, GridMedium) and _is_the_box(shape, medium) else None

    def _check(self, shape: mi.Shape) -> None:
        if not passes_straight(shape.bsdf()):
            raise RuntimeError("emission_absorption: the shape around a medium must have a `null` BSDF")
        if shape.emitter() is not None:
            raise RuntimeError("emission_absorption: the shape around a medium must not be an emitter")
        if _seen_from_inside(shape) > 0.5:
            raise RuntimeError(
                "emission_absorption: the normals of the shape around a medium point inwards, as those of mirrored "
                "shapes do, so that Mitsuba takes its outside for the medium: set its `flip_normals`"
            )


def _distinct(media: Sequence[mi.Medium | None]) -> list[mi.Medium]:
    """Every medium once, in the same order."""
    found: list[mi.Medium] = []
    for medium in media:
        if medium is not None and not any(medium is other for other in found):
            found.append(medium)
    return found


def _is_the_box(shape: mi.Shape, medium: GridMedium) -> bool:
    """Whether the shape around a medium is the box of its grid."""
    if not isinstance(shape, mi.Mesh) or shape.face_count() != 12:
        return False
    vertices = np.array(mi.traverse(shape)["vertex_positions"], np.float64).reshape(-1, 3)
    local = (vertices - medium.transform.centre) @ medium.transform.matrix.T + 0.5
    corners = np.round(local)
    on_corners = np.abs(local - corners).max() < 1e-4 and np.isin(corners, (0, 1)).all()
    return bool(on_corners and len(np.unique(corners, axis=0)) == 8)


def _seen_from_inside(shape: mi.Shape) -> float:
    """The share of rays from outside a shape's bounding box that meet it from the inner side first; 0 if none meet it.

    The rays, 16×16 of them, are parallel, and the shape is alone, since others may touch it. Mitsuba's normals of
    sampled positions do not serve: those of mirrored meshes differ from those of rays' intersections.
    """
    box, side = shape.bbox(), 16
    index = dr.arange(mi.UInt32, side * side)
    across = (mi.Vector2f(mi.Float(index % side), mi.Float(index // side)) + 0.5) / side - 0.5
    # Oblique, so that boxes do not show an edge.
    frame = mi.Frame3f(mi.Vector3f(0.36, 0.48, 0.8))
    start = mi.Point3f((box.max + box.min) / 2) + dr.norm(box.max - box.min) * (
        frame.s * across.x + frame.t * across.y - frame.n
    )
    rays = mi.Ray3f(start, frame.n + dr.zeros(mi.Vector3f, side * side))
    # Not part of the generated code, so that every shape runs the same kernel.
    dr.make_opaque(rays)
    # Not by `mi.load_dict`, which would rename the shape.
    alone = mi.Properties("scene")
    alone["shape"] = shape
    hit = mi.PluginManager.instance().create_object(alone).ray_intersect(rays)
    met = hit.is_valid().numpy()
    return float((dr.dot(hit.n, rays.d).numpy()[met] > 0).sum() / max(met.sum(), 1))

"""Whether views tell anything of the smoke: where their cameras stand, and what is in their pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.reconstruction.camera_sets.posed_view import CameraSet, PosedView
from tnst_mi.reconstruction.photographs import Photograph
from tnst_mi.reconstruction.settings import ReconstructionSettings
from tnst_mi.reconstruction.volume import GridPlace
from tnst_mi.rendering.cameras.camera import Camera
from tnst_mi.rendering.cameras.perspective import ImagePlane
from tnst_mi.rendering.cameras.shots import camera_in_cells

#: Points along each edge of the box, and rays along each edge of a picture, by which it is decided whether one is in
#: the other: the points find boxes that are small in the picture, the rays pictures of a small part of the box.
_POINTS, _RAYS = 9, 9


def require_backgrounds_of_use(cameras: CameraSet, settings: ReconstructionSettings) -> None:
    """Check that pictures of the background are there only where something can be seen of it.

    Raises:
        InputError: a view has one that nothing is made of.
    """
    view = next((view for view in cameras.views if view.background is not None), None)
    if view is None:
        return
    if settings.integrator == "prbvolpath":
        reason = "prbvolpath renders smoke before black; leave it out, or take emission_absorption"
    elif settings.quadrature == "paper":
        reason = (
            "the sum of quadrature = paper has no transmittance that a background could be seen through; leave it out, "
            "or take exact"
        )
    else:
        return
    raise InputError(f"{cameras.file}: view {view.name}: background = {view.background}: {reason}")


def remarks_of_views(cameras: CameraSet, views: Sequence[PosedView], place: GridPlace) -> list[str]:
    """What is to be said of where the cameras stand of those views that are used."""
    used, said = [view for view in views if not view.held_out], []
    if len(used) == 1:
        said.append(
            f"views: {used[0].name} alone is used, and how deep smoke is along its rays is left to the prior; "
            "give views from other sides"
        )
    inside = [view.name for view in used if _stands_inside(view, cameras.up, place)]
    if inside:
        said.append(
            f"views: {', '.join(inside)}: the camera stands inside of the box, and nothing tells what is behind it; "
            "check --box"
        )
    return said


def require_box_in_sight(photographs: Sequence[Photograph], shape: Shape) -> None:
    """Check that some view that is used sees a part of the grid (D, H, W).

    Raises:
        InputError: none does.
    """
    if not any(_sees(photograph.camera, shape) for photograph in photographs if not photograph.held_out):
        raise InputError(
            "no view that is used sees any of the box; check --box and where the cameras stand, both in the axes and "
            "the unit of the cameras' scene"
        )


def require_contrast(photographs: Sequence[Photograph], settings: ReconstructionSettings) -> None:
    """Check that pictures are not one bright value all over, which smoke and what is behind it may be alike.

    Raises:
        InputError: all that are used are, and nothing is known of what is behind them.
    """
    used = [one for one in photographs if not one.held_out and (one.weights > 0).any()]
    counted = [one.values[one.weights > 0] for one in used]
    known = settings.background not in (0, "auto") or any(one.background is not None for one in used)
    if counted and not known and all(values.min() == values.max() > 0 for values in counted):
        raise InputError(
            f"every pixel of every picture is as bright as all others of it, {counted[0][0]:.4g} in view "
            f"{used[0].name}; give --background, or pictures in which smoke is brighter than what is behind it"
        )


def without_contrast(photographs: Sequence[Photograph]) -> list[str]:
    """The names of views that show nothing, where others do: that are used, and whose pixels all have one value."""
    used = {one.name: one.values[one.weights > 0] for one in photographs if not one.held_out}
    found = [name for name, values in used.items() if not len(values) or values.min() == values.max()]
    return found if len(found) < len(used) else []


def _stands_inside(view: PosedView, up: str, place: GridPlace) -> bool:
    camera = camera_in_cells(view.camera((1, 1)).turned(up, place.placement.up), place.placement, place.shape)
    return camera.perspective and bool((np.abs(camera.position) < np.array(place.shape[::-1]) / 2).all())


def _sees(camera: Camera, shape: Shape) -> bool:
    """Whether any of a grid's points is in the picture, or any ray of the picture goes through the grid."""
    half = np.array(shape[::-1], np.float64) / 2
    points = np.stack(np.meshgrid(*(np.linspace(-n, n, _POINTS) for n in half)), axis=-1).reshape(-1, 3)
    right, up, towards = camera.axes
    from_camera = points - camera.position
    depth = -from_camera @ towards
    height = (
        2 * depth * np.tan(np.radians(camera.field) / 2) if camera.perspective else np.full(len(depth), camera.field)
    )
    x, y = ((from_camera @ axis) for axis in (right, up))
    inside = (height > 0) & (np.abs(x + camera.shift[0] * height) <= camera.aspect / 2 * height)
    if (inside & (np.abs(y + camera.shift[1] * height) <= height / 2)).any():
        return True
    plane = ImagePlane.of(camera, (_RAYS - 1, _RAYS - 1), 1.0, 2 * float(np.linalg.norm(shape)))
    row, column = (n.reshape(-1, 1) for n in np.indices((_RAYS, _RAYS)))
    across = plane.corner + column * plane.across + row * plane.down
    start = plane.foot + plane.start * plane.towards + across * (1 - plane.start * plane.spread)
    with np.errstate(divide="ignore", invalid="ignore"):  # rays along a face of the box
        faces = (np.array([[-half], [half]]) - start) / (across * plane.spread - plane.towards)
    near, far = np.nan_to_num(faces.min(0), nan=-np.inf).max(1), np.nan_to_num(faces.max(0), nan=np.inf).min(1)
    return bool((np.maximum(near, 0) < far).any())

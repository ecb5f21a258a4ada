"""Scenes as users of the plugin write them: Mitsuba's own sensors, a medium with a phase function, any transform."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from ray_march import camera_axes

#: The parameter that holds the extinction (D, H, W, C).
EXTINCTION = "smoke.interior_medium.sigma_t.data"


def film(width: int, height: int, pixel_format: str = "luminance") -> dict[str, object]:
    """A film and a sampler that give one noise-free sample at each pixel centre."""
    return {
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": pixel_format,
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
    }


def orthographic(
    shape: tuple[int, int, int], view: tuple[float, float] = (0.0, 0.0), pixel_format: str = "luminance"
) -> dict[str, object]:
    """Mitsuba's `orthographic` sensor, placed like the views of `tnst_mi.render` for cells of size 1."""
    _, rows, columns = shape
    _, up, towards = camera_axes(view)
    placed = mi.ScalarTransform4f().look_at((200 * towards).tolist(), [0, 0, 0], up.tolist())
    # Mitsuba's film spans [-1, 1] horizontally.
    to_world = placed @ mi.ScalarTransform4f().scale([columns / 2, columns / 2, 1])
    return {"type": "orthographic", "to_world": to_world, **film(columns, rows, pixel_format)}


def affine(edges: np.ndarray, centre: np.ndarray) -> mi.ScalarTransform4f:
    """The map from [-1/2, 1/2]³ to the parallelepiped with these edges (columns) and this centre."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = edges, centre
    return mi.ScalarTransform4f(matrix.tolist())


def cube(to_world: mi.ScalarTransform4f) -> dict[str, object]:
    """The image of [-1, 1]³, with its normals outwards, which mirroring turns inwards."""
    mirrored = np.linalg.det(np.array(to_world.matrix)) < 0
    return {"type": "cube", "to_world": to_world, "flip_normals": bool(mirrored)}


def medium(extinction: np.ndarray, to_world: mi.ScalarTransform4f, scale: float = 1.0) -> dict[str, object]:
    """A scattering `heterogeneous` medium of extinction (D, H, W[, C]) filling the image of [-1/2, 1/2]³."""
    grid = np.ascontiguousarray(extinction / scale, np.float32)
    return {
        "type": "heterogeneous",
        "albedo": 0.9,
        "phase": {"type": "hg", "g": 0.3},
        "scale": scale,
        "sigma_t": {
            "type": "gridvolume",
            "grid": mi.VolumeGrid(grid if grid.ndim == 4 else grid[..., None]),
            "to_world": to_world @ mi.ScalarTransform4f().translate(-0.5),
            # Textures of a GPU interpolate with weights of 8 bits.
            "accel": False,
        },
    }


def smoke_scene(
    extinction: np.ndarray,
    sensor: dict[str, object],
    integrator: dict[str, object],
    edges: np.ndarray | None = None,
    centre: np.ndarray | None = None,
    scale: float = 1.0,
    boundary: dict[str, object] | None = None,
    **others: dict[str, object],
) -> mi.Scene:
    """A scene of one medium inside a box, or inside another convex `boundary`, with `others` around it.

    `edges` and `centre` place the grid; unit cells about the origin if left out.
    """
    edges = np.diag(extinction.shape[2::-1]).astype(float) if edges is None else edges
    to_world = affine(edges, np.zeros(3) if centre is None else centre)
    box = cube(to_world @ mi.ScalarTransform4f().scale(0.5))
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "emission_absorption", **integrator},
            "sensor": sensor,
            "smoke": {
                **(boundary or box),
                "bsdf": {"type": "null"},
                "interior": medium(extinction, to_world, scale),
            },
            **others,
        }
    )


def plate(view: tuple[float, float], distance: float, **what: object) -> dict[str, object]:
    """A 6×6 square facing the camera of a view, `distance` from the origin towards it."""
    _, up, towards = camera_axes(view)
    placed = mi.ScalarTransform4f().look_at(
        (distance * towards).tolist(), ((distance + 1) * towards).tolist(), up.tolist()
    )
    return {"type": "rectangle", "to_world": placed @ mi.ScalarTransform4f().scale([3, 3, 1]), **what}


def image_of(scene: mi.Scene) -> np.ndarray:
    """The first channel (H, W) of the scene's image."""
    return mi.render(scene).numpy()[..., 0]


def extinction_of(scene: mi.Scene) -> np.ndarray:
    """A copy of `sigma_t.data` (D, H, W, C): numpy's view of a parameter does not keep its memory."""
    return mi.traverse(scene)[EXTINCTION].numpy().copy()


def extinction_gradient(scene: mi.Scene, weights: np.ndarray) -> np.ndarray:
    """Gradient of the weighted sum of the image with respect to `sigma_t.data`."""
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters[EXTINCTION])
    parameters.update()
    dr.backward(dr.sum(mi.render(scene, parameters) * mi.TensorXf(weights), axis=None))
    return dr.grad(parameters[EXTINCTION]).numpy()


def extinction_objective(scene: mi.Scene, weights: np.ndarray) -> Callable[[np.ndarray], float]:
    """That weighted sum as a function of `sigma_t.data`, for finite differences."""
    parameters = mi.traverse(scene)

    def objective(extinction: np.ndarray) -> float:
        parameters[EXTINCTION] = mi.TensorXf(extinction)
        parameters.update()
        return float((mi.render(scene).numpy().astype(np.float64) * weights).sum())

    return objective


def error_message(error: BaseException) -> str:
    """The text at the origin of an error that passed through Mitsuba and Dr.Jit."""
    while error.__cause__ is not None:
        error = error.__cause__
    return str(error)

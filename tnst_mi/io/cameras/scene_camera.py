"""A camera as it stands in a scene, in the scene's own axes and unit of length."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tnst_mi.errors import InputError

#: From the axes of a scene whose y is up to those of one whose z is, (3, 3): (x, y, z) becomes (x, −z, y).
_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

#: The largest cosine of the angle between two axes that still count as perpendicular: numbers of a few digits.
_PERPENDICULAR = 1e-3


@dataclass(frozen=True, eq=False)
class SceneCamera:
    """A camera in a scene.

    Attributes:
        to_scene: (4, 4) float64, a rotation and a translation: from the camera's coordinates, in which it looks along
            −z from the origin with x to the right and y up, to those of the scene.
        perspective: whether it is a perspective camera; otherwise an orthographic one.
        field: of a perspective camera, the vertical field of view in degrees; of an orthographic one, the height of the
            picture in the scene's unit of length.
        aspect: width of the picture over its height.
        shift: where the line that the camera looks along meets the picture, as an offset from its middle, to the right
            and up, in parts of its height.
    """

    to_scene: np.ndarray
    perspective: bool
    field: float
    aspect: float
    shift: tuple[float, float] = (0.0, 0.0)

    def turned(self, up: str, to_up: str) -> SceneCamera:
        """The same camera in a scene with another axis up.

        Args:
            up: the axis that is up, "y" or "z".
            to_up: the one that shall be.
        """
        if up == to_up:
            return self
        turn = np.eye(4)
        turn[:3, :3] = _TO_Z_UP if to_up == "z" else _TO_Z_UP.T
        return replace(self, to_scene=turn @ self.to_scene)

    def scaled(self, factor: float) -> SceneCamera:
        """The same camera in another unit of length, of which the old one is `factor`."""
        to_scene = self.to_scene.copy()
        to_scene[:3, 3] *= factor
        return replace(self, to_scene=to_scene, field=self.field if self.perspective else self.field * factor)


def rigid(matrix: np.ndarray) -> np.ndarray:
    """The rotation and the translation (4, 4) of a camera's matrix, from its coordinates to the scene's.

    A scale, which cameras inherit from what they are attached to, does not change what they see, and is left out.

    Args:
        matrix: (4, 4), applied to columns: its last column is where the camera stands.

    Raises:
        InputError: it mirrors, shears or flattens, or is transposed.
    """
    matrix = np.asarray(matrix, np.float64)
    bottom = np.array([0.0, 0.0, 0.0, 1.0])
    if not np.isfinite(matrix).all():
        raise InputError("matrix: has values that are no finite numbers")
    if not np.allclose(matrix[3], bottom, atol=1e-6):
        transposed = np.allclose(matrix[:, 3], bottom, atol=1e-6)
        remedy = "; it is transposed: the camera's place belongs into the last column" if transposed else ""
        raise InputError(f"matrix: its last row is {_spelled(matrix[3])}, expected 0, 0, 0, 1{remedy}")
    with np.errstate(over="ignore"):
        lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not (lengths > 0).all() or not np.isfinite(lengths).all():
        raise InputError(f"matrix: its axes are {_spelled(lengths)} long, expected lengths above 0")
    axes = matrix[:3, :3] / lengths
    if np.abs(axes.T @ axes - np.eye(3)).max() > _PERPENDICULAR:
        raise InputError("matrix: its axes are not perpendicular, expected a rotation and a translation")
    if np.linalg.det(axes) < 0:
        raise InputError("matrix: mirrors, expected a rotation and a translation")
    # The nearest rotation, without what rounding has done to it.
    left, _, right = np.linalg.svd(axes)
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = left @ right, matrix[:3, 3]
    return result


def looking(position: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """The matrix (4, 4) of a camera at a place (3) that looks at another (3), with `up` (3) upwards in its picture.

    Raises:
        InputError: the places are one, or `up` is along the line between them.
    """
    towards = np.asarray(position, np.float64) - target
    distance = np.linalg.norm(towards)
    if not (np.isfinite(distance) and distance > 0):
        raise InputError("position and target: are the same place, or too far away")
    towards /= distance
    length = np.linalg.norm(up)
    right = np.cross(up / length if length > 0 else up, towards)
    if not np.linalg.norm(right) > 1e-6:
        raise InputError(f"up = {_spelled(up)}: is 0, or along the line from position to target; give another")
    right /= np.linalg.norm(right)
    result = np.eye(4)
    result[:3, :3] = np.stack([right, np.cross(towards, right), towards], axis=1)
    result[:3, 3] = position
    return result


def _spelled(numbers: np.ndarray) -> str:
    return ", ".join(f"{number:g}" for number in numbers)

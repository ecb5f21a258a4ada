"""The camera of a shot, perspective or orthographic, and the centred view of the smoke from where it stands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.rendering.cameras.views import View

#: How far a matrix may be from a rotation, or from a rotation with a scale, in any of its entries: what single
#: precision and text files leave of one.
_TOLERANCE = 1e-4


@dataclass(frozen=True)
class Camera:
    """A pinhole or orthographic camera without lens effects.

    It looks along its own −z axis with x to the right and y up, as in Blender, USD and OpenGL. As an argument of a
    renderer, world units are full-resolution cells, and the world's origin is the centre of the grid.

    Args:
        to_world: (4, 4), from the camera's axes to the world: a rotation and a translation, nothing else.
        perspective: whether rays start at the camera's position, or are parallel.
        field: perspective: the vertical field of view in degrees, above 0 and below 180; orthographic: the height of
            the image in world units, above 0.
        aspect: width over height of the image, above 0.
        shift: where the optical axis meets the image, as an offset from its centre, to the right and up, in parts of
            the image's height. (Blender's shifts have the other sign, and are in parts of the larger edge.)

    Attributes:
        to_world: as nested tuples, its rotation exact.

    Raises:
        InputError: a value is not as stated.

    Example:
        >>> import numpy as np
        >>> import tnst_mi
        >>> to_world = np.eye(4)
        >>> to_world[:3, 3] = 0, 0, 100
        >>> camera = tnst_mi.Camera(to_world, perspective=True, field=30, aspect=1.5)
        >>> camera.centred_view
        (0.0, 0.0, 100.0)
    """

    to_world: Sequence[Sequence[float]] | np.ndarray
    perspective: bool
    field: float
    aspect: float
    shift: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check every value and bring it into its normal form."""
        matrix = _matrix("to_world", self.to_world)
        rotation = matrix[:3, :3]
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > _TOLERANCE or np.linalg.det(rotation) < 0:
            raise InputError(
                "camera: to_world scales, shears or mirrors, expected a rotation and a translation alone: apply the "
                "camera's scale"
            )
        left, _, right = np.linalg.svd(rotation)
        matrix[:3, :3] = left @ right
        numbers = [self.field, self.aspect, *self.shift]
        if len(numbers) != 4 or not np.isfinite(numbers).all():
            raise InputError(
                f"camera: field {self.field}, aspect {self.aspect} and shift {self.shift} given, expected finite "
                "numbers, and two of them as shift"
            )
        if not 0 < self.field < (180 if self.perspective else math.inf):
            wanted = "degrees above 0 and below 180" if self.perspective else "a height above 0"
            raise InputError(f"camera: field {self.field} given, expected {wanted}")
        if not self.aspect > 0:
            raise InputError(f"camera: aspect {self.aspect} given, expected a number above 0")
        object.__setattr__(self, "to_world", tuple(tuple(row) for row in matrix.tolist()))
        object.__setattr__(self, "perspective", bool(self.perspective))
        object.__setattr__(self, "field", float(self.field))
        object.__setattr__(self, "aspect", float(self.aspect))
        object.__setattr__(self, "shift", (float(self.shift[0]), float(self.shift[1])))

    @property
    def axes(self) -> np.ndarray:
        """Rows right, up and towards the viewer, unit vectors in world space: (3, 3) float64."""
        return np.array(self.to_world)[:3, :3].T

    @property
    def position(self) -> np.ndarray:
        """The camera's place in the world, (x, y, z) float64."""
        return np.array(self.to_world)[:3, 3]

    @property
    def centred_view(self) -> View:
        """The view of the world's origin from where the camera stands, which zoom, pan, roll and shift do not change.

        Of an orthographic camera (azimuth, elevation) in degrees, those that it looks from; of a perspective one
        (azimuth, elevation, distance), those of its position.

        Raises:
            InputError: a perspective camera is at the origin.
        """
        towards = self.position if self.perspective else self.axes[2]
        distance = float(np.linalg.norm(towards))
        if distance == 0:
            raise InputError("camera: it is at the centre of the smoke's grid, so that there is no view from outside")
        x, y, z = (towards / distance).tolist()
        # Straight from above or below every azimuth is the same; a rounded one would be any.
        azimuth = math.degrees(math.atan2(x, z)) if math.hypot(x, z) > 1e-12 else 0.0
        elevation = math.degrees(math.asin(min(max(y, -1.0), 1.0)))
        return (azimuth, elevation, distance) if self.perspective else (azimuth, elevation)

    def moved(self, matrix: np.ndarray | Sequence[Sequence[float]]) -> Camera:
        """The camera in another world, of which this one is a turned, moved and evenly scaled part.

        Args:
            matrix: (4, 4), from this world to the other, a similarity that does not mirror.

        Raises:
            InputError: it is none.
        """
        similarity = _matrix("the matrix of a move", matrix)
        determinant = np.linalg.det(similarity[:3, :3])
        scale = float(np.cbrt(determinant))
        if scale <= 0:
            raise InputError("camera: the matrix of a move mirrors or flattens, expected a similarity")
        rotation = similarity[:3, :3] / scale
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > _TOLERANCE:
            raise InputError("camera: the matrix of a move shears or scales unevenly, expected a similarity")
        to_world = np.eye(4)
        to_world[:3, :3] = rotation @ self.axes.T
        to_world[:3, 3] = similarity[:3, :3] @ self.position + similarity[:3, 3]
        field = self.field if self.perspective else scale * self.field
        return replace(self, to_world=tuple(tuple(row) for row in to_world.tolist()), field=field)


#: What a renderer takes: the smoke's centred views, or the camera of a shot.
Viewpoint = View | Camera


def _matrix(name: str, values: object) -> np.ndarray:
    """A (4, 4) float64 matrix of finite numbers that ends in 0, 0, 0, 1."""
    try:
        matrix = np.array(values, np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise InputError(f"camera: {name} is not a 4×4 matrix of finite numbers whose last row is 0, 0, 0, 1")
    return matrix

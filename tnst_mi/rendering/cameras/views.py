"""Camera placement: Poisson-disc sets of views, and the camera's axes for one view.

A view looks at the centre of the grid. It is (azimuth, elevation) in degrees: (0, 0) looks along -z from +z with x to
the right and y up; +azimuth moves the camera towards +x, +elevation moves it up. Such a view is orthographic. One of
(azimuth, elevation, distance) is in perspective, from a point at that distance, in full-resolution cells; pixels are as
far apart as in the orthographic view in the plane through the centre that faces the camera.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.bounds import smoke_box

#: (azimuth, elevation) in degrees, or (azimuth, elevation, distance): see the top of this file.
View = tuple[float, float] | tuple[float, float, float]

# Darts thrown at one radius before it shrinks; the first radius relative to the densest packing; the factor by which it
# shrinks; and the fraction of the first radius below which points may coincide, so that the search ends even in ranges
# too narrow for floating point.
DARTS = 64
DENSITY = 0.75
SHRINK = 0.95
GIVE_UP = 1e-3


def sample_views(
    n: int,
    azimuth: tuple[float, float] = (-10.0, 10.0),
    elevation: tuple[float, float] = (-5.0, 5.0),
    seed: int | Sequence[int] = 0,
) -> np.ndarray:
    """Spread n views evenly but irregularly over a range of directions (paper section 4.1).

    Poisson-disc sampling by dart throwing: a point is kept if it lies at least a radius away from all others. The
    radius starts at 3/4 of the densest packing's, a usual density of Poisson-disc sets (a larger one would push a few
    views into the corners), and shrinks until n points fit, so there are always exactly n; in a range of zero extent
    they coincide.

    Args:
        n: Number of views, at least 1.
        azimuth: Lowest and highest azimuth in degrees, within [-360, 360].
        elevation: Lowest and highest elevation in degrees, within [-360, 360].
        seed: A non-negative integer or a sequence of them; the same seed gives the same views.

    Returns:
        (n, 2) float64, rows (azimuth, elevation) in degrees. Row 0 is the centre of both ranges.

    Raises:
        InputError: n < 1, a range that is not (low, high) with finite low <= high, or a seed that is not made
            of non-negative integers.

    Example:
        >>> import tnst_mi
        >>> views = tnst_mi.sample_views(9, azimuth=(0, 40), elevation=(-5, 5), seed=1)
        >>> views.shape
        (9, 2)
        >>> views[0].tolist()
        [20.0, 0.0]
    """
    if not isinstance(n, int | np.integer) or n < 1:
        raise InputError(f"views: {n!r} is not a number of views; give an integer of at least 1")
    low, high = np.array([_check_range("azimuth", azimuth), _check_range("elevation", elevation)]).T
    generator = _generator(seed)

    extent = high - low
    views = np.empty((n, 2))
    views[0] = low + 0.5 * extent
    first_radius = DENSITY * max(np.sqrt(2.0 / np.sqrt(3.0) * extent.prod() / n), extent.max() / n)
    radius = first_radius
    found = 1
    while found < n:
        for dart in np.minimum(low + extent * generator.random((DARTS, 2)), high):
            if np.hypot(*(views[:found] - dart).T).min() >= radius:
                views[found] = dart
                found += 1
                break
        else:
            radius = SHRINK * radius if radius > GIVE_UP * first_radius else 0.0
    return views


def distance_of(view: View) -> float | None:
    """The distance of the eye of a view in perspective, above 0; None if it is orthographic.

    Raises:
        InputError: there is one that is not above 0.
    """
    if len(view) == 2:
        return None
    if not 0 < view[2] < math.inf:
        raise InputError(f"view: a distance of {view[2]} given, expected a number of full-resolution cells above 0")
    return float(view[2])


def text_of(view: View, between: str = ",") -> str:
    """A view as text, such as "-10,5", or "-10,5,60" with its distance."""
    return between.join(f"{number:g}" for number in view)


# Cached, since an iteration uses the same views several times.
@functools.lru_cache(maxsize=256)
def camera_frame(azimuth: float, elevation: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the camera's right, up and towards-the-camera axes for a view given in degrees.

    Returns:
        Three orthonormal float64 vectors (x, y, z), right-handed: right × up = towards the camera. The
        viewing direction is the negative of the third. They cannot be written to.
    """
    a, e = np.radians((azimuth, elevation))
    towards_camera = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    right = np.array([np.cos(a), 0.0, -np.sin(a)])
    up = towards_camera[[1, 2, 0]] * right[[2, 0, 1]] - towards_camera[[2, 0, 1]] * right[[1, 2, 0]]
    # The cosine of 90° is 6e-17 in floating point; a ray meant to run along a face would cross it far away.
    axes = np.round([right, up, towards_camera], 15)
    axes.setflags(write=False)
    return axes[0], axes[1], axes[2]


def fitted_size(
    shape: tuple[int, int, int],
    azimuth: tuple[float, float],
    elevation: tuple[float, float],
    distance: float | None = None,
) -> tuple[int, int]:
    """Rows and columns of an image that shows all of a grid (D, H, W) in every view of these ranges, in degrees.

    They are even where those of the grid are, so that pixel centres stay on cell centres in the front view. In
    perspective, the distance of the eye is in cells of the grid.

    Raises:
        InputError: the eye is in the grid, or so near that no image shows all of it.
    """
    a, e = np.radians(
        np.meshgrid(*(np.linspace(*ends, 181 if ends[1] > ends[0] else 1) for ends in (azimuth, elevation)))
    )
    sizes = np.array(shape[::-1], float)
    # By how much a pixel's row and column change along x, y and z, see `camera_frame`.
    right = np.array([np.cos(a), 0 * a, -np.sin(a)])
    up = np.array([-np.sin(a) * np.sin(e), np.cos(e), -np.cos(a) * np.sin(e)])
    if distance is None:
        rows, columns = (float((np.moveaxis(abs(axes), 0, -1) @ sizes).max()) for axes in (up, right))
    else:
        towards = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        rows, columns = _corners_seen(sizes, up, right, towards, distance)
    # Rounding must not add a pixel.
    return _as_even_as(shape[1], math.ceil(rows - 1e-6)), _as_even_as(shape[2], math.ceil(columns - 1e-6))


def _corners_seen(
    sizes: np.ndarray, up: np.ndarray, right: np.ndarray, towards: np.ndarray, distance: float
) -> tuple[float, float]:
    """Height and width of the images in which the eyes of some views, (3, …) axes each, see the corners of a box."""
    signs = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3), axis=-1).reshape(-1, 3)
    y, x, nearer = (np.tensordot(signs * sizes, axes, 1) for axes in (up, right, towards))
    before = 1 - nearer / distance
    # So near, a corner is beside or behind the eye, or its image so large that it were no longer one.
    if before.min() < 1e-2:
        raise InputError(
            f"view: from a distance of {distance:g} cells no image shows all of a grid whose corners are up to "
            f"{np.linalg.norm(sizes) / 2:.1f} cells from its centre; move the camera away, or leave fit out"
        )
    return 2 * float((abs(y) / before).max()), 2 * float((abs(x) / before).max())


def common_size(shape: tuple[int, int, int], views: Sequence[View], h: float = 1.0) -> tuple[int, int]:
    """Rows and columns of an image that shows all of a grid (D, H, W) in each of some views; see `fitted_size`.

    Cells are of size h in the unit of the views' distances.
    """
    sizes = []
    for view in views:
        distance = distance_of(view)
        ranges = (view[0], view[0]), (view[1], view[1])
        sizes.append(fitted_size(shape, *ranges, None if distance is None else distance / h))
    rows, columns = zip(*sizes, strict=True)
    return max(rows), max(columns)


def share_cut_off(density: np.ndarray, views: Sequence[View], size: tuple[int, int]) -> float:
    """The largest share of the smoke of a density (D, H, W) outside the image, (rows, columns), of one of the views.

    A cell is outside if its centre is.
    """
    box = smoke_box(density, 0)
    if box is None:
        return 0.0
    smoke, places = density[box], [(np.arange(n) - (n - 1) / 2)[s] for n, s in zip(density.shape, box, strict=True)]

    def lost(view: View) -> float:
        distance = distance_of(view)
        x, y, nearer = (
            [part * place for part, place in zip(axis[::-1], places, strict=True)] for axis in camera_frame(*view[:2])
        )
        # In perspective the image shows less of what is nearer, and nothing of what is behind the eye.
        least = 1.0 if distance is None else max(1 - _farthest(nearer) / distance, 0.0)
        outside: np.ndarray | bool = False
        for along, half in ((x, size[1] / 2), (y, size[0] / 2)):
            # Most boxes are inside as a whole.
            if _farthest(along) >= half * least:
                shown = half if distance is None else half * (1 - _summed(nearer) / distance)
                outside = outside | (np.abs(_summed(along)) > shown + 1e-6)
        return 0.0 if outside is False else float(smoke[outside].sum(dtype=np.float64))

    return max(map(lost, views)) / float(smoke.sum(dtype=np.float64))


def _summed(parts: Sequence[np.ndarray]) -> np.ndarray:
    """The sum of values that each belong to a coordinate, z, y and x, at all cells of a box."""
    return parts[0][:, None, None] + parts[1][:, None] + parts[2]


def _farthest(parts: Sequence[np.ndarray]) -> float:
    """The largest magnitude of such sums."""
    return float(sum(np.abs(part).max() for part in parts))


def _as_even_as(parity: int, size: int) -> int:
    return size + (size - parity) % 2


def _check_range(name: str, limits: tuple[float, float]) -> tuple[float, float]:
    try:
        low, high = (float(limit) for limit in limits)
    except (TypeError, ValueError):
        raise InputError(f"{name}: {limits!r} is not a pair of degrees such as (-10, 10)") from None
    if not -360.0 <= low <= high <= 360.0:
        raise InputError(f"{name}: ({low:g}, {high:g}) must be low <= high within -360 and 360 degrees")
    return low, high


def _generator(seed: int | Sequence[int]) -> np.random.Generator:
    parts = [seed] if isinstance(seed, int | np.integer) else seed
    try:
        entropy = [int(part) for part in parts if int(part) == part]
        if len(entropy) != len(parts):
            raise ValueError
        return np.random.default_rng(entropy)
    except (TypeError, ValueError):
        raise InputError(f"seed: {seed!r} must be a non-negative integer or a sequence of them") from None

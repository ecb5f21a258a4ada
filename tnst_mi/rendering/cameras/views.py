"""Camera placement: Poisson-disc sets of views, and the camera's axes for one view.

A view is (azimuth, elevation) in degrees. (0, 0) looks along -z from +z with x to the right and y up;
+azimuth moves the camera towards +x, +elevation moves it up.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tnst_mi.errors import InputError

#: (azimuth, elevation) in degrees.
View = tuple[float, float]

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


def camera_frame(azimuth: float, elevation: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the camera's right, up and towards-the-camera axes for a view given in degrees.

    Returns:
        Three orthonormal float64 vectors (x, y, z), right-handed: right × up = towards the camera. The
        viewing direction is the negative of the third.
    """
    a, e = np.radians((azimuth, elevation))
    towards_camera = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    right = np.array([np.cos(a), 0.0, -np.sin(a)])
    up = np.cross(towards_camera, right)
    # The cosine of 90° is 6e-17 in floating point; a ray meant to run along a face would cross it far away.
    return np.round(right, 15), np.round(up, 15), np.round(towards_camera, 15)


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

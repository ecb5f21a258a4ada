"""Numbers that figures are judged by, each one function of arrays."""

from __future__ import annotations

import numpy as np

from tnst_mi import velocity

#: Density below which a cell counts as empty.
EMPTY = 1e-3


def spectral_centroid(image: np.ndarray) -> float:
    """Mean spatial frequency of an image (H, W) in cycles per pixel, weighted by energy: Σ|f||F|² / Σ|F|².

    The mean of the image does not count. The smaller, the larger the structures: a wave of p pixels has 1/p. 0 for an
    image without contrast.
    """
    energy = power_spectrum(image)
    total = energy.sum()
    return float((frequencies(image.shape) * energy).sum() / total) if total > 0 else 0.0


def spread(energy: np.ndarray) -> float:
    """Root of the mean squared distance from its centre, in pixels, of an energy (H, W) of 0 or more."""
    rows, columns = np.indices(energy.shape)
    total = energy.sum(dtype=np.float64)
    centre = [(axis * energy).sum() / total for axis in (rows, columns)]
    return float(np.sqrt((((rows - centre[0]) ** 2 + (columns - centre[1]) ** 2) * energy).sum() / total))


def power_spectrum(image: np.ndarray) -> np.ndarray:
    """|F|² of an image (H, W) without its mean, in the layout of `numpy.fft.fft2`."""
    return np.abs(np.fft.fft2(image - image.mean(dtype=np.float64))) ** 2


def frequencies(shape: tuple[int, int]) -> np.ndarray:
    """|f| in cycles per pixel of every entry of `power_spectrum` for images (H, W)."""
    rows, columns = (np.fft.fftfreq(size) for size in shape)
    return np.hypot(rows[:, None], columns)


def radial_spectrum(image: np.ndarray, bins: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Mean power of an image (H, W) over rings of equal frequency, as a share of all its power.

    Returns:
        |f| in cycles per pixel at the middle of each ring up to 0.5, and the mean of `power_spectrum` in it over the
        sum of all; rings without an entry are left out.
    """
    energy = power_spectrum(image)
    ring = np.minimum((frequencies(image.shape) * 2 * bins).astype(int), bins).ravel()
    count = np.bincount(ring, minlength=bins + 1)[:bins]
    power = np.bincount(ring, energy.ravel(), minlength=bins + 1)[:bins]
    there = count > 0
    return ((np.arange(bins) + 0.5) / (2 * bins))[there], power[there] / count[there] / energy.sum()


def correlation_length(image: np.ndarray) -> float:
    """The distance in pixels at which the autocorrelation of an image (H, W), mean over directions, falls to 0.

    Of waves of one period in all directions it is 0.38 periods. The mean of the image does not count; what lies beyond
    its borders is 0.
    """
    rows, columns = image.shape
    power = np.abs(np.fft.fft2(image - image.mean(dtype=np.float64), s=(2 * rows, 2 * columns))) ** 2
    correlation = np.fft.ifft2(power).real
    distance = np.hypot(*(np.minimum(i, n - i) for i, n in zip(np.indices(power.shape), power.shape, strict=True)))
    ring = np.rint(distance).astype(int).ravel()
    profile = np.bincount(ring, correlation.ravel()) / np.maximum(np.bincount(ring), 1)
    first = int(np.argmax(profile <= 0))
    return first - 1 + float(profile[first - 1] / (profile[first - 1] - profile[first]))


def mass_change(before: np.ndarray, after: np.ndarray) -> float:
    """Σ d* / Σ d − 1."""
    return float(after.sum(dtype=np.float64) / before.sum(dtype=np.float64) - 1)


def sharpness(density: np.ndarray) -> float:
    """Mean |∂d| over all cells and axes."""
    return float(np.mean([np.abs(np.diff(density, axis=axis)).mean() for axis in range(3)]))


def made_or_removed(before: np.ndarray, after: np.ndarray) -> float:
    """What has to be made or removed to turn d into d*, relative to Σ d, if smoke may be put into any other cell.

    That is the distance of their sorted values: 0 for any flow that keeps volumes, wherever it leads.
    """
    difference = np.sort(after, axis=None) - np.sort(before, axis=None)
    return float(np.abs(difference).sum(dtype=np.float64) / before.sum(dtype=np.float64))


def appeared(before: np.ndarray, after: np.ndarray) -> float:
    """Σ d* over the cells that were empty, relative to Σ d."""
    return float(after[before < EMPTY].sum(dtype=np.float64) / before.sum(dtype=np.float64))


def relative_divergence(v: np.ndarray) -> float:
    """RMS of ∇·v over the RMS of all derivatives of v (D, H, W, 3): 0 for a curl, 1 for a gradient that fades outwards.

    Derivatives are those that the package makes velocities of potentials with.
    """
    derivatives = _derivatives(v)
    return _ratio(sum(derivatives[i][..., i] for i in range(3)), derivatives)


def relative_curl(v: np.ndarray) -> float:
    """RMS of |∇×v|, likewise: 0 for a gradient, 1 for a curl that fades outwards."""
    return _ratio(velocity(None, v, 0.0), _derivatives(v))


def cells_outside(smoke: np.ndarray, farthest: int = 24) -> np.ndarray:
    """How many cells each cell lies outside of smoke (bool, (D, H, W)): 0 in it, 1 next to it, also over corners.

    Cells that are farther than `farthest` count as that far.
    """
    distance = np.where(smoke, 0, farthest)
    reached = smoke
    for step in range(1, farthest):
        grown = reached
        for axis in range(3):
            padded = np.pad(grown, [(1, 1) if a == axis else (0, 0) for a in range(3)])
            n = grown.shape[axis]
            grown = np.logical_or.reduce([padded.take(np.arange(n) + k, axis) for k in range(3)])
        distance[grown & ~reached] = step
        reached = grown
    return distance


def _derivatives(v: np.ndarray) -> list[np.ndarray]:
    """∇v_x, ∇v_y and ∇v_z, each (D, H, W, 3)."""
    return [velocity(np.ascontiguousarray(v[..., i]), None, 1.0) for i in range(3)]


def _ratio(part: np.ndarray, derivatives: list[np.ndarray]) -> float:
    whole = sum(np.square(d, dtype=np.float64).sum() for d in derivatives)
    return float(np.sqrt(np.square(part, dtype=np.float64).sum() / whole)) if whole > 0 else 0.0


def depth_of_change(density: np.ndarray, change: np.ndarray) -> float:
    """How deep in the smoke a change lies, seen from the front: 0 is the nearest smoke, 0.5 evenly, 1 the farthest.

    The depth of a cell is the share of the smoke of its line of sight, along z, that is in front of it (half of its own
    included); the mean over the cells is weighted by change². Lines of sight without smoke do not count.

    Args:
        density: (D, H, W) of the unstylized frame.
        change: what was added to it, likewise.
    """
    total = density.sum(axis=0, dtype=np.float64)
    weight = np.where(total > 0, np.square(change, dtype=np.float64), 0)
    share = _smoke_in_front(density) / np.where(total > 0, total, 1)
    return float((weight * share).sum() / weight.sum()) if weight.any() else 0.5


def visible_share(density: np.ndarray, change: np.ndarray, gamma: float) -> float:
    """How much of a change is seen from the front: the mean transmittance to its cells, weighted by change².

    Args:
        density: (D, H, W) of the unstylized frame.
        change: what was added to it, likewise.
        gamma: extinction per unit of density and cell.
    """
    weight = np.square(change, dtype=np.float64)
    transmittance = np.exp(-gamma * _smoke_in_front(density))
    return float((weight * transmittance).sum() / weight.sum()) if weight.any() else 0.0


def _smoke_in_front(density: np.ndarray) -> np.ndarray:
    """Σ d along z from the front, at the end of the axis, to each cell's middle, likewise (D, H, W)."""
    return np.cumsum(density[::-1], axis=0, dtype=np.float64)[::-1] - density / 2


def by_phase(images: np.ndarray, period: int) -> np.ndarray:
    """Energy of images (V, H, W) by place in a lattice of period × period pixels, relative to the mean of all places.

    What does not know of the lattice gives 1 everywhere, but for chance; a checkerboard does not.
    """
    energy = [
        [np.square(images[:, row::period, column::period], dtype=np.float64).mean() for column in range(period)]
        for row in range(period)
    ]
    return np.array(energy) / np.mean(energy)


def unevenness(energy: np.ndarray) -> float:
    """Standard deviation of what `by_phase` gives, relative to its mean; 0 where nothing follows the lattice."""
    return float(energy.std() / energy.mean())

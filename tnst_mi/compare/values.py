"""Comparison of images: ours, the path tracer's and the closed form, per pixel in units of the standard error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from tnst_mi.compare.closed_form import closed_form
from tnst_mi.compare.path_tracing import PathTracer
from tnst_mi.rendering.cameras.views import View
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

#: Called with the number of paths that were traced.
Advance = Callable[[int], None]

#: Pixels are testable where the expected numbers of absorbed and escaped paths justify the normal approximation of the
#: binomial distribution: n T (1 − T) of this or more.
TESTABLE = 5.0

#: Our step is halved until the image changes by less than this many standard errors, but not below the second number.
NEGLIGIBLE, _SMALLEST_STEP = 0.1, 1 / 64

#: For values the majorant may be tight, since only derivatives need null collisions everywhere.
_VALUE_SLACK = 1.1

#: Paths per pixel of the first launch; each further one doubles their total.
_FIRST_LAUNCH = 4


@dataclass(frozen=True, eq=False)
class Comparison:
    """One view at one γ. All images are (H, W), row 0 at the top, in density × cells.

    Attributes:
        view: (azimuth, elevation) in degrees.
        gamma: extinction per unit of density and cell.
        spp: paths per pixel behind `traced`.
        step: our step in cells, at which `exact` no longer changes.
        exact: ours, quadrature "exact", with that step.
        coarse: ours, quadrature "exact", with the step of one cell that `tnst_mi.render` takes.
        paper: ours, quadrature "paper", with the step of one cell.
        traced: (1 − T)/γ with T by `prbvolpath`.
        closed: the continuous image, exact for the trilinear grid, float64.
    """

    view: View
    gamma: float
    spp: int
    step: float
    exact: np.ndarray
    coarse: np.ndarray
    paper: np.ndarray
    traced: np.ndarray
    closed: np.ndarray

    @property
    def standard_error(self) -> np.ndarray:
        """Standard deviation of `traced` if `exact` is right: √(T (1 − T)/n)/γ, since each path gives 0 or 1."""
        return _standard_error(self.exact, self.gamma, self.spp)

    @property
    def testable(self) -> np.ndarray:
        """Pixels with n T (1 − T) ≥ 5."""
        return _testable(self.exact, self.gamma, self.spp)

    @property
    def z(self) -> np.ndarray:
        """(traced − exact) in standard errors; NaN where not testable."""
        z = np.full(self.exact.shape, np.nan)
        chosen = self.testable
        z[chosen] = (self.traced - self.exact)[chosen] / self.standard_error[chosen]
        return z

    @property
    def outside(self) -> int:
        """Number of testable pixels more than three standard errors off."""
        return int((np.abs(self.z[self.testable]) > 3).sum())

    @property
    def mean_z(self) -> float:
        """Mean of z over the testable pixels; 0 where there are none."""
        return float(self.z[self.testable].mean()) if self.testable.any() else 0.0

    @property
    def untestable_difference(self) -> float:
        """max |traced − exact| over the other pixels."""
        return float(np.abs(self.traced - self.exact)[~self.testable].max(initial=0.0))

    @property
    def untestable_paths(self) -> float:
        """That difference as a number of paths."""
        return self.untestable_difference * self.gamma * self.spp

    @property
    def discretisation(self) -> float:
        """max |exact − closed| over the testable pixels, in standard errors."""
        error = np.abs(self.exact - self.closed)[self.testable] / self.standard_error[self.testable]
        return float(error.max(initial=0.0))

    @property
    def coarse_z(self) -> float:
        """max |coarse − closed| over the testable pixels, in standard errors: why the step is refined."""
        error = np.abs(self.coarse - self.closed)[self.testable] / self.standard_error[self.testable]
        return float(error.max(initial=0.0))


@dataclass(frozen=True)
class Convergence:
    """How the path tracer's error falls with the number of paths, over all views at one γ.

    Attributes:
        gamma: extinction per unit of density and cell.
        spp: numbers of paths per pixel, each twice the one before.
        error: RMS over all pixels of T by the path tracer minus that of our "exact".
        predicted: the RMS standard error from our own T.
    """

    gamma: float
    spp: tuple[int, ...]
    error: tuple[float, ...]
    predicted: tuple[float, ...]

    @property
    def slope(self) -> float:
        """Exponent fitted to error against spp; −1/2 for independent paths without bias."""
        return float(np.polyfit(np.log(self.spp), np.log(self.error), 1)[0])


def compare_values(
    density: np.ndarray,
    views: Sequence[View],
    gamma: float,
    columns: Sequence[np.ndarray],
    spp: int,
    seed: Sequence[int],
    advance: Advance,
) -> tuple[list[Comparison], Convergence]:
    """Compare the images of a density (D, H, W) at one γ, in every view; `columns` holds each view's ∫ d (H, W)."""
    tracer = PathTracer(density, views, gamma, _VALUE_SLACK)
    estimates: dict[int, np.ndarray] = {}
    escaped, traced = 0.0, 0
    for launch, count in enumerate(launches(spp, tracer.largest_launch)):
        escaped = escaped + count * tracer.transmittance(count, seed_of(*seed, launch))
        traced += count
        if traced == spp or traced & (traced - 1) == 0:
            estimates[traced] = escaped / traced
        advance(count * escaped.size)

    step, exact = refined_exact(density, views, gamma, spp)
    coarse = our_images(density, views, gamma, "exact")
    paper = our_images(density, views, gamma, "paper")
    comparisons = [
        Comparison(
            view,
            gamma,
            spp,
            step,
            exact[i],
            coarse[i],
            paper[i],
            (1 - estimates[spp][i]) / gamma,
            closed_form(columns[i], gamma),
        )
        for i, view in enumerate(views)
    ]
    counts = tuple(count for count in estimates if count >= _FIRST_LAUNCH)
    ours = 1 - gamma * exact
    error = tuple(float(np.sqrt(np.mean((estimates[count] - ours) ** 2))) for count in counts)
    predicted = tuple(float(np.sqrt(np.mean((gamma * _standard_error(exact, gamma, n)) ** 2))) for n in counts)
    return comparisons, Convergence(gamma, counts, error, predicted)


def refined_exact(density: np.ndarray, views: Sequence[View], gamma: float, spp: int) -> tuple[float, np.ndarray]:
    """Step, halved from one cell until no testable pixel changes by 0.1 standard errors, and the images."""
    step, images = 1.0, our_images(density, views, gamma, "exact")
    while step > _SMALLEST_STEP:
        finer = our_images(density, views, gamma, "exact", step / 2)
        testable = _testable(finer, gamma, spp)
        change = np.abs(finer - images)[testable] / _standard_error(finer, gamma, spp)[testable]
        step, images = step / 2, finer
        if change.max(initial=0.0) < NEGLIGIBLE:
            break
    return step, images


def our_images(
    density: np.ndarray, views: Sequence[View], gamma: float, quadrature: str, step: float = 1.0
) -> np.ndarray:
    """Our images (V, H, W) of a density, float64."""
    renderer = EmissionAbsorptionRenderer(density.shape, gamma, quadrature, 1.0, step)
    return renderer.render(mi.TensorXf(density), views).numpy().astype(np.float64)


def launches(spp: int, largest: int) -> list[int]:
    """Split a number of paths per pixel into launches whose running totals double, up to the largest launch."""
    counts = []
    while (traced := sum(counts)) < spp:
        counts.append(min(max(traced, _FIRST_LAUNCH), _power_of_two(largest), spp - traced))
    return counts


def seed_of(*numbers: int) -> int:
    """One 32-bit seed from the numbers that identify a launch."""
    return int(np.random.SeedSequence(numbers).generate_state(1)[0])


def relative_rms(image: np.ndarray, reference: np.ndarray) -> float:
    """RMS of the difference over the RMS of the reference."""
    return float(np.sqrt(np.mean((image - reference) ** 2) / np.mean(reference**2)))


def _power_of_two(number: int) -> int:
    return 1 << (number.bit_length() - 1)


def _standard_error(exact: np.ndarray, gamma: float, spp: int) -> np.ndarray:
    transmittance = np.clip(1 - gamma * exact, 0.0, 1.0)
    return np.sqrt(transmittance * (1 - transmittance) / spp) / gamma


def _testable(exact: np.ndarray, gamma: float, spp: int) -> np.ndarray:
    return (gamma * _standard_error(exact, gamma, spp)) ** 2 * spp**2 >= TESTABLE

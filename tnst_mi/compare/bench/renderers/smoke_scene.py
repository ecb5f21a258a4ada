"""One frame of smoke for either side: the same grid, rays and units, whoever renders it.

Smoke that does not scatter is shown as emission and absorption, I = (1 − T)/γ, of which path tracers find the
transmittance T in front of a white sky; see docs/physics.md. Smoke that scatters is shown in the light of emitters,
which path tracers alone can do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from tnst_mi.compare.bench.renderers.renderer import SideRenderer
from tnst_mi.compare.bench.renderers.sides import OURS, Side
from tnst_mi.compare.bench.renderers.variants import SPECTRAL_WHITE
from tnst_mi.compare.closed_form import closed_form, column_density
from tnst_mi.compare.inclusive_sum import inclusive_sums
from tnst_mi.compare.path_tracing import smoke_region
from tnst_mi.compare.values import our_images
from tnst_mi.errors import InputError
from tnst_mi.rendering.cameras.perspective import require_outside
from tnst_mi.rendering.cameras.views import View
from tnst_mi.rendering.scattering import load_light
from tnst_mi.rendering.scene import scene_description

#: Ratio of the majorant to the largest extinction: derivatives need the null collisions between them.
_SLACK = 2.0

#: In cells.
_SMALLEST_STEP = 1 / 64

#: Scatterings of a path, at most, where smoke scatters.
_DEPTH = 64


@dataclass(frozen=True, eq=False)
class SmokeScene:
    """What is rendered.

    Attributes:
        density: (D, H, W) float32, finite, ≥ 0, somewhere > 0.
        views: orthographic or in perspective; see `rendering.cameras.views`.
        albedo: scattered share of the extinguished light, 0 to 1.
        anisotropy: mean cosine g of the phase function, above −1 and below 1.
        light: scene file of the emitters; None where nothing is scattered.
    """

    density: np.ndarray
    views: tuple[View, ...]
    albedo: float = 0.0
    anisotropy: float = 0.0
    light: Path | None = None

    @property
    def scatters(self) -> bool:
        """Whether light is scattered."""
        return self.albedo > 0


def smoke_renderer(smoke: SmokeScene, gamma: float, side: Side, tolerance: float) -> SideRenderer:
    """The renderer of an integrator's side, at extinction γ per unit of density and cell.

    Args:
        smoke: what it renders.
        gamma: γ.
        side: ours or one of the path tracers.
        tolerance: difference that does not count, relative to the RMS of a view, below which the step of "exact" is
            refined.

    Raises:
        InputError: ours is to scatter, the eye of a view is in the grid, or the light's file cannot be used.
    """
    require_outside(smoke.views, smoke.density.shape, 1.0, "compare")
    if side.kind == OURS:
        return _ours(smoke, gamma, side, tolerance)
    description = _description(smoke, gamma, "exact", 1.0)
    description["integrator"] = {"type": side.kind, "max_depth": _DEPTH, "hide_emitters": smoke.scatters}
    if smoke.light is None:
        # The spectrum that ours emits: a plain number would be daylight in spectral variants.
        description["environment"] = {"type": "constant", "radiance": {"type": "uniform", "value": 1.0}}
        renderer = _renderer(description, smoke.views, False, 1 / gamma, -1 / gamma)
        # A path passes or does not; in spectral variants, with wavelengths that count differently.
        return renderer if mi.is_spectral else replace(renderer, brightest=1.0)
    # The scene keeps the emitters alive, of which some refer to the one that they were loaded with.
    emitters = load_light(smoke.light).emitters()
    description |= {f"light_{index}": emitter for index, emitter in enumerate(emitters)}
    return _renderer(description, smoke.views, False)


def float64_images(smoke: SmokeScene, gamma: float, quadrature: str) -> tuple[np.ndarray, np.ndarray]:
    """The images (V, H, W, 1) by float64 references apart from all renderers, and by how much float32 may differ.

    "exact" is the closed form of the continuous integral, "paper" the inclusive sum on the samples of the conventions.
    """
    if quadrature == "exact":
        images = np.stack([closed_form(column_density(smoke.density, view), gamma) for view in smoke.views])
        return images[..., None], np.zeros_like(images)[..., None]
    sums = [inclusive_sums(smoke.density, view, [gamma])[0] for view in smoke.views]
    middle = np.stack([(found.lower + found.upper) / 2 for found in sums])
    slack = np.stack([(found.upper - found.lower) / 2 + found.tolerance for found in sums])
    return middle[..., None], slack[..., None]


def _ours(smoke: SmokeScene, gamma: float, side: Side, tolerance: float) -> SideRenderer:
    if smoke.scatters:
        raise InputError(
            f"{side.text} with --albedo {smoke.albedo:g}: it does not scatter, expected --albedo 0 or path tracers"
        )
    step, change = (1.0, 0.0) if side.quadrature == "paper" else _refined_step(smoke, gamma, tolerance)
    # Opacity is γ times the image.
    factor = 1 / gamma if side.quadrature == "transmittance" else 1.0
    renderer = _renderer(_description(smoke, gamma, side.quadrature, step), smoke.views, True, factor=factor)
    if change < tolerance / 4:
        return renderer
    return replace(
        renderer,
        remark=f"{side.text} at γ {gamma:g} more precisely than {change:.1g} of the RMS: a pixel still changes by that "
        f"at its smallest step, 1/{1 / step:.0f} of a cell, as where smoke is cut at a wall of its grid",
    )


def _refined_step(smoke: SmokeScene, gamma: float, tolerance: float) -> tuple[float, float]:
    """The step, halved from one cell until no pixel changes by a quarter of what does not count, and that change,
    relative to the RMS of its view."""
    step, change, images = 1.0, 0.0, our_images(smoke.density, smoke.views, gamma, "exact")
    while step > _SMALLEST_STEP:
        finer = our_images(smoke.density, smoke.views, gamma, "exact", step / 2)
        size = np.sqrt(np.mean(finer**2, axis=(1, 2)))
        # A view may show nothing at all.
        change = float((np.abs(finer - images).max((1, 2)) / np.where(size > 0, size, 1.0)).max())
        step, images = step / 2, finer
        if change < tolerance / 4:
            break
    return step, change


def _description(smoke: SmokeScene, gamma: float, quadrature: str, step: float) -> dict[str, Any]:
    """A scene without emitters, whose integrator is ours; its medium ends two cells outside the smoke."""
    shape = smoke.density.shape
    region = smoke_region(smoke.density)
    if quadrature == "paper":
        # Samples at the walls of the grid's box count in its sum: the box is the whole one.
        region = tuple(slice(0, n) for n in shape)
    extinction = np.ascontiguousarray(gamma * smoke.density[region], np.float32)
    description = scene_description(shape, gamma, quadrature, 1.0, len(smoke.views), step)
    description["sensor"] |= {"through_centres": True, "sampler": {"type": "independent"}}
    placed = scene_description(extinction.shape, gamma, quadrature, 1.0, 1)["smoke"]
    medium = placed["interior"]
    medium["albedo"] = smoke.albedo
    medium["phase"] = {"type": "hg", "g": smoke.anisotropy} if smoke.scatters else {"type": "isotropic"}
    grid = medium["sigma_t"]
    grid["grid"] = mi.VolumeGrid(extinction[..., None])
    grid["max_value"] = _SLACK * float(extinction.max())
    offset = [(part.start + part.stop - size) / 2 for part, size in zip(region, shape, strict=True)]
    for part in (placed, grid):
        part["to_world"] = mi.ScalarTransform4f().translate(offset[::-1]) @ part["to_world"]
    return description | {"smoke": placed}


def _renderer(
    description: dict[str, Any], views: Sequence[View], exact: bool, offset: float = 0.0, factor: float = 1.0
) -> SideRenderer:
    scene = mi.load_dict(description)
    scene.sensors()[0].set_views(views)
    # Wavelengths are random, even where paths are not.
    free_of_noise = exact and not mi.is_spectral
    white = SPECTRAL_WHITE if mi.is_spectral else 1.0
    return SideRenderer(scene, scene.integrator(), len(views), free_of_noise, not exact, offset, factor / white)

"""The Mitsuba scene of one grid, and the public `render` function.

World units are full-resolution cells; the grid's centre is the origin. The density becomes the extinction σ_t = γ d
of a `heterogeneous` medium, and the `emission_absorption` plugin renders it.
"""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.arrays import any_array_kind
from tnst_mi.errors import InputError
from tnst_mi.grid import Shape, opaque_int
from tnst_mi.quadrature import QUADRATURES

#: (azimuth, elevation) in degrees.
View = tuple[float, float]

_DENSITY = "smoke.interior_medium.sigma_t.data"
_SCALE = "smoke.interior_medium.scale"

#: Majorant of the medium. This integrator needs none; a fixed one spares Mitsuba from reading the
#: maximum back to the host after each change of the density.
_MAJORANT = 1e6


def scene_description(
    shape: Shape, gamma: float, quadrature: str, h: float, view_count: int, step: float | None = None
) -> dict[str, object]:
    """The scene as a dictionary for `mi.load_dict`: box, medium, sensor and integrator (density still 0).

    Arguments as in `GridScene`.
    """
    d, rows, columns = shape
    half = (columns * h / 2, rows * h / 2, d * h / 2)
    to_world = mi.ScalarTransform4f()
    return {
        "type": "scene",
        "integrator": {"type": "emission_absorption", "gamma": gamma, "quadrature": quadrature, "step": step or h},
        "sensor": {
            "type": "orthographic_views",
            "view_count": view_count,
            "spacing": h,
            "distance": 2 * math.hypot(*half) + h,
            "film": {
                "type": "hdrfilm",
                "width": columns,
                "height": rows * view_count,
                "pixel_format": "luminance",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
            # One sample at the centre of each pixel: the image is free of noise.
            "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
        },
        "smoke": {
            "type": "cube",
            "to_world": to_world.scale(half),
            "bsdf": {"type": "null"},
            "interior": {
                "type": "heterogeneous",
                "albedo": 0.0,
                "sigma_t": {
                    "type": "gridvolume",
                    "grid": mi.VolumeGrid(np.zeros((d, rows, columns, 1), np.float32)),
                    # gridvolume fills the unit cube [0, 1]³.
                    "to_world": to_world.scale([2 * x for x in half]).translate(-0.5),
                    "max_value": _MAJORANT,
                    "accel": False,
                },
            },
        },
    }


class GridScene:
    """A loaded scene for grids of one size, to be rendered many times with other densities and views.

    Args:
        shape: (D, H, W) of the grid.
        gamma: ratio γ of extinction to density, per full-resolution cell.
        quadrature: "paper", "exact" or "transmittance".
        h: size of a cell in full-resolution cells.
        view_count: number of views rendered in one launch.
        step: distance between the samples of a ray in full-resolution cells; h where None.
    """

    def __init__(
        self, shape: Shape, gamma: float, quadrature: str, h: float, view_count: int, step: float | None = None
    ) -> None:
        self.shape, self.gamma, self.view_count = shape, gamma, view_count
        self.scene = mi.load_dict(scene_description(shape, gamma, quadrature, h, view_count, step))
        self.parameters = mi.traverse(self.scene)
        self.sensor = self.scene.sensors()[0]

    #: Samples per pixel: one at its centre.
    spp = 1

    def with_gamma(self, gamma: float) -> GridScene:
        """This very scene, once loaded, for another γ."""
        scene = copy.copy(self)
        scene.gamma = gamma
        return scene

    def reseed(self, seed: Sequence[int]) -> None:
        """Start the random numbers that belong to some whole numbers ≥ 0; there is nothing random here."""

    def next_seed(self) -> int:
        """Seed of the next pass."""
        return 0

    def render(self, density: mi.TensorXf, views: Sequence[View]) -> mi.TensorXf:
        """Images (V, H, W) of a density (D, H, W), differentiable in the density; row 0 is at the top."""
        return dr.custom(_RenderViews, density, self, tuple(views))

    def show(self, density: mi.TensorXf, views: Sequence[View]) -> None:
        """Put a density (D, H, W) and a set of views into the scene."""
        self.scene.integrator().gamma = self.gamma
        self.place(density, views)

    def place(self, density: mi.TensorXf, views: Sequence[View]) -> None:
        """As `show`, with whatever γ the integrator has."""
        self.sensor.set_views(views)
        # σ_t = γ d without a copy: the medium's scale is γ.
        self.parameters[_SCALE] = self.gamma
        self.parameters[_DENSITY] = mi.TensorXf(density.array, (*self.shape, 1))
        self.parameters.update()

    def image(self) -> mi.TensorXf:
        """What the views show, (V, H, W)."""
        return mi.TensorXf(self._sample(dr.ADMode.Primal, 0, self.view_count), (self.view_count, *self.shape[1:]))

    def back_project(self, images: mi.TensorXf, image_gradient: mi.TensorXf) -> None:
        """Accumulate a gradient (V, H, W) with respect to `image`, which gave `images`, in that of the density."""
        _, rows, columns = self.shape
        pixels = dr.arange(mi.UInt32, rows * columns)
        # View by view, since the adjoint of every sample of a view is stored.
        for view in range(self.view_count):
            pixel = pixels + mi.UInt32(opaque_int(view * rows * columns))
            L, δL = (dr.gather(mi.Float, image.array, pixel) for image in (images, image_gradient))
            parallel = self.sensor.parallel_rays(view)
            self._sample(dr.ADMode.Backward, view, 1, state_in=L, δL=mi.Spectrum(δL, 0, 0), parallel=parallel)

    def _sample(self, mode: dr.ADMode, first_view: int, count: int, **arguments: object) -> mi.Float:
        """Call the integrator for the rays through all pixel centres of some views, without the detour of a film."""
        ray = self.sensor.pixel_rays(first_view, count)
        arguments = {"state_in": None, "δL": None} | arguments
        L = self.scene.integrator().sample(mode, self.scene, None, ray, active=mi.Bool(True), **arguments)[0]
        return L[0]


class _RenderViews(dr.CustomOp):
    """density → images. A scene holds one density and one γ at a time: each pass first puts its own back."""

    def eval(self, density: mi.TensorXf, scene: GridScene, views: tuple[View, ...]) -> mi.TensorXf:
        self.density, self.scene, self.views = density, scene, views
        with dr.suspend_grad():
            scene.show(density, views)
            self.images = scene.image()
        # The adjoint needs them again, and must not have to march for them.
        dr.eval(self.images)
        return self.images

    def _attached_density(self) -> mi.TensorXf:
        density = dr.detach(self.density)
        dr.enable_grad(density)
        self.scene.show(density, self.views)
        return self.scene.parameters[_DENSITY]

    def forward(self) -> None:
        scene = self.scene
        with dr.resume_grad():
            density = self._attached_density()
            dr.set_grad(density, mi.TensorXf(self.grad_in("density").array, tuple(density.shape)))
            image = scene.scene.integrator().render_forward(scene.scene, scene.parameters, scene.sensor, spp=1)
        self.set_grad_out(mi.TensorXf(image.array, (scene.view_count, *scene.shape[1:])))

    def backward(self) -> None:
        scene, image_gradient = self.scene, self.grad_out()
        with dr.resume_grad():
            density = self._attached_density()
            with dr.suspend_grad():
                scene.back_project(self.images, image_gradient)
            gradient = dr.grad(density).array
        self.set_grad_in("density", mi.TensorXf(gradient, scene.shape))

    def name(self) -> str:
        return "render views"


def grid_scene(
    shape: Shape, gamma: float, quadrature: str, h: float, view_count: int, step: float | None = None
) -> GridScene:
    """A `GridScene`, taken from a small cache: loading one is slow, and Mitsuba does not give back all its memory."""
    return _cached_scene(mi.variant(), shape, quadrature, h, view_count, step).with_gamma(gamma)


@functools.lru_cache(maxsize=6)
def _cached_scene(variant: str, shape: Shape, quadrature: str, *arguments: object) -> GridScene:
    return GridScene(shape, 1.0, quadrature, *arguments)


@any_array_kind("density")
def render(
    density: mi.TensorXf,
    view: View | Sequence[View] = (0.0, 0.0),
    gamma: float = 0.1,
    quadrature: str = "paper",
    h: float = 1.0,
) -> mi.TensorXf:
    """Render a density as emitting and absorbing smoke (paper Eq. 11), orthographically.

    Emission is the density d, extinction γ d. The view (0, 0) looks along −z from +z with x to the right and y up;
    positive azimuth moves the camera towards +x, positive elevation moves it up. The rotation is rigid, about the
    centre of the grid.

    Args:
        density: (D, H, W), finite and ≥ 0, which is not checked; 0 outside the grid.
        view: (azimuth, elevation) in degrees, or a sequence of V such pairs.
        gamma: γ > 0, extinction per unit of density and full-resolution cell.
        quadrature: "paper" (inclusive sum), "exact" or "transmittance" (= γ · exact).
        h: size of a cell in full-resolution cells, > 0; also the pixel spacing and the step.

    Returns:
        Image (H, W), or (V, H, W) for a sequence of views, row 0 at the top, in the array kind given. "exact" and
        "paper" are in density × cells, below 1/γ; "transmittance" is in [0, 1). Differentiable in the density.

    Raises:
        InputError: an argument has another shape or range than stated.
    """
    angles = np.asarray(view, dtype=np.float64)
    if angles.ndim not in (1, 2) or angles.shape[-1] != 2 or not angles.size or not np.isfinite(angles).all():
        raise InputError(
            f"render: view {view!r} given, expected (azimuth, elevation) in degrees or a list of such pairs"
        )
    if len(density.shape) != 3 or 0 in density.shape:
        raise InputError(f"render: density of shape {tuple(density.shape)} given, expected (D, H, W), none of them 0")
    if quadrature not in QUADRATURES:
        raise InputError(f"render: quadrature {quadrature!r} is unknown, expected one of {', '.join(QUADRATURES)}")
    if not (0 < gamma < math.inf and 0 < h < math.inf):
        raise InputError(f"render: gamma {gamma} and h {h} given, expected finite numbers > 0")
    views = [(float(a), float(e)) for a, e in angles.reshape(-1, 2)]
    scene = grid_scene(tuple(density.shape), float(gamma), quadrature, float(h), len(views))
    images = scene.render(density, views)
    return images if angles.ndim == 2 else mi.TensorXf(images.array, tuple(density.shape)[1:])

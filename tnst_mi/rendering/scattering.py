"""Smoke that scatters light instead of emitting it, path traced. A recipe can choose it to drive a stylization, to
study what the paper's emission–absorption model omits.

World units, views and the smoke's box are as in `scene`, and rays go through the centres of pixels, as those of other
renderers; pixels are black where no light is scattered into the view.

The pictures are those of Mitsuba's `prbvolpath`, but only a part of them is left to random paths: light that is
scattered once is summed up (`single_scattering`), if it comes from far away and is scattered evenly, and the derivative
of the rest is that of paths which do not avoid thin smoke (`scattered_light`). docs/physics.md says what that does to
the noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.machine.optix import require_optix
from tnst_mi.rendering.cameras.camera import Viewpoint
from tnst_mi.rendering.cameras.perspective import require_outside
from tnst_mi.rendering.renderer import Renderer
from tnst_mi.rendering.scene import scene_description, view_distance
from tnst_mi.rendering.shadows import beside_smoke, draw_lights
from tnst_mi.rendering.single_scattering import SingleScattering

_DENSITY = "smoke.interior_medium.sigma_t.data"
_SCALE = "smoke.interior_medium.scale"

_MAX_DEPTH = 32
_RUSSIAN_ROULETTE_DEPTH = 8

_LEAST_SLACK = 1.5
"""Smallest ratio of the majorant to the largest extinction. At 1 the derivatives of `prbvolpath` are wrong: they rely
on null collisions, of which there are none where the smoke is densest."""

_LEAST_MAJORANT = 1 / 16
"""Proposed collisions per full-resolution cell, at least."""

_FORCED_COLLISIONS = 2.0
"""How many collisions a path through a grid of thin smoke has on average for the sake of the derivative alone. With
more, there is less noise in thin smoke; but weights grow like the exponential of it."""

_FAINTEST = 1e-3
"""In parts of the largest density, that of cells beside smoke in the derivative's paths. Where there is none at all, no
path is scattered, and what more smoke would scatter there would be left out of the derivative."""


@dataclass(frozen=True)
class Lighting:
    """How the smoke scatters, and what light falls on it.

    Attributes:
        albedo: fraction of the extinguished light that is scattered, 0 to 1.
        anisotropy: mean cosine g of the Henyey-Greenstein phase function, -1 to 1 exclusive; 0 is isotropic.
        light: Mitsuba scene file that provides the emitters.
        spp: paths per pixel.
    """

    albedo: float
    anisotropy: float
    light: Path
    spp: int


class ScatteringRenderer(Renderer):
    """Path-traced smoke that scatters light: each seed has its own noise, and so has the derivative.

    Args:
        shape: (D, H, W) of the grid.
        gamma: ratio γ of extinction to density, per full-resolution cell.
        h: size of a cell in full-resolution cells.
        lighting: the smoke's scattering and its light.
        size: rows and columns of the images; those of the grid if None.
        pixel: distance between pixels in full-resolution cells; h if None.

    Raises:
        InputError: the light's file cannot be used, or a GPU lacks OptiX.
    """

    def __init__(
        self,
        shape: Shape,
        gamma: float,
        h: float,
        lighting: Lighting,
        size: tuple[int, int] | None = None,
        pixel: float | None = None,
    ) -> None:
        require_optix("--integrator prbvolpath")
        self.size, self.pixel = size or shape[1:], pixel or h
        self.shape, self.gamma, self.h, self.lighting = shape, gamma, h, lighting
        # Kept alive: emitters refer to the scene that they were loaded with.
        self._light = load_light(lighting.light)
        #: Light that is scattered once, where it comes from far away and is scattered evenly.
        self._once: SingleScattering | None = None
        near = any(mi.has_flag(light.flags(), mi.EmitterFlags.DeltaPosition) for light in self._light.emitters())
        if not near and not lighting.anisotropy:
            self._once = SingleScattering(shape, gamma, h, lighting.albedo, self.size, self.pixel)
        #: Loaded scenes by number of views.
        self._scenes: dict[int, _LoadedScene] = {}

    def render(self, density: mi.TensorXf, views: Sequence[Viewpoint], seed: Sequence[int] = (0,)) -> mi.TensorXf:
        """See `Renderer`.

        Raises:
            InputError: a camera is inside the grid.
        """
        require_outside(views, self.shape, self.h, "prbvolpath")
        return super().render(density, views, seed)

    def images(self, density: mi.TensorXf, views: Sequence[Viewpoint], seed: Sequence[int]) -> mi.TensorXf:
        """The images (V, H, W) of the views, without derivatives."""
        loaded = self._show(density, views)
        seeds = _seeds(seed)
        image = loaded.scene.integrator().render(
            loaded.scene, loaded.sensor, seed=seeds.image, spp=self.lighting.spp, evaluate=False
        )
        images = mi.TensorXf(image.array, (len(views), *self.size))
        if self._once is None:
            return images
        return images + self._once.images(
            density, views, draw_lights(loaded.scene, seeds.image_lights, self.lighting.spp)
        )

    def gradient(
        self,
        density: mi.TensorXf,
        views: Sequence[Viewpoint],
        seed: Sequence[int],
        images: mi.TensorXf,
        image_gradient: mi.TensorXf,
    ) -> mi.TensorXf:
        """An estimate of the gradient (D, H, W) with respect to the density, from independent paths."""
        rows, columns = self.size
        seeds = _seeds(seed)
        with dr.resume_grad():
            σ_t = self._scattering_everywhere(dr.detach(density))
            dr.enable_grad(σ_t)
            loaded = self._show(σ_t, views)
            of_film = mi.TensorXf(image_gradient.array, (len(views) * rows, columns, 1))
            with dr.suspend_grad():
                loaded.differentiated.render_backward(
                    loaded.scene,
                    loaded.parameters,
                    of_film,
                    loaded.sensor,
                    seed=seeds.derivative,
                    spp=self.lighting.spp,
                )
            gradient = mi.TensorXf(dr.grad(loaded.parameters[_DENSITY]).array, self.shape)
        if self._once is None:
            return gradient
        lights = draw_lights(loaded.scene, seeds.derivative_lights, self.lighting.spp)
        return gradient + self._once.gradient(density, views, lights, image_gradient)

    def _show(self, density: mi.TensorXf, views: Sequence[Viewpoint]) -> _LoadedScene:
        """A scene with this density and these views, and a majorant above the largest extinction."""
        largest = self.gamma * float(dr.max(dr.detach(density), axis=None).array[0])
        # It follows from the density alone, and so do the paths. Powers of two: a scene serves many densities.
        majorant = 2.0 ** math.ceil(math.log2(max(_LEAST_SLACK * largest, _LEAST_MAJORANT)))
        count = len(views)
        loaded = self._scenes.get(count)
        if loaded is None or loaded.majorant != majorant:
            loaded = self._scenes[count] = self._load(count, majorant)
        loaded.sensor.set_views(views)
        # σ_t = γ d without a copy: the medium's scale is γ.
        loaded.parameters[_SCALE] = self.gamma
        loaded.parameters[_DENSITY] = mi.TensorXf(density.array, (*self.shape, 1))
        loaded.parameters.update()
        return loaded

    def _load(self, view_count: int, majorant: float) -> _LoadedScene:
        lighting = self.lighting
        description = scene_description(self.shape, self.gamma, "exact", self.h, view_count, size=self.size)
        description["sensor"] |= {"spacing": self.pixel, "through_centres": True}
        description["integrator"], differentiated = self._integrators(majorant)
        description["sensor"]["sampler"] = {"type": "independent"}
        medium = description["smoke"]["interior"]
        medium["albedo"] = lighting.albedo
        medium["phase"] = {"type": "hg", "g": lighting.anisotropy} if lighting.anisotropy else {"type": "isotropic"}
        # Mitsuba multiplies it by the medium's scale, which is γ.
        medium["sigma_t"]["max_value"] = majorant / self.gamma
        emitters = {f"light_{index}": emitter for index, emitter in enumerate(self._light.emitters())}
        scene = mi.load_dict(description | emitters)
        return _LoadedScene(scene, mi.traverse(scene), scene.sensors()[0], mi.load_dict(differentiated), majorant)

    def _integrators(self, majorant: float) -> tuple[dict[str, Any], dict[str, Any]]:
        """What traces the paths of images and of derivatives."""
        traced = {
            "type": "scattered_light",
            "max_depth": _MAX_DEPTH,
            "rr_depth": _RUSSIAN_ROULETTE_DEPTH,
            "first_order": 1 if self._once is None else 2,
        }
        through_all = majorant * view_distance(self.shape, self.h)
        return traced, traced | {"floor": min(_FORCED_COLLISIONS / through_all, 0.5)}

    def _scattering_everywhere(self, density: mi.TensorXf) -> mi.TensorXf:
        """The density (D, H, W) in whose smoke the paths of derivatives collide: a little more beside smoke."""
        # Where there is no smoke at all, a thousandth of what would be opaque.
        opaque_density = 1 / (self.gamma * view_distance(self.shape, self.h))
        largest = dr.max(density.array)
        faintest = _FAINTEST * dr.select(largest > 0, largest, opaque_density)
        faintest = dr.select(beside_smoke(density.array, self.shape), faintest, 0)
        return mi.TensorXf(dr.maximum(density.array, faintest), self.shape)


@dataclass(frozen=True)
class _LoadedScene:
    scene: mi.Scene
    parameters: mi.SceneParameters
    sensor: mi.Sensor
    differentiated: mi.ad.integrators.common.RBIntegrator
    majorant: float


class _Seeds(NamedTuple):
    image: int
    derivative: int
    image_lights: int
    derivative_lights: int


def _seeds(seed: Sequence[int]) -> _Seeds:
    """Different seeds for images and derivatives, which share no random numbers."""
    return _Seeds(*np.random.default_rng(list(seed)).integers(1 << 32, size=4).tolist())


def load_light(path: Path) -> mi.Scene:
    """Load a Mitsuba scene file for its emitters, which must surround a scene: directional, constant or envmap.

    Raises:
        InputError: the file cannot be read, has no emitter, or one that belongs to a shape.
    """
    try:
        scene = mi.load_file(str(path))
    except Exception as error:  # Mitsuba's parser and plugins raise RuntimeError, TypeError, …, on many lines
        reason = str(error).strip().splitlines()
        raise InputError(f"{path}: cannot be read as a Mitsuba scene ({reason[0] if reason else error})") from None
    if not scene.emitters():
        raise InputError(f"{path}: the scene has no emitter, expected a directional, constant or envmap one")
    for emitter in scene.emitters():
        if mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface):
            raise InputError(
                f"{path}: an emitter belongs to a shape, expected directional, constant or envmap emitters only"
            )
    return scene

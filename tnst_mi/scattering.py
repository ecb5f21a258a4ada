"""Smoke that scatters light instead of emitting it, path traced by Mitsuba's `prbvolpath`: what drives a stylization
when its recipe says so, to see what the paper's emission–absorption leaves out.

World units, the views and the smoke's box are those of `scene`; black is where no light is scattered into the view.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.grid import Shape
from tnst_mi.scene import GridScene, View, scene_description

_MAX_DEPTH = 32
_RUSSIAN_ROULETTE_DEPTH = 8

_SLACK = 2.0
"""Majorant over the largest extinction when a scene is loaded. At 1 the derivatives of `prbvolpath` are wrong: they are
carried by null collisions, of which there are none where the smoke is densest."""

_LEAST_SLACK = 1.1
"""Slack below which the scene is loaded again with a larger majorant."""


@dataclass(frozen=True)
class Lighting:
    """How the smoke scatters, and what light falls on it.

    Attributes:
        albedo: scattered share of the extinguished light, 0 to 1.
        anisotropy: mean cosine g of Henyey and Greenstein's phase function, -1 to 1 exclusive; 0 scatters evenly.
        light: Mitsuba scene file of which the emitters are taken.
        spp: paths per pixel.
    """

    albedo: float
    anisotropy: float
    light: Path
    spp: int


class ScatteringScene(GridScene):
    """A scene like `GridScene`, path traced: each image has new noise, and so has each derivative.

    Args:
        shape: (D, H, W) of the grid.
        gamma: ratio γ of extinction to density, per full-resolution cell.
        h: size of a cell in full-resolution cells.
        view_count: number of views rendered in one launch.
        lighting: the smoke's scattering and its light.

    Raises:
        InputError: the light's file cannot be used.
    """

    def __init__(self, shape: Shape, gamma: float, h: float, view_count: int, lighting: Lighting) -> None:
        self.shape, self.gamma, self.view_count, self.spp = shape, gamma, view_count, lighting.spp
        self._h, self._lighting = h, lighting
        self._majorant = 0.0
        self.reseed([0])
        self._load(1.0)

    def reseed(self, seed: Sequence[int]) -> None:
        """Start the sequence of seeds that belongs to some whole numbers ≥ 0, such as the run's and the iteration's."""
        self._seeds = np.random.default_rng(seed)

    def next_seed(self) -> int:
        """A seed for the next pass, unlike that of any other: primal and adjoint share no random numbers."""
        return int(self._seeds.integers(1 << 32))

    def show(self, density: mi.TensorXf, views: Sequence[View]) -> None:
        """Put a density (D, H, W) and a set of views into the scene."""
        largest = self.gamma * float(dr.max(dr.detach(density), axis=None).array[0])
        if _LEAST_SLACK * largest > self._majorant:
            self._load(_SLACK * largest)
        self.place(density, views)

    def image(self) -> mi.TensorXf:
        """What the views show, (V, H, W)."""
        image = self.scene.integrator().render(
            self.scene, self.sensor, seed=self.next_seed(), spp=self.spp, evaluate=False
        )
        return mi.TensorXf(image.array, (self.view_count, *self.shape[1:]))

    def back_project(self, images: mi.TensorXf, image_gradient: mi.TensorXf) -> None:
        """Accumulate a gradient (V, H, W) with respect to `image` in that of the density, along paths of its own."""
        _, rows, columns = self.shape
        gradient = mi.TensorXf(image_gradient.array, (self.view_count * rows, columns, 1))
        self.scene.integrator().render_backward(
            self.scene, self.parameters, gradient, self.sensor, seed=self.next_seed(), spp=self.spp
        )

    def _load(self, majorant: float) -> None:
        lighting = self._lighting
        description = scene_description(self.shape, self.gamma, "exact", self._h, self.view_count)
        description["integrator"] = {
            "type": "prbvolpath",
            "max_depth": _MAX_DEPTH,
            "rr_depth": _RUSSIAN_ROULETTE_DEPTH,
            "hide_emitters": True,
        }
        description["sensor"]["sampler"] = {"type": "independent"}
        medium = description["smoke"]["interior"]
        medium["albedo"] = lighting.albedo
        medium["phase"] = {"type": "hg", "g": lighting.anisotropy} if lighting.anisotropy else {"type": "isotropic"}
        # Mitsuba multiplies it by the medium's scale, which is γ.
        medium["sigma_t"]["max_value"] = majorant / self.gamma
        # Kept: emitters refer to the scene that they were loaded with.
        self._light = load_light(lighting.light)
        emitters = {f"light_{index}": emitter for index, emitter in enumerate(self._light.emitters())}
        self.scene = mi.load_dict(description | emitters)
        self.parameters = mi.traverse(self.scene)
        self.sensor = self.scene.sensors()[0]
        self._majorant = majorant


def load_light(path: Path) -> mi.Scene:
    """A Mitsuba scene file, for its emitters, which must surround a scene: directional, constant or envmap.

    Raises:
        InputError: the file cannot be read, has no emitter, or one that belongs to a shape.
    """
    try:
        scene = mi.load_file(str(path))
    except Exception as error:  # Mitsuba's parser and plugins raise RuntimeError, TypeError, …, in many lines
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

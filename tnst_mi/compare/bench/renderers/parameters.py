"""What images are differentiated with respect to, and how a Mitsuba scene is changed along it.

extinction  a factor of all extinctions, at 1       albedo      added to all albedos
anisotropy  added to the mean cosine g of all       sensor      the sensor moved along x, in world units
            Henyey-Greenstein phase functions
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError

PARAMETERS = ("extinction", "albedo", "anisotropy", "sensor")

#: Keys of a scene's parameters.
_KEYS = {
    "extinction": re.compile(r"(^|\.)sigma_t\.(value\.)*(value|data)$"),
    "albedo": re.compile(r"(^|\.)albedo\.(value\.)*(value|data)$"),
    "anisotropy": re.compile(r"(^|\.)phase_function\.g$"),
}

#: Steps of central differences; that of the sensor relative to the diagonal of the media, of which a scene's ground may
#: be far larger.
_STEPS = {"extinction": 0.05, "albedo": 0.02, "anisotropy": 0.02, "sensor": 0.005}

#: Between these the albedo and g remain, twice the step included.
_BOUNDS = {"albedo": (0.0, 1.0), "anisotropy": (-0.99, 0.99)}


class SceneParameters:
    """The parameters of a loaded scene, from which it can be displaced.

    Args:
        scene: whose first sensor is the one that renders.
    """

    def __init__(self, scene: mi.Scene) -> None:
        self._all = mi.traverse(scene)
        self._sensor = scene.sensors()[0]
        self._diagonal = _diagonal_of_media(scene)
        keys = [str(key) for key in self._all.keys()]
        self.keys = {name: [key for key in keys if pattern.search(key)] for name, pattern in _KEYS.items()}
        # Of the sensor alone: in the scene, it may have no name of its own, and others have places too.
        self._placement = mi.traverse(self._sensor)
        #: Before any displacement.
        self._values = {key: _copy(self._all[key]) for found in self.keys.values() for key in found}
        self._place = mi.Transform4f(self._placement["to_world"]) if "to_world" in self._placement else None

    @property
    def scatters(self) -> bool:
        """Whether some albedo is above 0."""
        return any(float(np.max(self._values[key])) > 0 for key in self.keys["albedo"])

    def missing(self, name: str) -> str | None:
        """Why there are no derivatives with respect to a parameter; None if there are."""
        if name == "sensor":
            movable = hasattr(self._sensor, "displacement") or self._place is not None
            return None if movable else "the sensor cannot be moved"
        if not self.keys[name]:
            return {"anisotropy": "no phase function of Henyey and Greenstein"}.get(name, f"no medium with {name}")
        if self.step(name) < 1e-3:
            return f"{name} is at the end of its range"
        return None

    def step(self, name: str) -> float:
        """The step of central differences, of which twice as much stays within the range of the parameter."""
        step = _STEPS[name]
        if name == "sensor":
            return step * self._diagonal
        if name in _BOUNDS:
            low, high = _BOUNDS[name]
            values = np.concatenate([np.ravel(self._values[key]) for key in self.keys[name]])
            step = min(step, float(values.min() - low) / 2, float(high - values.max()) / 2)
        return step

    @contextmanager
    def displaced(self, name: str, amount: float) -> Iterator[None]:
        """Within the block, the scene is displaced along a parameter; extinctions are multiplied by 1 + amount."""
        self._displace(name, amount)
        try:
            yield
        finally:
            self._displace(name, 0.0)

    def _displace(self, name: str, amount: float) -> None:
        if name == "sensor":
            offset = [amount, 0.0, 0.0]
            if hasattr(self._sensor, "displacement"):
                self._sensor.displacement = mi.Vector3f(offset) if amount else None
                return
            self._placement["to_world"] = mi.Transform4f().translate(offset) @ self._place
            self._placement.update()
            return
        for key in self.keys.get(name, ()):
            value = self._values[key]
            self._all[key] = value * (1 + amount) if name == "extinction" else value + amount
        self._all.update()

    @contextmanager
    def differentiated(self, name: str) -> Iterator[mi.SceneParameters]:
        """Within the block, gradients with respect to a parameter are tracked: see `gradient`."""
        for key in self.keys[name]:
            leaf = _copy(self._values[key])
            dr.enable_grad(leaf)
            self._all[key] = leaf
        self._all.update()
        try:
            yield self._all
        finally:
            self._displace(name, 0.0)

    def gradient(self, name: str) -> float:
        """The derivative along a parameter, from the gradients that `differentiated` has tracked."""
        total = 0.0
        for key in self.keys[name]:
            gradient = dr.grad(self._all[key]).numpy().astype(np.float64)
            total += float((gradient * self._values[key].numpy()).sum() if name == "extinction" else gradient.sum())
        return total


def _diagonal_of_media(scene: mi.Scene) -> float:
    """Of the box around all media, or around the scene where no shape has one; 1 where that is empty."""
    media = [shape.bbox() for shape in scene.shapes() if shape.is_medium_transition()]
    box = scene.bbox()
    if media:
        box = mi.ScalarBoundingBox3f()
        for each in media:
            box.expand(each)
    return float(np.linalg.norm(np.ravel(box.max) - np.ravel(box.min))) if box.valid() else 1.0


def _copy(value: Any) -> Any:
    return type(value)(dr.detach(value))


def parameter_names(texts: tuple[str, ...]) -> tuple[str, ...]:
    """The parameters that --gradients names, in the order of `PARAMETERS`.

    Raises:
        InputError: one is unknown.
    """
    for text in texts:
        if text not in PARAMETERS:
            raise InputError(f"--gradients {text}: expected some of {', '.join(PARAMETERS)}")
    return tuple(name for name in PARAMETERS if name in texts)

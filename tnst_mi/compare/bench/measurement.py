"""The whole comparison of two sides: images, derivatives, and the tests that they give rise to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tnst_mi.compare.bench.batches import Batches
from tnst_mi.compare.bench.decision import Family, merged
from tnst_mi.compare.bench.hypotheses import (
    DIFFERENCED,
    DIFFERENTIATED,
    KNOWN,
    Derivative,
    ImagePair,
    derivative_tests,
    value_families,
)
from tnst_mi.compare.bench.known_answers import Answer, answer_of
from tnst_mi.compare.bench.parameters import SceneParameters
from tnst_mi.compare.bench.pictures import pictures
from tnst_mi.compare.bench.renderer import SideRenderer, ramp
from tnst_mi.compare.bench.scene_file import scene_renderer
from tnst_mi.compare.bench.sides import ANSWER, FLOAT64, OURS, Side
from tnst_mi.compare.bench.smoke_scene import Smoke, float64_images, smoke_renderer
from tnst_mi.errors import InputError
from tnst_mi.rendering.cameras.views import text_of

#: Independent estimates into which the paths of a noisy side are divided.
BATCHES = 32

#: Images that a batch of central differences takes.
_IMAGES = 4

#: Called with the name of the current measurement and the share of all work, 0 to 1, done since the last call.
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class BenchSettings:
    """What to compare, and how precisely.

    Attributes:
        left, right: the sides.
        gammas: extinctions γ per unit of density and cell; empty for a scene file, which has its own.
        spp: paths per pixel for images.
        gradient_spp: the same for each derivative.
        parameters: with respect to which derivatives are compared, of `PARAMETERS`.
        tolerance: difference that does not count, relative to the RMS of a view.
        seed: of all paths; the sides share none.
    """

    left: Side
    right: Side
    gammas: tuple[float, ...]
    spp: int
    gradient_spp: int
    parameters: tuple[str, ...]
    tolerance: float
    seed: int


@dataclass(frozen=True, eq=False)
class Measured:
    """All measurements.

    Attributes:
        images: of each γ, or of the scene.
        views: names of the views.
        derivatives: of each γ and parameter.
        tolerance: difference that does not count.
    """

    images: list[ImagePair]
    views: tuple[str, ...]
    derivatives: list[Derivative]
    tolerance: float

    def families(self) -> list[Family]:
        """All tests."""
        found = [
            tests
            for pair in self.images
            for tests in value_families(pair.where, pair.left, pair.right, self.tolerance, self.views, pair.slack)
        ]
        found += [derivative_tests(derivative, self.tolerance) for derivative in self.derivatives]
        return merged([tests for tests in found if len(tests.labels)])


def measure(subject: Smoke | Path, settings: BenchSettings, progress: Progress) -> Measured:
    """Compare both sides on smoke, at each γ, or on a scene file.

    Raises:
        InputError: a side cannot show it, or what it needs cannot be read.
    """
    if isinstance(subject, Smoke):
        views = tuple(text_of(view) for view in subject.views)
        places = [(f"γ {gamma:g}", gamma) for gamma in settings.gammas]
    else:
        views, places = ("0",), [("", 0.0)]
    images, derivatives = [], []
    for number, (where, gamma) in enumerate(places):
        sides = [
            _Sided(subject, gamma, side, settings, number, index)
            for index, side in enumerate((settings.left, settings.right))
        ]
        rendered = [side.renderer.shape for side in sides if side.renderer is not None]
        shape = rendered[0] if rendered else _shape(subject)
        share = 1 / (len(places) * 2 * (1 + len(settings.parameters)))
        left, right = (side.images(shape, _working(progress, where, share)) for side in sides)
        arbiters, slack = _arbiters(subject, gamma, sides)
        pair = ImagePair(where, left, right, slack if slack is not None else np.zeros(left.values.shape[1:]), arbiters)
        images.append(pair)
        size = float(np.abs((ramp(shape) * left.mean).sum()))
        for name in settings.parameters:
            found = [side.derivatives(name, _working(progress, f"{where} {name}".strip(), share)) for side in sides]
            missing = tuple(reason for _, reasons in found for reason in reasons)
            derivatives.append(Derivative(where, name, found[0][0], found[1][0], missing, size))
    return Measured(images, views, derivatives, settings.tolerance)


class _Sided:
    """One side at one γ, or in a scene file."""

    def __init__(
        self, subject: Smoke | Path, gamma: float, side: Side, settings: BenchSettings, number: int, index: int
    ) -> None:
        self.subject, self.gamma, self.side, self.settings = subject, gamma, side, settings
        self._seed = (settings.seed, number, index)
        self.renderer = self._renderer()
        self._parameters = None if self.renderer is None else SceneParameters(self.renderer.scene)
        if side.kind == OURS and self._parameters is not None and self._parameters.scatters:
            raise InputError(
                f"{side.text}: it emits and absorbs, but a medium of the scene scatters; compare path tracers"
            )

    def _renderer(self) -> SideRenderer | None:
        if self.side.kind in (FLOAT64, ANSWER, "pictures"):
            return None
        if self.side.kind == "scene":
            return scene_renderer(self.side.path, self.side)
        if isinstance(self.subject, Smoke):
            return smoke_renderer(self.subject, self.gamma, self.side, self.settings.spp)
        return scene_renderer(self.subject, self.side)

    def images(self, shape: tuple[int, int, int, int], traced: Callable[[float], None]) -> Batches:
        """Of its images, which must have such a shape (V, H, W, C)."""
        if self.renderer is not None:
            if self.renderer.shape != shape:
                raise InputError(
                    f"{self.side.text}: its image is {self.renderer.shape[2]}×{self.renderer.shape[1]} of "
                    f"{self.renderer.shape[0]} views and {self.renderer.shape[3]} channels, expected "
                    f"{shape[2]}×{shape[1]} of {shape[0]} and {shape[3]} as on the other side"
                )
            spp = self.settings.spp
            return self.renderer.images(spp, BATCHES, (*self._seed, 0), lambda paths: traced(paths / spp))
        if self.side.kind == "pictures":
            return pictures(self.side.path, shape)
        if self.side.kind == ANSWER:
            return Batches(np.full((1, *shape), self._answer().radiance))
        if not isinstance(self.subject, Smoke) or self.subject.scatters:
            raise InputError(f"{self.side.text}: is of smoke that emits and absorbs, expected a density and --albedo 0")
        return Batches(float64_images(self.subject, self.gamma, self.side.quadrature)[0][None])

    def derivatives(self, name: str, traced: Callable[[float], None]) -> tuple[dict[str, Batches], list[str]]:
        """By how they were taken, and why others were not."""
        if self.side.kind == ANSWER:
            known = self._answer().derivatives.get(name)
            if known is None:
                return {}, [f"{self.side.text}: no derivative with respect to {name} is known"]
            return {KNOWN: Batches(np.array([known]))}, []
        if self.renderer is None or self._parameters is None:
            return {}, [f"{self.side.text}: has images alone"]
        if reason := self._parameters.missing(name):
            return {}, [f"{self.side.text}: {reason}"]
        spp = self.settings.gradient_spp
        number = 1 + self.settings.parameters.index(name)
        part = 1 / (spp * (_IMAGES + 1))
        arguments = (self._parameters, name, spp, BATCHES)
        found: dict[str, Batches] = {
            DIFFERENCED: self.renderer.differences(
                *arguments, (*self._seed, number, 0), lambda paths: traced(part * paths)
            )
        }
        if name == "sensor":
            return found, [f"{self.side.text}: integrators of media do not differentiate with respect to the sensor"]
        if not self.renderer.differentiates:
            return found, [f"{self.side.text}: does not differentiate"]
        found[DIFFERENTIATED] = self.renderer.derivatives(
            *arguments, (*self._seed, number, 1), lambda paths: traced(part * paths)
        )
        return found, []

    def _answer(self) -> Answer:
        if isinstance(self.subject, Smoke):
            raise InputError(f"{ANSWER}: is known of scenes such as scenes/known/slab.xml, not of a density")
        return answer_of(self.subject)


def _working(progress: Progress, name: str, share: float) -> Callable[[float], None]:
    progress(name, 0.0)
    return lambda part: progress(name, share * part)


def _shape(subject: Smoke | Path) -> tuple[int, int, int, int]:
    """Of images that neither side renders."""
    if isinstance(subject, Smoke):
        return (len(subject.views), *subject.density.shape[1:], 1)
    raise InputError(f"{subject}: neither side renders it; give an integrator as --left or --right")


def _arbiters(
    subject: Smoke | Path, gamma: float, sides: Sequence[_Sided]
) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """Images of smoke that emits and absorbs, in float64, and what rounding may do to "paper" if a side is of it."""
    if not isinstance(subject, Smoke) or subject.scatters:
        return {}, None
    paper, slack = float64_images(subject, gamma, "paper")
    exact, _ = float64_images(subject, gamma, "exact")
    of_paper = all(side.side.kind in (OURS, FLOAT64) and side.side.quadrature == "paper" for side in sides)
    return {"float64:exact": exact, "float64:paper": paper}, slack if of_paper else None

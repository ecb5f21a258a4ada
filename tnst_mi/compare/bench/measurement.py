"""The whole comparison of two sides: images, derivatives, and the tests that they give rise to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
from tnst_mi.compare.bench.smoke_scene import SmokeScene, float64_images, smoke_renderer
from tnst_mi.compare.bench.variants import variant_of, within
from tnst_mi.errors import InputError

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
        variants: of Mitsuba, of the left and the right; None of what it does not render.
        untested: what images do not show, or not certainly.
    """

    images: list[ImagePair]
    views: tuple[str, ...]
    derivatives: list[Derivative]
    tolerance: float
    variants: tuple[str | None, str | None] = (None, None)
    untested: tuple[str, ...] = ()

    def families(self) -> list[Family]:
        """All tests."""
        found = [
            tests
            for pair in self.images
            for tests in value_families(pair.where, pair.left, pair.right, self.tolerance, self.views, pair.slack)
        ]
        found += [derivative_tests(derivative, self.tolerance) for derivative in self.derivatives]
        return merged([tests for tests in found if len(tests.labels)])


@dataclass(frozen=True, eq=False)
class ReadySides:
    """Both sides at one γ, or in a scene file, ready to render.

    Attributes:
        where: what they show, such as "γ 0.5"; "" for a scene file.
        sides: left and right.
        shape: (V, H, W, C) of the images.
        fixed: by side, images that need no rendering; None for others.
        arbiters, slack: see `ImagePair`.
    """

    where: str
    sides: tuple[_Sided, _Sided]
    shape: tuple[int, int, int, int]
    fixed: tuple[Batches | None, Batches | None]
    arbiters: dict[str, np.ndarray]
    slack: np.ndarray


def prepare(subject: SmokeScene | Path, settings: BenchSettings) -> list[ReadySides]:
    """Load and check everything, at each γ of smoke, or of a scene file.

    Raises:
        InputError: a side cannot show it, or what it needs cannot be read.
    """
    places = [(f"γ {gamma:g}", gamma) for gamma in settings.gammas] if isinstance(subject, SmokeScene) else [("", 0.0)]
    prepared = []
    for number, (where, gamma) in enumerate(places):
        left = _Sided(subject, gamma, settings.left, settings, (settings.seed, number, 0))
        right = _Sided(subject, gamma, settings.right, settings, (settings.seed, number, 1))
        rendered = [side.shape for side in (left, right) if side.shape is not None]
        if {shape[-1] for shape in rendered} == {1, 3}:
            left.show_luminance(right)
            right.show_luminance(left)
        shape = next((side.shape for side in (left, right) if side.shape is not None), None) or _shape(subject)
        fixed = (left.fixed_images(shape), right.fixed_images(shape))
        prepared.append(
            ReadySides(where, (left, right), shape, fixed, *_arbiters(subject, gamma, (left, right), shape))
        )
    return prepared


def measure(
    prepared: Sequence[ReadySides], views: tuple[str, ...], settings: BenchSettings, progress: Progress
) -> Measured:
    """Render both sides; `views` are the names of the views."""
    images, derivatives = [], []
    share = 1 / (len(prepared) * 2 * (1 + len(settings.parameters)))
    for place in prepared:
        working = _working(progress, place.where, share)
        left, right = (
            side.images(working) if fixed is None else fixed
            for side, fixed in zip(place.sides, place.fixed, strict=True)
        )
        images.append(ImagePair(place.where, left, right, place.slack, place.arbiters))
        size = float(np.abs((ramp(place.shape) * left.mean).sum()))
        for name in settings.parameters:
            working = _working(progress, f"{place.where} {name}".strip(), share)
            (left_found, left_missing), (right_found, right_missing) = (
                side.derivatives(name, working) for side in place.sides
            )
            missing = (*left_missing, *right_missing)
            derivatives.append(Derivative(place.where, name, left_found, right_found, missing, size))
    left, right = prepared[0].sides
    untested = dict.fromkeys(line for place in prepared for side in place.sides for line in side.untested)
    return Measured(images, views, derivatives, settings.tolerance, (left.variant, right.variant), tuple(untested))


class _Sided:
    """One side at one γ, or in a scene file."""

    def __init__(
        self, subject: SmokeScene | Path, gamma: float, side: Side, settings: BenchSettings, seed: tuple[int, ...]
    ) -> None:
        self.subject, self.gamma, self.side, self.settings, self._seed = subject, gamma, side, settings, seed
        #: That it is rendered in; None if it is not rendered.
        self.variant: str | None = None
        #: (V, H, W, C) of what is rendered.
        self.shape: tuple[int, int, int, int] | None = None
        #: What its images do not show, or not certainly.
        self.untested: list[str] = []
        self.renderer: SideRenderer | None = None
        if side.kind in (FLOAT64, ANSWER, "pictures"):
            return
        self.variant = variant_of(side, side.kind != "scene" and isinstance(subject, SmokeScene))
        with within(self.variant):
            self.renderer = self._rendering()
            self._parameters = SceneParameters(self.renderer.scene)
            if side.kind == OURS and self._parameters.scatters:
                raise InputError(
                    f"{side.text}: it emits and absorbs, but a medium of the scene scatters; compare path tracers"
                )
            self.shape = self._first_shape()

    def _rendering(self) -> SideRenderer:
        if self.side.kind == "scene":
            return scene_renderer(self.side.path, self.side)
        if isinstance(self.subject, SmokeScene):
            return smoke_renderer(self.subject, self.gamma, self.side, self.settings.tolerance)
        return scene_renderer(self.subject, self.side)

    def _first_shape(self) -> tuple[int, int, int, int]:
        """The shape of the images, from a first one.

        Raises:
            InputError: the integrator cannot render the scene.
        """
        assert self.renderer is not None, "others are fixed"
        try:
            return self.renderer.shape
        except (RuntimeError, TypeError) as error:
            cause: BaseException = error
            while cause.__cause__ is not None:  # Dr.Jit puts its own around what an integrator raises
                cause = cause.__cause__
            reason = next((line for line in str(cause).splitlines() if line.strip()), repr(cause))
            raise InputError(f"{self.side.text}: cannot render it in {self.variant} ({reason.strip()})") from None

    def show_luminance(self, other: _Sided) -> None:
        """Show the luminance of red, green and blue, where the other side has no colours."""
        if self.renderer is None or self.variant is None or self.renderer.shape[-1] == 1:
            return
        self.renderer = replace(self.renderer, of_luminance=True)
        with within(self.variant):
            self.shape = self.renderer.shape
        self.untested.append(f"colours: {other.side.text} has luminance alone")

    def fixed_images(self, shape: tuple[int, int, int, int]) -> Batches | None:
        """Images of such a shape (V, H, W, C) that need no rendering; None if it renders them.

        Raises:
            InputError: it has none, or of another shape.
        """
        if self.renderer is not None:
            if self.shape != shape:
                (views, rows, columns, channels), own = shape, self.renderer.shape
                raise InputError(
                    f"{self.side.text}: its image has {own[2]}×{own[1]} pixels, {own[0]} views and {own[3]} channels, "
                    f"expected {columns}×{rows}, {views} and {channels} as on the other side"
                )
            return None
        if self.side.kind == "pictures":
            found = pictures(self.side.path, shape)
            if found.exact:
                self.untested.append(f"noise of {self.side.text}: it has one picture of each view, taken as exact")
            return found
        if self.side.kind == ANSWER:
            return Batches(np.full((1, *shape), self._answer().radiance))
        if not isinstance(self.subject, SmokeScene) or self.subject.scatters:
            raise InputError(f"{self.side.text}: is of smoke that emits and absorbs, expected a density and --albedo 0")
        return Batches(float64_images(self.subject, self.gamma, self.side.quadrature)[0][None])

    def images(self, traced: Callable[[float], None]) -> Batches:
        """Its rendered images."""
        assert self.renderer is not None and self.variant is not None, "others are fixed"
        spp = self.settings.spp
        with within(self.variant):
            found = self.renderer.images(spp, BATCHES, (*self._seed, 0), lambda paths: traced(paths / spp))
        if not np.isfinite(found.values).all():
            _, view, row, column, _ = np.argwhere(~np.isfinite(found.values))[0]
            count = int((~np.isfinite(found.values)).any((0, -1)).sum())
            raise InputError(
                f"{self.side.text}: {count} pixels are not finite, the first in row {row}, column {column} of view "
                f"{view}: nothing can be compared with them; see what the integrator does there"
            )
        return found

    def derivatives(self, name: str, traced: Callable[[float], None]) -> tuple[dict[str, Batches], list[str]]:
        """By how they were taken, and why others were not."""
        if self.side.kind == ANSWER:
            known = self._answer().derivatives.get(name)
            if known is None:
                return {}, [f"{self.side.text}: no derivative with respect to {name} is known"]
            return {KNOWN: Batches(np.array([known]))}, []
        if self.renderer is None or self.variant is None:
            return {}, [f"{self.side.text}: has images alone"]
        with within(self.variant):
            found, missing = self._taken(self.renderer, name, traced)
        for way, estimate in found.items():
            if not np.isfinite(estimate.values).all():
                raise InputError(f"{self.side.text}: the derivative with respect to {name} by {way} is not finite")
        return found, missing

    def _taken(
        self, renderer: SideRenderer, name: str, traced: Callable[[float], None]
    ) -> tuple[dict[str, Batches], list[str]]:
        if reason := self._parameters.missing(name):
            return {}, [f"{self.side.text}: {reason}"]
        spp = self.settings.gradient_spp
        number = 1 + self.settings.parameters.index(name)
        part = 1 / (spp * (_IMAGES + 1))
        arguments = (self._parameters, name, spp, BATCHES)
        found: dict[str, Batches] = {
            DIFFERENCED: renderer.differences(*arguments, (*self._seed, number, 0), lambda paths: traced(part * paths))
        }
        if name == "sensor":
            return found, [f"{self.side.text}: integrators of media do not differentiate with respect to the sensor"]
        if not renderer.differentiates:
            return found, [f"{self.side.text}: does not differentiate"]
        found[DIFFERENTIATED] = renderer.derivatives(
            *arguments, (*self._seed, number, 1), lambda paths: traced(part * paths)
        )
        return found, []

    def _answer(self) -> Answer:
        if isinstance(self.subject, SmokeScene):
            raise InputError(f"{ANSWER}: is known of scenes such as scenes/known/slab.xml, not of a density")
        return answer_of(self.subject)


def _working(progress: Progress, name: str, share: float) -> Callable[[float], None]:
    progress(name, 0.0)
    return lambda part: progress(name, share * part)


def _shape(subject: SmokeScene | Path) -> tuple[int, int, int, int]:
    """Of images that neither side renders."""
    if isinstance(subject, SmokeScene):
        return (len(subject.views), *subject.density.shape[1:], 1)
    raise InputError(f"{subject}: neither side renders it; give an integrator as --left or --right")


def _arbiters(
    subject: SmokeScene | Path, gamma: float, sides: tuple[_Sided, _Sided], shape: tuple[int, int, int, int]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Images of smoke that emits and absorbs, in float64, and what rounding may do to "paper" if both sides are it."""
    if not isinstance(subject, SmokeScene) or subject.scatters:
        return {}, np.zeros(shape)
    paper, slack = float64_images(subject, gamma, "paper")
    exact, _ = float64_images(subject, gamma, "exact")
    of_paper = all(side.side.kind in (OURS, FLOAT64) and side.side.quadrature == "paper" for side in sides)
    return {"float64:exact": exact, "float64:paper": paper}, slack if of_paper else np.zeros(shape)

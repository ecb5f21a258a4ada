"""The whole comparison of two sides: images, derivatives, and the tests that they give rise to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from tnst_mi.compare.bench.bench_settings import BenchSettings
from tnst_mi.compare.bench.renderers.prepared_side import PreparedSide
from tnst_mi.compare.bench.renderers.renderer import ramp
from tnst_mi.compare.bench.renderers.sides import FLOAT64, OURS
from tnst_mi.compare.bench.renderers.smoke_scene import SmokeScene, float64_images
from tnst_mi.compare.bench.statistics.batches import Batches
from tnst_mi.compare.bench.statistics.decision import Family, merged
from tnst_mi.compare.bench.statistics.hypotheses import (
    Derivative,
    ImagePair,
    derivative_tests,
    value_families,
)
from tnst_mi.errors import InputError

#: Called with the name of the current measurement and the share of all work, 0 to 1, done since the last call.
Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Measured:
    """All measurements.

    Attributes:
        images: of each γ, or of the scene.
        views: names of the views.
        derivatives: of each γ and parameter.
        tolerance: difference that does not count.
        variants: of Mitsuba, of the left and the right; None of what it does not render.
        traced: paths per pixel of the images, of the left and the right; None of what has no noise or is not rendered.
        untested: what images do not show, or not certainly.
    """

    images: list[ImagePair]
    views: tuple[str, ...]
    derivatives: list[Derivative]
    tolerance: float
    variants: tuple[str | None, str | None]
    traced: tuple[int | None, int | None]
    untested: tuple[str, ...]

    @cached_property
    def tests(self) -> dict[str, list[Family]]:
        """By what they are of, each image pair and derivative, with the families of each."""
        found = {
            f"{pair.where} images".strip(): value_families(
                pair.where, pair.left, pair.right, self.tolerance, self.views, pair.slack
            )
            for pair in self.images
        }
        for derivative in self.derivatives:
            what = f"{derivative.where} derivative with respect to {derivative.parameter}".strip()
            found[what] = [derivative_tests(derivative, self.tolerance)]
        return found

    def families(self) -> list[Family]:
        """All tests."""
        return merged([member for members in self.tests.values() for member in members if len(member.labels)])

    def unseen(self) -> list[str]:
        """Of what nothing could be tested: of images, no mean."""
        return [what for what, (first, *_) in self.tests.items() if not first.tested.any()]


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
    sides: tuple[PreparedSide, PreparedSide]
    shape: tuple[int, int, int, int]
    fixed: tuple[Batches | None, Batches | None]
    arbiters: dict[str, np.ndarray]
    slack: np.ndarray


def prepare(subject: SmokeScene | Path, settings: BenchSettings) -> list[ReadySides]:
    """Load and check everything, at each γ of smoke, or of a scene file.

    Raises:
        InputError: a side cannot show it, or what it needs cannot be read.
    """
    places = (
        [(f"γ {_positional(gamma)}", gamma) for gamma in settings.gammas]
        if isinstance(subject, SmokeScene)
        else [("", 0.0)]
    )
    prepared = []
    for number, (where, gamma) in enumerate(places):
        left = PreparedSide(subject, gamma, settings.left, settings, (settings.seed, number, 0))
        right = PreparedSide(subject, gamma, settings.right, settings, (settings.seed, number, 1))
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
            side.images(settings.spp, working) if fixed is None else fixed
            for side, fixed in zip(place.sides, place.fixed, strict=True)
        )
        images.append(ImagePair(place.where, left, right, place.slack, place.arbiters))
        size = float(np.abs((ramp(place.shape) * left.mean).sum()))
        for name in settings.parameters:
            working = _working(progress, f"{place.where} {name}".strip(), share)
            (left_found, left_missing), (right_found, right_missing) = (
                side.derivatives(name, settings.gradient_spp, working) for side in place.sides
            )
            missing = (*left_missing, *right_missing)
            steps = (place.sides[0].step(name), place.sides[1].step(name))
            derivatives.append(Derivative(place.where, name, left_found, right_found, missing, steps, size))
    left, right = prepared[0].sides
    untested = dict.fromkeys(line for place in prepared for side in place.sides for line in side.untested)
    traced = (_traced(left, images[0].left), _traced(right, images[0].right))
    variants = (left.variant, right.variant)
    return Measured(images, views, derivatives, settings.tolerance, variants, traced, tuple(untested))


def _traced(side: PreparedSide, images: Batches) -> int | None:
    return None if side.renderer is None or images.exact else len(images.values) * images.paths


def _positional(number: float) -> str:
    """With all its digits, so that no two are written alike."""
    return np.format_float_positional(number, trim="-")


def _working(progress: Progress, name: str, share: float) -> Callable[[float], None]:
    progress(name, 0.0)
    return lambda part: progress(name, share * part)


def _shape(subject: SmokeScene | Path) -> tuple[int, int, int, int]:
    """Of images that neither side renders."""
    if isinstance(subject, SmokeScene):
        return (len(subject.views), *subject.density.shape[1:], 1)
    raise InputError(f"{subject}: neither side renders it; give an integrator as --left or --right")


def _arbiters(
    subject: SmokeScene | Path, gamma: float, sides: tuple[PreparedSide, PreparedSide], shape: tuple[int, int, int, int]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Images of smoke that emits and absorbs, in float64, and what rounding may do to "paper" if both sides are it."""
    if not isinstance(subject, SmokeScene) or subject.scatters:
        return {}, np.zeros(shape)
    paper, slack = float64_images(subject, gamma, "paper")
    exact, _ = float64_images(subject, gamma, "exact")
    of_paper = all(side.side.kind in (OURS, FLOAT64) and side.side.quadrature == "paper" for side in sides)
    return {"float64:exact": exact, "float64:paper": paper}, slack if of_paper else np.zeros(shape)

"""One side of a comparison, loaded and checked: its images and derivatives, each in the side's own variant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from tnst_mi.compare.bench.bench_settings import BATCHES, BenchSettings
from tnst_mi.compare.bench.renderers.known_answers import Answer, answer_of
from tnst_mi.compare.bench.renderers.parameters import SceneParameters
from tnst_mi.compare.bench.renderers.pictures import pictures
from tnst_mi.compare.bench.renderers.renderer import SideRenderer
from tnst_mi.compare.bench.renderers.scene_file import scene_renderer
from tnst_mi.compare.bench.renderers.sides import ANSWER, FLOAT64, OURS, Side
from tnst_mi.compare.bench.renderers.smoke_scene import SmokeScene, float64_images, smoke_renderer
from tnst_mi.compare.bench.renderers.variants import variant_of, within
from tnst_mi.compare.bench.statistics.batches import Batches, certain_beside
from tnst_mi.compare.bench.statistics.hypotheses import DIFFERENCED, DIFFERENTIATED, KNOWN
from tnst_mi.errors import InputError

#: Images that a batch of central differences takes.
_IMAGES = 4


class PreparedSide:
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
            if self.renderer.remark:
                self.untested.append(self.renderer.remark)

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

    def show_luminance(self, other: PreparedSide) -> None:
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
            if isinstance(self.subject, SmokeScene) and len(self.settings.gammas) > 1:
                gammas = ", ".join(f"{gamma:g}" for gamma in self.settings.gammas)
                raise InputError(f"{self.side.path}: its pictures are of one γ, expected one --gamma and not {gammas}")
            found, remarks = pictures(self.side.path, shape)
            self.untested += remarks
            return found
        if self.side.kind == ANSWER:
            return Batches(np.full((1, *shape), self._answer().radiance))
        if not isinstance(self.subject, SmokeScene) or self.subject.scatters:
            raise InputError(f"{self.side.text}: is of smoke that emits and absorbs, expected a density and --albedo 0")
        return Batches(float64_images(self.subject, self.gamma, self.side.quadrature)[0][None])

    def images(self, spp: int, traced: Callable[[float], None]) -> Batches:
        """Its rendered images, of so many paths per pixel or as many more as its sampler can draw."""
        assert self.renderer is not None and self.variant is not None, "others are fixed"
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

    def derivatives(self, name: str, spp: int, traced: Callable[[float], None]) -> tuple[dict[str, Batches], list[str]]:
        """By how they were taken, and why others were not."""
        if self.side.kind == ANSWER:
            known = self._answer().derivatives.get(name)
            if known is None:
                return {}, [f"{self.side.text}: no derivative with respect to {name} is known"]
            return {KNOWN: Batches(np.array([known]))}, []
        if self.renderer is None or self.variant is None:
            return {}, [f"{self.side.text}: has images alone"]
        with within(self.variant):
            found, missing = self._taken(self.renderer, name, spp, traced)
        for way, estimate in found.items():
            if not np.isfinite(estimate.values).all():
                raise InputError(f"{self.side.text}: the derivative with respect to {name} by {way} is not finite")
        return found, missing

    def step(self, name: str) -> float | None:
        """Of its central differences with respect to a parameter; None if it takes none."""
        if self.renderer is None or self._parameters.missing(name):
            return None
        return self._parameters.step(name)

    def _taken(
        self, renderer: SideRenderer, name: str, spp: int, traced: Callable[[float], None]
    ) -> tuple[dict[str, Batches], list[str]]:
        if reason := self._parameters.missing(name):
            return {}, [f"{self.side.text}: {reason}"]
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
        derivatives = renderer.derivatives(*arguments, (*self._seed, number, 1), lambda paths: traced(part * paths))
        found[DIFFERENTIATED] = certain_beside(derivatives, found[DIFFERENCED])
        return found, []

    def _answer(self) -> Answer:
        if isinstance(self.subject, SmokeScene):
            raise InputError(f"{ANSWER}: is known of scenes such as scenes/known/slab.xml, not of a density")
        return answer_of(self.subject)

"""One frame: from its pictures to an extinction, grid by grid, each beginning with what the coarser one has found."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Octave
from tnst_mi.fields.resampling import resample_density
from tnst_mi.reconstruction.checks.usable_views import require_contrast, without_contrast
from tnst_mi.reconstruction.fitting.descent import Descent, rendered
from tnst_mi.reconstruction.fitting.image_model import BRIGHTER, ImageModel
from tnst_mi.reconstruction.fitting.outline import outline
from tnst_mi.reconstruction.fitting.rendering import RendererChoice
from tnst_mi.reconstruction.fitting.smoke_colours import (
    COLOUR_ROUNDS,
    REFINING_STEPS,
    as_if_white,
    coloured_images,
    smoke_colours,
)
from tnst_mi.reconstruction.photographs import Photograph, estimated_noise
from tnst_mi.reconstruction.settings import ReconstructionSettings

#: Noise in parts of the peak that pictures without any are taken to have: no rendering of cells comes nearer to smoke,
#: and a little of the prior decides what the pictures leave open.
_LEAST_NOISE = 1e-3

#: How many values of the brightness are tried on each grid.
_ROUNDS = 5

#: The share of pixels that count as those of the thickest smoke.
_THICKEST = 0.005

#: Opacity that is taken for the most: beyond it, a pixel says little of the smoke behind.
_OPAQUE = 0.98

#: Optical depth of the thickest smoke where pictures do not show it directly, since light is scattered.
_SCATTERING_DEPTH = 3.0

#: The part of the square difference of pictures from no smoke that smoke has to leave at most, to explain them at all.
_NO_BETTER = 0.9

#: The extinction that a path tracer begins with, over a typical one: where there is nothing, no path scatters, and
#: there is no derivative either.
_BEGINNING = 0.3


@dataclass(frozen=True)
class HeldOutView:
    """A view that judges: its picture, what is seen of the result, and how near they are in dB.

    The last is infinite where they are the same, and None where no pixel counts, so that it judges nothing.
    """

    name: str
    picture: np.ndarray
    rendering: np.ndarray
    psnr: float | None


class FrameReconstruction:
    """The reconstruction of one frame.

    Args:
        settings: of all of it.
        levels: the grids, from coarse to fine.
        photographs: of the frame, as they were read.
        brightness, background: what is known of them, in the pictures' unit; None for what is to be found.
        start: extinction (D, H, W) on the full grid to begin with, without coarser grids; None to begin with nothing.
        index: of the frame, part of the seed.

    Attributes:
        peak: the largest value of the pictures that are used, which counts as 1.
        noise: the standard deviation of their noise in parts of that, or of what is rendered, if that is more.
        first_level: the grid to begin with.

    Raises:
        InputError: the pictures show nothing, or nothing but one value.
    """

    def __init__(
        self,
        settings: ReconstructionSettings,
        levels: Sequence[Octave],
        photographs: Sequence[Photograph],
        brightness: float | None,
        background: float | None,
        start: np.ndarray | None,
        index: int,
    ) -> None:
        self._settings, self._levels, self._index, self._start = settings, levels, index, start
        used = [photograph for photograph in photographs if not photograph.held_out]
        self.peak = max(float((photograph.values * (photograph.weights > 0)).max()) for photograph in used)
        if not (self.peak > 0 and math.isfinite(self.peak)):
            raise InputError("the pictures are black, expected smoke that is brighter than what is behind it")
        require_contrast(photographs, settings)
        self._used = [photograph.in_units_of(self.peak) for photograph in used]
        self._judges = [one.in_units_of(self.peak) for one in photographs if one.held_out]
        # Of the pixels that are fitted in the end: a mean over several has less noise than each.
        fitted = [photograph.averaged(levels[-1].cell_size) for photograph in self._used]
        self._estimated = max(estimated_noise(fitted), _LEAST_NOISE)
        self.noise = self._noise = self._estimated if settings.noise == "auto" else float(settings.noise)
        self._renderers = RendererChoice(settings, self.peak)
        border = float(np.median(np.concatenate([_border(photograph) for photograph in self._used])))
        self._model = ImageModel(
            BRIGHTER if brightness is None else brightness / self.peak,
            border if background is None else background / self.peak,
            brightness is None and settings.integrator == "emission_absorption",
            background is None,
        )
        self._typical = self._typical_extinction()
        self._explains = True
        self.first_level = 0 if start is None else len(levels) - 1

    def descent(self, level: int, coarser: Descent | None) -> Descent:
        """The steps on a grid, from what those on the coarser one have found.

        Raises:
            InputError: the views do not agree on where smoke is.
        """
        octave, noise, seen = self._levels[level], self._noise, None
        photographs = [photograph.averaged(octave.cell_size) for photograph in self._used]
        begin = np.zeros(octave.shape, np.float32)
        if self._renderers.noisy:
            seen = outline(photographs, octave, self._model.background, self._estimated)
            if not seen.any():
                raise InputError(
                    "every cell of the box is seen as empty by some view, expected smoke where all views see some; "
                    "check the cameras and --box, or mask what hides smoke"
                )
            begin += _BEGINNING * self._typical * seen
            if self._settings.noise == "auto":
                # That of a step's renderings, which fits the extinction to their noise as to that of pictures.
                noise = max(noise, self._renderers.noise(begin, octave, photographs[: self._settings.batch]))
        if coarser is not None:
            found = resample_density(coarser.extinction.detach().cpu().numpy(), coarser.octave.cell_size, *_to(octave))
        elif self._start is not None:
            found = resample_density(self._start, 1.0, *_to(octave))
        else:
            found = begin
        self.noise = noise
        return Descent(
            octave,
            np.array(found, np.float32),
            self._typical,
            photographs,
            self._renderers,
            self._model,
            noise,
            self.step_count,
            _ROUNDS if self._model.find_brightness else 1,
            self._settings.batch,
            (self._settings.seed, self._index, level),
            seen,
            self._settings.iterations // 3 if level == self.first_level else 0,
        )

    def full_extinction(self, descent: Descent) -> np.ndarray:
        """What a descent has found, on the full grid: (D, H, W) float32, per cell; and the light that goes with it."""
        descent.fit_background()
        misfit, of_nothing = descent.misfits()
        self._explains = misfit < _NO_BETTER * of_nothing
        found = descent.extinction.detach().cpu().numpy()
        return np.array(resample_density(found, descent.octave.cell_size, *_to(self._levels[-1])), np.float32)

    @property
    def remarks(self) -> list[str]:
        """What is to be said of the pictures, and of what was found."""
        dark = without_contrast(self._used)
        said = [f"views: {', '.join(dark)}: all pixels are alike, as if no smoke were there"] if dark else []
        if not self._explains:
            said.append(
                "the smoke that was found explains the pictures hardly better than none; check --box, the cameras, "
                "--brightness and --background"
            )
        return said

    @property
    def brightness(self) -> float:
        """The value of a pixel where no light gets through, in the pictures' unit, as found so far."""
        return self._model.brightness * self.peak

    @property
    def background(self) -> float:
        """The value of a pixel without smoke, likewise."""
        return self._model.background * self.peak

    def in_colour(self, extinction: np.ndarray, goes_on: Callable[[], bool]) -> tuple[np.ndarray, np.ndarray] | None:
        """Find the colours (D, H, W, 3) of an extinction on the full grid, and from these the extinction anew.

        Pictures of one channel take the strongest of a pixel for what white smoke would show, which is too little where
        several colours are behind each other. Once the colours are known, how much too little is known too.

        Args:
            extinction: (D, H, W) on the full grid.
            goes_on: asked before each step, see `colour_steps`.

        Returns:
            The extinction and its colours; None if it did not go on.
        """
        s = self._settings
        find = partial(smoke_colours, photographs=self._used, model=self._model, quadrature=s.quadrature, batch=s.batch)
        colours = find(extinction, self._levels, start=None, goes_on=goes_on)
        for number in range(COLOUR_ROUNDS):
            if colours is None:
                return None
            descent = self._refinement(extinction, colours, number)
            while descent.done < descent.steps:
                if not goes_on():
                    return None
                descent.step()
            extinction = self.full_extinction(descent)
            colours = find(extinction, self._levels[-1:], start=colours, goes_on=goes_on)
        return None if colours is None else (extinction, colours)

    def _refinement(self, extinction: np.ndarray, colours: np.ndarray, number: int) -> Descent:
        """Further steps on the full grid, with pictures of what the smoke would show if it were white."""
        octave, s = self._levels[-1], self._settings
        pictures = [photograph.averaged(octave.cell_size) for photograph in self._used]
        return Descent(
            octave,
            extinction,
            self._typical,
            as_if_white(extinction, colours, octave, pictures, self._model, s.quadrature),
            self._renderers,
            self._model,
            self.noise,
            REFINING_STEPS,
            1,
            s.batch,
            (s.seed, self._index, len(self._levels) + number),
            None,
            0,
        )

    def judged(self, extinction: np.ndarray, colours: np.ndarray | None) -> list[HeldOutView]:
        """What the views that were held out see of an extinction (D, H, W) on the full grid, in units of the peak.

        With `colours` (D, H, W, 3), pictures and renderings are (rows, columns, 3).
        """
        octave = self._levels[-1]
        pictures = [photograph.averaged(octave.cell_size) for photograph in self._judges]
        if colours is not None:
            seen = coloured_images(extinction, colours, octave, pictures, self._model, self._settings.quadrature)
            return [
                HeldOutView(one.name, one.colours, image, psnr(image, one.colours, one.weights[..., None]))
                for one, image in zip(pictures, seen, strict=True)
                if one.colours is not None
            ]
        seen = rendered(extinction, octave, pictures, self._renderers, self._model)
        return [
            HeldOutView(picture.name, picture.values, image, psnr(image, picture.values, picture.weights))
            for picture, image in zip(pictures, seen, strict=True)
        ]

    @property
    def step_count(self) -> int:
        """Steps on each grid: where the brightness is to be found, descents half as long, one for each value of it."""
        iterations = self._settings.iterations
        return _ROUNDS * (iterations // 2 or 1) if self._model.find_brightness else iterations

    def pixel_count(self, level: int) -> int:
        """Pixels of a step on a grid, by which its time is estimated."""
        sizes = [photograph.averaged(self._levels[level].cell_size).values.size for photograph in self._used[:1]]
        return min(self._settings.batch, len(self._used)) * sizes[0]

    def _typical_extinction(self) -> float:
        """That of smoke which is as thick as the pictures show and a quarter of the grid deep."""
        depth = _SCATTERING_DEPTH
        if self._settings.integrator == "emission_absorption":
            brightness, background = self._model.brightness, self._model.background
            spread = brightness - background
            opacity = [
                ((one.values - (background if one.background is None else one.background)) / (spread or 1.0))[
                    one.weights > 0
                ]
                for one in self._used
            ]
            thickest = float(np.quantile(np.abs(np.concatenate(opacity)), 1 - _THICKEST))
            depth = -math.log(1 - min(thickest, _OPAQUE))
        return max(depth, 1e-4) / (max(self._levels[-1].shape) / 4)


def psnr(image: np.ndarray, picture: np.ndarray, weights: np.ndarray) -> float | None:
    """Peak signal-to-noise ratio in dB of an image whose peak is 1, over the pixels that count; None if none does."""
    weights = np.broadcast_to(weights, picture.shape)
    if not (total := float(weights.sum(dtype=np.float64))) > 0:
        return None
    error = float((weights * (image - picture) ** 2).sum(dtype=np.float64) / total)
    return math.inf if error == 0 else -10 * math.log10(error)


def mean_psnr(views: Sequence[HeldOutView]) -> float | None:
    """That of all views together, by their mean square error; None if none has pixels that count."""
    errors = [10 ** (-view.psnr / 10) for view in views if view.psnr is not None]
    if not errors:
        return None
    error = float(np.mean(errors))
    return math.inf if error == 0 else -10 * math.log10(error)


def _border(photograph: Photograph) -> np.ndarray:
    """The pixels at the edges of a picture that count; where none does, all others that count."""
    counts, edges = photograph.weights > 0, np.zeros(photograph.values.shape, bool)
    edges[[0, -1]] = edges[:, [0, -1]] = True
    return photograph.values[counts & edges if (counts & edges).any() else counts]


def _to(octave: Octave) -> tuple[tuple[int, int, int], float]:
    return octave.shape, octave.cell_size

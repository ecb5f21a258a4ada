"""Fire: the light that a frame's flame or temperature sends out, as emission of the studio's smoke.

A flame f, from 0 to its largest value over all frames, emits f times a warm colour, deep red where it is faint. A
temperature emits as a black body: in kelvin if it reaches 200, else it is taken as 20 °C at 0 and 2200 K at its largest
value. Colours c, if they are asked for, emit c times the density, so that air without smoke is dark; those of a grid
whose name says emission are that already. All are relative: the brightest place of all frames emits `BRIGHTNESS` in its
strongest colour, colours `COLOUR_BRIGHTNESS`.

Temperatures also colour smoke that does not burn, with the hue of that light and not its strength: `glow_colours`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.bounds import Region, hull, smoke_box
from tnst_mi.frame import Frame
from tnst_mi.io.interpretation.grid_names import is_colour, listed, plain_name

#: Largest emission, radiance per longest edge of the grid: a sixth of that edge is as bright as white.
BRIGHTNESS = 6.0
#: Likewise of smoke that shines in its colours: it fills far more space than flames, and would be white all over.
COLOUR_BRIGHTNESS = 3.0

#: Words in the names of grids. Caches call them flame or flame_noise, temperature or heat.
_FLAME = {"flame", "flames", "fire", "burn", "burning"}
_TEMPERATURE = {"temperature", "temp", "heat"}

#: Temperatures that reach it are in kelvin: without a unit, programs have a few units at most.
_KELVIN = 200.0
#: Below, a body does not glow visibly (Draper point).
_GLOWS = 798.0
#: Of black bodies that are as cold or colder, smoke has this one's hue: theirs are redder than sRGB.
_COLDEST = 1000.0
#: Of a temperature without a unit, at 0 and at its largest value, in kelvin.
_AMBIENT, _HOTTEST = 293.0, 2200.0
#: Black bodies of the colours of the faintest and the strongest flame, in kelvin.
_FAINT, _STRONG = 1100.0, 2300.0

#: Second radiation constant h c / k, in nm K.
_C2 = 1.438777e7
#: XYZ to linear sRGB (IEC 61966-2-1).
_SRGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
_COLOURS = 512


@dataclass(frozen=True)
class Fire:
    """What burns in all frames of a sequence.

    Attributes:
        grid: the name of the grid whose values emit.
        temperature: whether they are temperatures, and not those of a flame.
        largest: the largest of them; of colours, the strongest component of what they emit.
        occupied: the box that contains all values above 0.
        colours: whether they are colours, of three components.
    """

    grid: str
    temperature: bool
    largest: float
    occupied: Region
    colours: bool = False

    @property
    def in_words(self) -> str:
        """Which grid was taken as what."""
        if self.colours:
            return (
                f"fire: grid {self.grid} as the colour of light{'' if _is_light(self.grid) else ', times the density'}"
            )
        if not self.temperature:
            return f"fire: grid {self.grid} as a flame, up to {self.largest:.4g}"
        return f"fire: {temperature_in_words(self.grid, self.largest)}"

    def emission(self, frame: Frame) -> np.ndarray:
        """The emission of a frame, linear RGB radiance per longest edge of the grid, (D, H, W, 3) float32.

        A frame without the grid does not burn.

        Raises:
            InputError: its grid is no scalar, or has no colours.
        """
        if self.grid not in frame.grids:
            return np.zeros((*frame.density.shape, 3), np.float32)
        if self.colours:
            return np.float32(COLOUR_BRIGHTNESS / self.largest) * _coloured_light(frame, self.grid)
        values = np.clip(_scalar(frame, self.grid), 0.0, self.largest)
        steps = np.linspace(0.0, 1.0, _COLOURS)
        colours = self._temperature_ramp(steps) if self.temperature else _flame_ramp(steps)
        # Quick, and exact to 1e-3: neighbouring entries of a smooth table.
        position = values / self.largest * (_COLOURS - 1)
        below = np.minimum(position.astype(np.int32), _COLOURS - 2)
        part = (position - below)[..., None].astype(np.float32)
        table = (BRIGHTNESS * colours).astype(np.float32)
        return (1 - part) * table[below] + part * table[below + 1]

    def _temperature_ramp(self, share: np.ndarray) -> np.ndarray:
        """Emission relative to the strongest, of shares of the largest value, (N, 3)."""
        glow = black_body(np.maximum(_kelvin(share, self.largest), 1.0))
        return glow / glow[-1].max()


def find_fire(frames: Iterable[Frame], choice: str | None = None) -> Fire | None:
    """Find what burns in frames, each of which is read once.

    Args:
        frames: all frames that will be rendered together.
        choice: the name of a grid, which may have colours; "none" for no fire; None for the flame where there is one,
            else for a temperature in kelvin at which bodies glow: other temperatures are as often those of mere smoke.

    Returns:
        The fire; None if nothing burns.

    Raises:
        InputError: no frame has the grid that was chosen, it has vectors that are no colours, or is 0 everywhere.
    """
    if choice == "none":
        return None
    found: dict[str, Fire] = {}
    names: dict[str, None] = {}
    for frame in frames:
        names |= dict.fromkeys(frame.grids)
        for name in frame.grids:
            wanted = name == choice if choice is not None else _says(name, _FLAME | _TEMPERATURE)
            if not wanted or (choice is None and frame.grids[name].ndim != 3):
                continue
            colours = frame.grids[name].ndim == 4 and is_colour(name)
            values = _coloured_light(frame, name).max(axis=-1) if colours else _scalar(frame, name)
            box = smoke_box(np.maximum(values, 0.0), 1)
            if box is not None:
                largest, boxes = float(values.max()), [box]
                if name in found:
                    largest, boxes = max(largest, found[name].largest), [box, found[name].occupied]
                found[name] = Fire(name, is_temperature(name), largest, hull(boxes), colours)
    if choice is not None and choice not in names:
        others = f"expected one of {listed(list(names))}, or none" if names else "there is none beside the density"
        raise InputError(f"--fire {choice}: no frame has such a grid; {others}")
    if choice is not None and not found:
        raise InputError(f"--fire {choice}: is not above 0 anywhere, so nothing burns; give another grid, or none")
    burning = [fire for fire in found.values() if not fire.temperature or choice is not None or fire.largest >= _GLOWS]
    return min(burning, key=lambda fire: fire.temperature, default=None)


def is_temperature(name: str) -> bool:
    """Whether the name of a grid says that its values are temperatures.

    Example:
        >>> from tnst_mi.rendering.fire import is_temperature
        >>> is_temperature("temperature"), is_temperature("heat_01"), is_temperature("flame_heat")
        (True, True, False)
    """
    return _says(name, _TEMPERATURE) and not _says(name, _FLAME)


def temperature_in_words(grid: str, largest: float) -> str:
    """What a grid of temperatures up to the largest of all frames is taken as."""
    unit = " K" if largest >= _KELVIN else f", taken as {_HOTTEST:g} K"
    return f"grid {grid} as a temperature, up to {largest:.4g}{unit}"


def glow_colours(temperature: np.ndarray, largest: float) -> np.ndarray:
    """The hues of black bodies, linear sRGB of which the strongest is 1, (…, 3) float32.

    Args:
        temperature: in kelvin, or without a unit.
        largest: of all frames, above 0; it says which.
    """
    kelvin = _kelvin(np.clip(temperature, 0.0, largest) / largest, largest)
    # The hue changes about evenly with the reciprocal of the temperature.
    reciprocal = np.linspace(1 / max(_COLDEST, float(_kelvin(np.ones(1), largest)[0])), 1 / _COLDEST, _COLOURS)
    glow = black_body(1 / reciprocal)
    glow /= glow.max(axis=1, keepdims=True)
    place = 1 / np.maximum(kelvin, _COLDEST)
    return np.stack([np.interp(place, reciprocal, channel) for channel in glow.T], axis=-1).astype(np.float32)


def black_body(kelvin: np.ndarray) -> np.ndarray:
    """Light of black bodies, (N, 3) linear sRGB from temperatures (N,); only ratios have a meaning.

    Planck's law, seen by the CIE 1931 observer in the fit of Wyman, Sloan and Shirley (2013, "Simple analytic
    approximations to the CIE XYZ color matching functions", JCGT 2(2)). Colours outside sRGB are clipped to it.
    """
    wavelengths = np.arange(380.0, 781.0, 5.0)
    planck = wavelengths**-5.0 * 1e15 / np.expm1(np.minimum(_C2 / (wavelengths * kelvin[:, None]), 700.0))
    return np.maximum(planck @ _observer(wavelengths) @ _SRGB.T, 0.0)


def _kelvin(share: np.ndarray, largest: float) -> np.ndarray:
    """Temperatures in kelvin, of shares of the largest of all frames."""
    return share * largest if largest >= _KELVIN else _AMBIENT + share * (_HOTTEST - _AMBIENT)


def _observer(wavelengths: np.ndarray) -> np.ndarray:
    """The colour matching functions x, y and z at wavelengths in nm, (N, 3)."""

    def lobe(height: float, centre: float, below: float, above: float) -> np.ndarray:
        distance = wavelengths - centre
        return height * np.exp(-0.5 * np.square(distance / np.where(distance < 0, below, above)))

    x = lobe(1.056, 599.8, 37.9, 31.0) + lobe(0.362, 442.0, 16.0, 26.7) + lobe(-0.065, 501.1, 20.4, 26.2)
    y = lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1)
    z = lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8)
    return np.stack([x, y, z], axis=1)


def _flame_ramp(share: np.ndarray) -> np.ndarray:
    """Emission relative to the strongest, of shares of the largest value of a flame, (N, 3)."""
    glow = black_body(_FAINT + share * (_STRONG - _FAINT))
    return share[:, None] * glow / glow.max(axis=1, keepdims=True)


def flame_colours(count: int) -> Sequence[Sequence[float]]:
    """Colours of a flame from faint to strong, linear sRGB with 1 as the strongest, for renderers with ramps."""
    glow = black_body(np.linspace(_FAINT, _STRONG, count))
    return (glow / glow.max(axis=1, keepdims=True)).tolist()


def _says(name: str, words: set[str]) -> bool:
    return not words.isdisjoint(plain_name(name).split())


def _scalar(frame: Frame, name: str) -> np.ndarray:
    values = frame.grids[name]
    if values.ndim != 3:
        raise InputError(
            f"{frame.name}: grid {name!r} has shape {values.shape}, expected a scalar grid to burn, or colours"
        )
    return values.astype(np.float32)


def _coloured_light(frame: Frame, name: str) -> np.ndarray:
    """What colours emit, (D, H, W, 3) in any unit: that of a grid of light, or that of smoke of these colours."""
    values = frame.grids[name]
    if values.ndim != 4:
        raise InputError(f"{frame.name}: grid {name!r} has shape {values.shape}, expected colours as in other frames")
    light = np.maximum(values.astype(np.float32), 0.0)
    return light if _is_light(name) else light * frame.density[..., None]


def _is_light(name: str) -> bool:
    """Whether the name of a grid of colours says that they are those of light, and not of smoke."""
    return _says(name, {"emission"})

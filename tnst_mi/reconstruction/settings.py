"""What a reconstruction can be told: by flags, in a table of the file of cameras, or in Python."""

from __future__ import annotations

import dataclasses
import difflib
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, get_args, get_type_hints

from tnst_mi.errors import InputError
from tnst_mi.recipe.keys import Choice, Integer, Kind, Number, Text


@dataclass(frozen=True)
class Corners:
    """A box by its lowest and its highest corner, six numbers, or None for "not set"."""

    placeholder: str = "X0,Y0,Z0,X1,Y1,Z1"
    expected: str = "six numbers X0,Y0,Z0,X1,Y1,Z1 with X0 < X1, Y0 < Y1 and Z0 < Z1"

    def check(self, value: Any) -> tuple[float, ...] | None:
        """Accept None and six numbers in order."""
        if value is None:
            return None
        if not isinstance(value, list | tuple) or len(value) != 6:
            raise ValueError
        numbers = tuple(Number(-1e9, 1e9).check(number) for number in value)
        if not all(low < high for low, high in zip(numbers[:3], numbers[3:], strict=True)):
            raise ValueError
        return numbers

    def read(self, text: str) -> tuple[float, ...]:
        """Read six numbers between commas."""
        return tuple(float(part) for part in text.split(","))

    def show(self, value: tuple[float, ...] | None) -> str:
        """Write them likewise."""
        return "not set" if value is None else ",".join(f"{number:g}" for number in value)


#: What only light that is scattered has.
_OF_SCATTERING = ("albedo", "anisotropy", "light", "spp")


@dataclass(frozen=True)
class ReconstructionSettings:
    """Every key with its kind and its default; the texts below them are those of --help.

    Raises:
        InputError: from `updated`, a key is unknown or its value is none.
    """

    box: Annotated[tuple[float, ...] | None, Corners()] = None
    """The box that holds the smoke, by two corners in the axes and the unit of the cameras' scene."""
    cells: Annotated[int, Integer(4, 2048)] = 96
    """Cells of the grid along the longest edge of the box."""
    gamma: Annotated[float | str, Number(above=0.0, high=1e4, words=("auto",))] = 0.1
    """γ, extinction per unit of density and cell, which decides the unit of the density; auto finds it, where images
    are in density × cells."""
    brightness: Annotated[float | str, Number(above=0.0, high=1e9, words=("auto", "1/gamma"))] = "1/gamma"
    """Value that a pixel has where no light gets through the smoke; 1/gamma is that of our own images (paper Eq. 11),
    auto finds it."""
    background: Annotated[float | str, Number(0.0, 1e9, words=("auto",))] = 0.0
    """Value of pixels without smoke; auto finds one for all views; pictures of it are named in the file of cameras."""
    channel: Annotated[str, Choice(("luminance", "rgb", "red", "green", "blue", "alpha"))] = "luminance"
    """What of the pictures is taken; rgb finds the colour of the smoke too; alpha is their opacity, of which
    brightness is 1."""
    transfer: Annotated[str, Choice(("auto", "linear", "srgb"))] = "auto"
    """What the values of pictures mean; auto: EXR and HDR are linear, all others have the curve of sRGB."""
    noise: Annotated[float | str, Number(0.0, 1.0, words=("auto",))] = "auto"
    """Standard deviation of the pictures' noise, in parts of their largest value, which decides how smooth the density
    becomes; auto estimates it, and with prbvolpath takes that of a step's renderings if it is more."""
    hold_out: Annotated[int | str, Integer(0, 1000, word="auto")] = "auto"
    """Judge by every n-th view instead of using it; 0 uses all; auto holds out those that the file of cameras says, or
    else every eighth."""
    levels: Annotated[int, Integer(1, 6)] = 3
    """Grids from coarse to fine, each with twice the cells of the one before along every edge."""
    iterations: Annotated[int, Integer(1, 100_000)] = 150
    """Steps on each grid."""
    motion_iterations: Annotated[int, Integer(1, 100_000)] = 40
    """Steps on each grid for the velocity between two frames of a sequence."""
    batch: Annotated[int, Integer(1, 1000)] = 6
    """Views of a step."""
    quadrature: Annotated[str, Choice(("exact", "paper"))] = "exact"
    """How emission_absorption adds up light along a ray: exact, or the paper's sum, for images that were made so."""
    integrator: Annotated[str, Choice(("emission_absorption", "prbvolpath"))] = "emission_absorption"
    """What renders the density: light emitted and absorbed by the smoke, or Mitsuba's scattering path tracer, to which
    albedo, anisotropy, light and spp apply."""
    albedo: Annotated[float, Number(0.0, 1.0)] = 0.9
    """prbvolpath: fraction of the extinguished light that is scattered."""
    anisotropy: Annotated[float, Number(-0.99, 0.99)] = 0.0
    """prbvolpath: mean cosine g of the Henyey-Greenstein phase function."""
    light: Annotated[str, Text("FILE|key|environment", "a Mitsuba scene file, key or environment")] = "key"
    """prbvolpath: the light on the smoke, in the axes of the grid, y up."""
    spp: Annotated[int, Integer(1, 4096)] = 16
    """prbvolpath: paths per pixel in each pass of a step."""
    seed: Annotated[int, Integer(0, 2**32 - 1)] = 0
    """Seed of the order of the views, and of the paths."""

    def updated(self, values: Mapping[str, Any], source: str = "") -> ReconstructionSettings:
        """The settings with other values, which are checked; `source` begins messages.

        Raises:
            InputError: a key is unknown, or its value is none.
        """
        for name in values:
            if name not in SETTING_KINDS:
                near = difflib.get_close_matches(name, SETTING_KINDS, 1)
                remedy = f"did you mean {near[0]!r}?" if near else f"expected one of {', '.join(SETTING_KINDS)}"
                raise InputError(f"{source}unknown key {reprlib.repr(name)}; {remedy}")
        return dataclasses.replace(
            self, **{name: _checked(f"{source}{name} =", name, value) for name, value in values.items()}
        )

    @cached_property
    def known_brightness(self) -> float | None:
        """The value of a pixel where no light gets through; None if it is to be found."""
        if self.channel == "alpha":
            return 1.0
        if self.brightness == "1/gamma":
            return None if self.gamma == "auto" else 1 / float(self.gamma)
        return None if self.brightness == "auto" else float(self.brightness)

    def gamma_of(self, brightness: float) -> float:
        """γ, by the brightness that was found."""
        return 1 / brightness if self.gamma == "auto" else float(self.gamma)

    def require_consistent(self) -> None:
        """Check that the keys go together.

        Raises:
            InputError: some do not.
        """
        if self.gamma == "auto" and self.brightness != "1/gamma":
            raise InputError(
                f"gamma = auto and brightness = {self.brightness}: γ is found by the brightness 1/γ alone; give a "
                "number for gamma, which then only decides the unit of the density"
            )
        if self.quadrature == "paper" and self.background != 0:
            raise InputError(
                "quadrature = paper: its sum has no transmittance that a background could be seen through; take exact"
            )
        if self.channel == "alpha" and (self.gamma == "auto" or self.brightness not in ("1/gamma", 1.0)):
            name = "gamma" if self.gamma == "auto" else "brightness"
            raise InputError(
                f"{name} = {getattr(self, name)}: with channel = alpha, pictures are opacities, whose brightness is 1, "
                f"so that there is nothing to find or to choose; leave {name} out"
            )
        if self.integrator == "emission_absorption":
            for name in _OF_SCATTERING:
                if (value := getattr(self, name)) != getattr(type(self), name):
                    raise InputError(
                        f"{name} = {value}: is of scattered light; add integrator = prbvolpath, or leave {name} out"
                    )
        if self.integrator == "prbvolpath":
            given = {"brightness": self.brightness != "1/gamma", "background": self.background != 0}
            given |= {"channel": self.channel in ("alpha", "rgb"), "quadrature": self.quadrature != "exact"}
            given["gamma"] = self.gamma == "auto"
            if wrong := [name for name, there in given.items() if there]:
                raise InputError(
                    f"{wrong[0]} = {getattr(self, wrong[0])}: is of emission_absorption; with prbvolpath, the light "
                    "decides how bright smoke is, before black"
                )


#: The kinds of the settings by name.
SETTING_KINDS: dict[str, Kind] = {
    name: next(item for item in get_args(hint)[1:])
    for name, hint in get_type_hints(ReconstructionSettings, include_extras=True).items()
}


def read_flags(texts: Mapping[str, str]) -> dict[str, Any]:
    """The settings that flags give, by their texts.

    Raises:
        InputError: a text is no value of its flag.
    """
    values = {}
    for name, text in texts.items():
        flag = f"--{name.replace('_', '-')}"
        try:
            value = SETTING_KINDS[name].read(text)
        except (ValueError, OverflowError):
            raise InputError(f"{flag} {text}: expected {SETTING_KINDS[name].expected}") from None
        values[name] = _checked(flag, name, value, text)
    return values


def _checked(where: str, name: str, value: Any, shown: str | None = None) -> Any:
    try:
        return SETTING_KINDS[name].check(value)
    except (ValueError, OverflowError):
        told = reprlib.repr(value) if shown is None else shown
        raise InputError(f"{where} {told}: expected {SETTING_KINDS[name].expected}") from None

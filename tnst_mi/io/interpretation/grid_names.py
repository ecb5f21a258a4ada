"""What the names of grids mean, as people and programs write them: capitals, spaces and numbers are seen through."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tnst_mi.machine.terminal import quoted, shortened, some_of

#: Names that say enough by themselves, of grids and of files, in order of preference.
DENSITY = ("density", "dens", "rho", "d")
VELOCITY = ("velocity", "vel", "v", "velocities", "velo", "u")
OBSTACLE = ("obstacle", "obstacles", "solid", "solids", "collision", "collider", "flags")

#: The name of Mantaflow's cell types, whose bits say what is solid.
FLAGS = "flags"

#: Words that say enough as a part of a name, unless another word says that the grid is something else.
SMOKE = ("density", "smoke", "fog", "soot", "cloud", "mist", "haze", "steam", "vapor", "vapour", "fume", "dust")
_MOVING = ("velocity", "vel")
_ELSE = (
    *("temperature", "temp", "heat", "fuel", "flame", "fire", "burn", "react", "age", "pressure", "divergence"),
    *("color", "colour", "cd", "sdf", "phi", "mask", "shadow", "emission", "normal", "gradient", "force", "rest"),
    *("vorticity", "curl", "position"),
)

# Words of what is made from or for a velocity.
_ABOUT_MOVING = ("noise", "curl", "vorticity", "turbulence", "source", "target", "magnitude", "speed", "error")

# Words for vectors whose three components are no directions in space.
_COLOUR = ("cd", "color", "colour", "rgb", "albedo", "tint")

# Names of the axis after or before that of the vector, such as vel.x, velocityX, vel[0] and x_velocity.
_AXIS_LAST = re.compile(r"(.*?)[\s._:\-\[(]*([xyzuvw012])[\])]?$", re.DOTALL)
_AXIS_FIRST = re.compile(r"([xyz])[\s._:\-]*(.*)$", re.DOTALL)
_AXES = {letter: axis for letters in ("xyz", "uvw", "012") for axis, letter in enumerate(letters)}

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[^\W\d_a-zA-Z]+")

_SHOWN, _LONGEST = 6, 30


def plain_name(name: str) -> str:
    """The words of a name in small letters, without the numbers and signs around them.

    Example:
        >>> from tnst_mi.io.interpretation.grid_names import plain_name
        >>> [plain_name(name) for name in (" density ", "Density[0]", "smokeDensity_01")]
        ['density', 'density', 'smoke density']
    """
    return " ".join(word.lower() for word in _WORD.findall(name))


def base_name(name: str) -> str:
    """A name without the spaces around it, and the number in brackets that tells it from equal ones."""
    return re.sub(r"\[\d+\]$", "", name.strip()).strip()


def is_partly_density(name: str) -> bool:
    """Whether a part of a name says that it is smoke, and no other part that it is something else about it."""
    return _says(name, SMOKE) and not _says_else(name, *_MOVING)


def is_partly_velocity(name: str) -> bool:
    """Whether a part of a name says that it is a velocity, and no other part that it is something else, something about
    a velocity, or one of its components."""
    about = set(plain_name(name).split()) & {*_ABOUT_MOVING}
    return _says(name, _MOVING) and not about and not _says_else(name) and component(name) is None


def may_be_velocity(name: str) -> bool:
    """Whether no part of the name of vectors says that they are something else than velocities."""
    return not _says_else(name)


def is_colour(name: str) -> bool:
    """Whether the vectors of a grid are colours, which do not turn with the axes.

    Example:
        >>> from tnst_mi.io.interpretation.grid_names import is_colour
        >>> is_colour("Cd"), is_colour("emission_color"), is_colour("force")
        (True, True, False)
    """
    return bool(set(plain_name(name).split()) & {*_COLOUR})


def component(name: str, vector: str | None = None) -> tuple[str, int] | None:
    """The vector that a scalar grid is a component of, and its axis: 0 for x, 1 for y, 2 for z.

    Args:
        name: the name of the scalar grid.
        vector: the name of the vector; None for those that a velocity usually has.

    Example:
        >>> from tnst_mi.io.interpretation.grid_names import component
        >>> component("vel.x"), component("velocityZ"), component("v"), component("Cd.x")
        (('vel', 0), ('velocity', 2), ('', 1), None)
    """
    name = name.strip().lower()
    if vector is None and name in ("u", "v", "w"):
        return "", _AXES[name]
    known = VELOCITY if vector is None else (vector.strip().lower(),)
    if (match := _AXIS_LAST.match(name)) and match[1] in known:
        return match[1], _AXES[match[2]]
    if (match := _AXIS_FIRST.match(name)) and match[2] in known:
        return match[2], _AXES[match[1]]
    return None


def listed(names: Sequence[str | tuple[str, str]], in_quotes: bool = True) -> str:
    """Some names in a message of bounded length.

    Args:
        names: the names, each perhaps with what is to be said behind it.
        in_quotes: whether to quote them, since they may be empty or have spaces.
    """
    shown = []
    for entry in names:
        name, remark = entry if isinstance(entry, tuple) else (entry, "")
        shown.append(f"{quoted(name, _LONGEST) if in_quotes else shortened(name, _LONGEST)}{remark}")
    return some_of(shown, _SHOWN) or "none"


def _says_else(name: str, *words: str) -> bool:
    """Whether a name has a word for something that is neither smoke nor a velocity, or one of some other words."""
    return bool(set(plain_name(name).split()) & {*_ELSE, *words})


def _says(name: str, words: tuple[str, ...]) -> bool:
    """Whether a name has one of the words; the first one is recognised within a longer word too."""
    return words[0] in name.lower() or bool(set(plain_name(name).split()) & {*words, *(f"{word}s" for word in words)})

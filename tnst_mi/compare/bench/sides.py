"""What can stand on either side of a comparison, from the texts of --left and --right."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.resources import expanded

#: Mitsuba's integrators that render media.
PATH_TRACERS = ("volpath", "volpathmis", "prbvolpath")

OURS, FLOAT64, ANSWER = "emission_absorption", "float64", "answer"

#: Quadratures of ours whose images are those of emission and absorption, and those of the sums in float64.
_QUADRATURES = {OURS: ("exact", "paper", "transmittance"), FLOAT64: ("exact", "paper")}

#: What --left and --right accept, for help and messages.
PLACEHOLDER = "INTEGRATOR|SCENE.xml|FOLDER"


@dataclass(frozen=True)
class Side:
    """One of the two that are compared.

    Attributes:
        text: as it was given.
        kind: one of `PATH_TRACERS`, `OURS`, `FLOAT64`, `ANSWER`, "scene" (a scene file with its own integrator), or
            "pictures" (a folder of OpenEXR pictures).
        quadrature: of `OURS` and `FLOAT64`; "" for others.
        path: of a scene file or folder.
    """

    text: str
    kind: str
    quadrature: str = ""
    path: Path = Path()

    @property
    def free_of_noise(self) -> bool:
        """Whether it gives the same numbers for every seed, for rays through the centres of pixels."""
        return self.kind in (OURS, FLOAT64, ANSWER)


def side_of(flag: str, text: str) -> Side:
    """The side that a text names.

    Args:
        flag: "left" or "right", for messages.
        text: an integrator, `emission_absorption` and `float64` with a quadrature behind a colon if not "exact",
            "answer", a scene file or a folder.

    Raises:
        InputError: it is none of these.
    """
    name, colon, quadrature = text.partition(":")
    if name in _QUADRATURES:
        allowed = _QUADRATURES[name]
        if colon and quadrature not in allowed:
            raise InputError(f"--{flag} {text}: expected {name}:QUADRATURE with one of {', '.join(allowed)}")
        return Side(text, name, quadrature or "exact")
    if text in PATH_TRACERS or text == ANSWER:
        return Side(text, text)
    path = expanded(Path(text))
    if path.is_dir():
        return Side(text, "pictures", path=path)
    if path.suffix.lower() == ".xml":
        if not path.is_file():
            raise InputError(f"--{flag} {text}: no such file, expected a Mitsuba scene")
        return Side(text, "scene", path=path)
    raise InputError(
        f"--{flag} {text}: expected {OURS}[:QUADRATURE], {', '.join(PATH_TRACERS)}, {FLOAT64}[:QUADRATURE], {ANSWER}, "
        "a Mitsuba scene file (.xml), or a folder of OpenEXR pictures"
    )

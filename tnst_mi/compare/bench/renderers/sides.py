"""What can stand on either side of a comparison, from the texts of --left and --right."""

from __future__ import annotations

import re
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
PLACEHOLDER = "INTEGRATOR[@VARIANT]|SCENE.xml[@VARIANT]|FOLDER"

#: What stands behind the name of a side if it is rendered in another variant than that of the run.
_VARIANT = re.compile(r"(?P<name>.+)@(?P<variant>[a-z0-9_]+)")


@dataclass(frozen=True)
class Side:
    """One of the two that are compared.

    Attributes:
        text: as it was given.
        kind: one of `PATH_TRACERS`, `OURS`, `FLOAT64`, `ANSWER`, "scene" (a scene file with its own integrator), or
            "pictures" (a folder of OpenEXR pictures).
        quadrature: of `OURS` and `FLOAT64`; "" for others.
        path: of a scene file or folder.
        variant: of Mitsuba, as it was given; "" for that of the run.
    """

    text: str
    kind: str
    quadrature: str = ""
    path: Path = Path()
    variant: str = ""


def spelled_out(text: str) -> str:
    """The text of a side with the quadrature that it has if it names none."""
    return re.sub(rf"^({OURS}|{FLOAT64})(?=@|$)", r"\1:exact", text)


def side_of(flag: str, text: str) -> Side:
    """The side that a text names.

    Args:
        flag: "left" or "right", for messages.
        text: an integrator, `emission_absorption` and `float64` with a quadrature behind a colon if not "exact",
            "answer", a scene file or a folder; behind @, a variant of Mitsuba for what is rendered.

    Raises:
        InputError: it is none of these.
    """
    found = None if expanded(Path(text)).exists() else _VARIANT.fullmatch(text)
    if found is None:
        return _side(flag, text, text, "")
    side = _side(flag, text, found["name"], found["variant"])
    if side.kind in (FLOAT64, ANSWER, "pictures"):
        raise InputError(f"--{flag} {text}: is not rendered by Mitsuba, expected it without @{side.variant}")
    return side


def _side(flag: str, text: str, named: str, variant: str) -> Side:
    """The side of a name without its variant."""
    name, colon, quadrature = named.partition(":")
    if name in _QUADRATURES:
        allowed = _QUADRATURES[name]
        if colon and quadrature not in allowed:
            raise InputError(f"--{flag} {text}: expected {name}:QUADRATURE with one of {', '.join(allowed)}")
        return Side(text, name, quadrature or "exact", variant=variant)
    if named in PATH_TRACERS or named == ANSWER:
        return Side(text, named, variant=variant)
    path = expanded(Path(named))
    if path.is_dir():
        return Side(text, "pictures", path=path, variant=variant)
    if path.suffix.lower() == ".xml":
        if not path.is_file():
            raise InputError(f"--{flag} {text}: no such file, expected a Mitsuba scene")
        return Side(text, "scene", path=path, variant=variant)
    raise InputError(
        f"--{flag} {text}: expected {OURS}[:QUADRATURE], {', '.join(PATH_TRACERS)}, {FLOAT64}[:QUADRATURE], {ANSWER}, "
        "a Mitsuba scene file (.xml), or a folder of OpenEXR pictures; what Mitsuba renders also with @VARIANT"
    )

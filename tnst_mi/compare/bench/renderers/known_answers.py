"""Scenes whose answers are known, and the file `answers.toml` beside them that states these.

`scenes/known/answers.toml` explains its keys; a folder of one's own may have such a file too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tnst_mi.compare.bench.renderers.parameters import PARAMETERS
from tnst_mi.errors import InputError
from tnst_mi.io.bounded_toml import toml_values
from tnst_mi.machine.gate import opening
from tnst_mi.resources import scene_file

ANSWERS = "answers.toml"

#: The largest file of answers that is read, in bytes.
_LARGEST = 1 << 20

_KEYS = {"radiance", "derivatives", "scatters", "formula", "source"}


@dataclass(frozen=True)
class Answer:
    """What a renderer must find in one scene.

    Attributes:
        radiance: in every pixel of its sensor.
        derivatives: of that, by parameter; see `parameters`.
        scatters: whether light is scattered in it.
        formula: where the numbers come from.
        source: where that is derived.
    """

    radiance: float
    derivatives: dict[str, float]
    scatters: bool
    formula: str
    source: str


def known_scenes() -> dict[Path, Answer]:
    """The scenes that ship with the package, each with its answer.

    Raises:
        InputError: the installation lacks them.
    """
    file = scene_file(f"known/{ANSWERS}")
    return {file.with_name(f"{name}.xml"): _answer(file, name, value) for name, value in _read(file).items()}


def answer_of(scene: Path) -> Answer:
    """The answer of a scene file, from the table of its name in `answers.toml` beside it.

    Raises:
        InputError: there is none, or it is not what is expected.
    """
    file = scene.with_name(ANSWERS)
    answers = _read(file)
    if scene.stem not in answers:
        raise InputError(f"{file}: knows no answer of {scene.name}, expected a table [{scene.stem}] with its radiance")
    return _answer(file, scene.stem, answers[scene.stem])


def _read(file: Path) -> dict[str, Any]:
    with opening(file, "a file of known answers"), file.open("rb") as opened:
        text = opened.read(_LARGEST + 1)
    if len(text) > _LARGEST:
        raise InputError(f"{file}: is larger than {_LARGEST} bytes, expected a file of known answers")
    try:
        return toml_values(text.decode("utf-8"))
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{file}: cannot be read as TOML ({reason})") from None


def _answer(file: Path, name: str, table: Any) -> Answer:
    where = f"{file}: [{name}]"
    if not isinstance(table, dict):
        raise InputError(f"{where} is {table!r}, expected a table with radiance and derivatives")
    if unknown := sorted(table.keys() - _KEYS):
        raise InputError(f"{where} has the key {unknown[0]!r}, expected some of {', '.join(sorted(_KEYS))}")
    derivatives, scatters = table.get("derivatives", {}), table.get("scatters", True)
    if not isinstance(scatters, bool):
        raise InputError(f"{where} scatters is {scatters!r}, expected true or false")
    if not isinstance(derivatives, dict) or not set(derivatives) <= set(PARAMETERS):
        raise InputError(f"{where} derivatives is {derivatives!r}, expected a table of {', '.join(PARAMETERS)}")
    return Answer(
        _number(where, "radiance", table.get("radiance")),
        {key: _number(where, key, value) for key, value in derivatives.items()},
        scatters,
        str(table.get("formula", "")),
        str(table.get("source", "")),
    )


def _number(where: str, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where} {key} is {value!r}, expected a finite number")
    return float(value)

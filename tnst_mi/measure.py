"""What is known of the frames of a run before they are stylized: how bright they are, and which they are."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io.sequence import checked_shapes
from tnst_mi.outputs import is_file_name
from tnst_mi.recipe import Recipe


@dataclass(frozen=True)
class Measure:
    """The largest pixel and the sum of the pixels in a frame's main view, and the SHA-256 of its density."""

    name: str
    brightest: float
    pixel_sum: float
    sha256: str


def measured(frames: Iterable[Frame], recipe: Recipe) -> list[Measure]:
    """Read every frame once, so that bad ones are found before any work, and measure its main view.

    Raises:
        InputError: a frame cannot be read or differs in shape, or its name is double or cannot name files.
    """
    # Looked up late: it can be imported only once a variant is active.
    from tnst_mi.driving import main_view

    measures = []
    for frame in checked_shapes(frames):
        image = main_view(frame.density, recipe)
        digest = hashlib.sha256(frame.density.tobytes()).hexdigest()
        measures.append(Measure(frame.name, float(image.max()), float(image.sum()), digest))
    names = [measure.name for measure in measures]
    for name in names:
        if not is_file_name(name):
            raise InputError(f"frames: the name {name!r} cannot name files, expected one without / and \\")
        if names.count(name) > 1:
            raise InputError(f"frames: the name {name!r} is there more than once, expected one name per frame")
    return measures


def exposure_of(measures: Sequence[Measure]) -> float:
    """1 / the largest pixel of the main views; 1 where all of them are black."""
    brightest = max(measure.brightest for measure in measures)
    return 1.0 / brightest if brightest > 0.0 else 1.0


def require_same_input(measures: Sequence[Measure], run: dict[str, Any], out: Path) -> None:
    """Check that a run to be resumed had these frames.

    Raises:
        InputError: a frame that it finished, or the exposure that it found, was another.
    """
    digests = {measure.name: measure.sha256 for measure in measures}
    for record in run["frames"]:
        if digests.get(record["name"]) != record.get("input_sha256"):
            raise InputError(
                f"{out}: its run stylized another {record['name']} than the input has now; "
                "resume with the same input, or use --overwrite"
            )
    # Frames that are not finished count too: the brightest of all sets the exposure of each.
    exposure = exposure_of(measures)
    if not math.isclose(run["exposure"], exposure, rel_tol=1e-4):
        raise InputError(
            f"{out}: its run had exposure {run['exposure']:g} and the input now gives {exposure:g}: "
            "the frames have changed; resume with the same input, or use --overwrite"
        )

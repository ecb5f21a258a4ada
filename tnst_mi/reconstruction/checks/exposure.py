"""Pictures of `tnst-mi render` are not as bright as their smoke: all of a call have one exposure, up to white."""

from __future__ import annotations

from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.io.pictures.exr import header_numbers
from tnst_mi.machine.gate import opening
from tnst_mi.reconstruction.settings import ReconstructionSettings


def require_brightness(file: Path, settings: ReconstructionSettings) -> None:
    """Check that the brightness of smoke in a picture is not taken to be 1/γ where its header says otherwise.

    Args:
        file: an OpenEXR picture; of others, and of those without the header, nothing is known.
        settings: by which it is read.

    Raises:
        InputError: it is, or the file cannot be read.
    """
    presumed = settings.integrator == "emission_absorption" and settings.brightness == "1/gamma"
    if not presumed or settings.gamma == "auto" or settings.channel == "alpha" or file.suffix.lower() != ".exr":
        return
    if not file.is_file():
        return
    with opening(file, "a picture"):
        numbers = header_numbers(file)
    exposure, gamma = numbers.get("exposure", 1.0), numbers.get("gamma", 0.0)
    if exposure not in (0.0, 1.0) and gamma > 0:
        raise InputError(
            f"{file}: its light was multiplied by the exposure {exposure:.6g}, so that the brightness of its smoke is "
            f"{exposure / gamma:.4g}, expected 1/gamma = {1 / float(settings.gamma):.4g}; give --gamma {gamma:g} "
            f"--brightness {exposure / gamma:.6g}, or --brightness auto"
        )

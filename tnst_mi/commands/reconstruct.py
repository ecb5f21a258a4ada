"""`tnst-mi reconstruct`: pictures and cameras in, a density out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from tnst_mi.commands.base import given, say
from tnst_mi.commands.reconstruct_arguments import ReconstructArguments
from tnst_mi.errors import StoppedError
from tnst_mi.machine.backend import activate
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.reconstruction.settings import read_flags

#: It imports torch, and mistakes in flags are found without it.
reconstruction = LazyModule("tnst_mi.reconstruction.reconstruct")


def run(arguments: ReconstructArguments) -> int:
    """Reconstruct, and say how well the views that were held out are shown."""
    texts = {name: text for name, text in asdict(arguments.settings).items() if text is not None}
    settings = read_flags(texts)
    activate(Recipe().updated_by_flags(given(arguments.device)).variant)
    found = reconstruction.reconstruct(
        arguments.cameras,
        arguments.out,
        settings,
        frames=arguments.frames,
        velocities=arguments.velocities,
        format=arguments.format,
        resume=arguments.resume,
        overwrite=arguments.overwrite,
    )
    say(found.remarks)
    for record, file in zip(found.records, found.densities, strict=True):
        print(f"density   {file}: {_judgement(record)}, gamma {record['gamma']:.4g}{_light(record)}")
    print(f"report    {arguments.out / 'report.html'}")
    if found.interrupted:
        raise StoppedError(f"interrupted; {found.densities[-1]} is as far as it got, --resume continues")
    return 0


def _judgement(record: Mapping[str, Any]) -> str:
    """How well the views of a frame that were held out are shown."""
    masked = ", ".join(record["masked_views"])
    nothing = f"; masks leave nothing of {masked}" if masked else ""
    if not record["psnr_of_views"]:
        return f"no view judges it{nothing}" if masked else "no view was held out"
    same = record["psnr"] is None
    return f"held-out views {'are the same' if same else format(record['psnr'], '.1f') + ' dB'}{nothing}"


def _light(record: Mapping[str, Any]) -> str:
    """The brightness and the background of a frame, which smoke that scatters light does not have."""
    if record["brightness"] is None:
        return ""
    return f", brightness {record['brightness']:.4g}, background {record['background']:.3g}"

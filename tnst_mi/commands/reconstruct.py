"""`tnst-mi reconstruct`: pictures and cameras in, a density out."""

from __future__ import annotations

from dataclasses import asdict

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
        psnr = "no view was held out" if record["psnr"] is None else f"held-out views {record['psnr']:.1f} dB"
        light = f", gamma {record['gamma']:.4g}, brightness {record['brightness']:.4g}"
        print(f"density   {file}: {psnr}{light}, background {record['background']:.3g}")
    print(f"report    {arguments.out / 'report.html'}")
    if found.interrupted:
        raise StoppedError(f"interrupted; {found.densities[-1]} is as far as it got, --resume continues")
    return 0

"""`tnst-mi compare`: our integrator against Mitsuba's path tracer, references in float64 and finite differences."""

from __future__ import annotations

import statistics
from dataclasses import replace
from typing import TYPE_CHECKING

from tnst_mi.commands.base import checked
from tnst_mi.commands.compare_arguments import FULL_DIRECTIONS, FULL_SPP, CompareArguments, SideFlags
from tnst_mi.commands.compare_input import read_smoke, views_and_gammas
from tnst_mi.commands.compare_sides import run_sides
from tnst_mi.compare.comparison import Settings, compare, require_light
from tnst_mi.errors import InputError
from tnst_mi.machine.backend import activate
from tnst_mi.machine.disk import require_writable
from tnst_mi.machine.environment import device, peak_memory, versions
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.machine.optix import require_optix
from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.recipe.keys import Integer
from tnst_mi.recipe.recipe import KINDS

if TYPE_CHECKING:
    from tnst_mi.compare import report as written
else:
    # It imports matplotlib, and mistakes in flags are found without it.
    written = LazyModule("tnst_mi.compare.report")

_QUICK_SPP, _QUICK_DIRECTIONS = 64, 16

#: Derivatives need fewer paths than images: every path contributes to many voxels.
_GRADIENT_SHARE = 4


def run(arguments: CompareArguments) -> int:
    """Measure, write the report, print the verdict."""
    if arguments.sides != SideFlags():
        return run_sides(arguments)
    if arguments.input.suffix.lower() == ".xml":
        raise InputError(f"{arguments.input}: is a Mitsuba scene, expected --left and --right, which render it")
    settings = _settings(arguments)
    remedy = None if arguments.overwrite else "give another folder, or write into this one with --overwrite"
    require_writable(arguments.out, remedy=remedy)
    smoke = read_smoke(arguments, settings.views)
    settings = replace(settings, views=smoke.views)
    require_light(smoke.density, settings)
    variant = activate()
    require_optix("compare")
    smoke.note()
    layout = "{desc:24s} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
    with progress_bar(total=1.0, bar_format=layout) as bar:

        def report(name: str, share: float) -> None:
            bar.set_description_str(name, refresh=False)
            bar.update(min(share, 1.0 - bar.n))  # shares may add up to slightly more than 1

        results = compare(smoke.density, settings, report)
        report("report", 0.0)
        environment = {
            "versions": versions(),
            "device": device(variant),
            "density_scale": smoke.unit.factor,
            "seconds": bar.format_dict["elapsed"],
            "peak_memory": peak_memory(),
        }
        passed = written.write_report(arguments.out, smoke.name, settings, results, environment)
    for study in results.studies:
        print(study.in_words())
    print(f"report    {arguments.out / 'report.html'}")
    print(f"verdict   {written.verdict_line(results)}")
    return 0 if passed else 1


def _settings(arguments: CompareArguments) -> Settings:
    """What to compare, and how precisely; raises InputError for invalid values."""
    quick = arguments.quick
    views, gammas = views_and_gammas(arguments)
    spp = checked("spp", arguments.spp or str(_QUICK_SPP if quick else FULL_SPP), Integer(32, 1 << 24))
    directions = arguments.directions or str(_QUICK_DIRECTIONS if quick else FULL_DIRECTIONS)
    directions = checked("directions", directions, Integer(3, 10_000))
    seed = checked("seed", arguments.seed, KINDS["seed"])
    return Settings(
        views=views,
        gammas=gammas,
        gradient_gammas=(statistics.median_low(gammas),) if quick else gammas,
        spp=spp,
        gradient_spp=max(16, spp // _GRADIENT_SHARE),
        directions=directions,
        seed=seed,
    )

"""`tnst-mi compare`: our integrator against Mitsuba's path tracer, references in float64 and finite differences."""

from __future__ import annotations

import statistics
from dataclasses import replace
from typing import TYPE_CHECKING

from tnst_mi.commands.arguments import COMPARE_VIEWS, FULL_DIRECTIONS, FULL_SPP, CompareArguments
from tnst_mi.commands.base import cameras_of, checked, given, say, unit_of, view_of
from tnst_mi.compare.comparison import Settings, compare, require_light
from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import scaled
from tnst_mi.io import open_frames
from tnst_mi.machine.backend import activate
from tnst_mi.machine.disk import require_writable
from tnst_mi.machine.environment import device, peak_memory, versions
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.machine.optix import require_optix
from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.recipe.keys import Integer, Number
from tnst_mi.recipe.recipe import KINDS, Recipe
from tnst_mi.rendering.cameras.shots import camera_of, shot_view
from tnst_mi.run.inputs import conventions_of
from tnst_mi.run.readable import Readable

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
    settings = _settings(arguments)
    remedy = None if arguments.overwrite else "give another folder, or write into this one with --overwrite"
    require_writable(arguments.out, remedy=remedy)
    recipe = Recipe().updated_by_flags(given(arguments.reading))
    camera = arguments.camera
    cameras = None if camera is None else cameras_of(camera, arguments.views, COMPARE_VIEWS, recipe.flip)
    readable = Readable(open_frames(arguments.input, recipe.frame_range, conventions_of(recipe))[:1])
    frame = next(iter(readable))
    if cameras is not None:
        shape = frame.density.shape
        settings = replace(settings, views=(shot_view(camera_of(cameras, frame, shape), shape).view,))
    unit = unit_of([frame], arguments.density_scale)
    density = scaled(frame.density, unit.factor)
    if not density.any():
        raise InputError(f"{arguments.input}: the density is 0 everywhere, expected smoke to compare renderers on")
    require_light(density, settings)
    variant = activate()
    require_optix("compare")
    say(readable.lines())
    unit.note()
    layout = "{desc:24s} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
    with progress_bar(total=1.0, bar_format=layout) as bar:

        def report(name: str, share: float) -> None:
            bar.set_description_str(name, refresh=False)
            bar.update(min(share, 1.0 - bar.n))  # shares may add up to slightly more than 1

        results = compare(density, settings, report)
        report("report", 0.0)
        environment = {
            "versions": versions(),
            "device": device(variant),
            "density_scale": unit.factor,
            "seconds": bar.format_dict["elapsed"],
            "peak_memory": peak_memory(),
        }
        passed = written.write_report(arguments.out, frame.name, settings, results, environment)
    for study in results.studies:
        print(study.in_words())
    print(f"report    {arguments.out / 'report.html'}")
    print(f"verdict   {written.verdict_line(results)}")
    return 0 if passed else 1


def _settings(arguments: CompareArguments) -> Settings:
    """What to compare, and how precisely; raises InputError for invalid values."""
    quick = arguments.quick
    views = tuple(view_of(text) for text in arguments.views)
    gammas = tuple(checked("gamma", text, Number(above=0.0, high=1e4)) for text in arguments.gamma)
    spp = checked("spp", arguments.spp or str(_QUICK_SPP if quick else FULL_SPP), Integer(32, 1 << 24))
    directions = arguments.directions or str(_QUICK_DIRECTIONS if quick else FULL_DIRECTIONS)
    directions = checked("directions", directions, Integer(3, 10_000))
    seed = checked("seed", arguments.seed, KINDS["seed"])
    for flag, values in (("views", views), ("gamma", gammas)):
        if len(set(values)) < max(len(values), 1):
            raise InputError(f"--{flag}: expected one or more different values")
    return Settings(
        views=views,
        gammas=gammas,
        gradient_gammas=(statistics.median_low(gammas),) if quick else gammas,
        spp=spp,
        gradient_spp=max(16, spp // _GRADIENT_SHARE),
        directions=directions,
        seed=seed,
    )

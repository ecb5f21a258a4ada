"""`tnst-mi compare --left A --right B`: any two renderers, on smoke or on a Mitsuba scene."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tnst_mi.commands.base import checked
from tnst_mi.commands.compare_arguments import COMPARE_VIEWS, FULL_SPP, CompareArguments
from tnst_mi.commands.compare_input import ComparedSmoke, read_smoke, views_and_gammas
from tnst_mi.compare.bench.baseline import held_against, read_baseline, require_same, require_same_tests
from tnst_mi.compare.bench.bench_settings import BenchSettings
from tnst_mi.compare.bench.measurement import measure, prepare
from tnst_mi.compare.bench.record import record_of
from tnst_mi.compare.bench.renderers.parameters import parameter_names
from tnst_mi.compare.bench.renderers.sides import OURS, side_of
from tnst_mi.compare.bench.renderers.smoke_scene import SmokeScene
from tnst_mi.errors import InputError
from tnst_mi.machine.backend import activate
from tnst_mi.machine.disk import require_writable
from tnst_mi.machine.environment import device, versions
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.machine.optix import require_optix
from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.recipe.keys import Integer, Number
from tnst_mi.recipe.paths import LIGHTS, shipped_lights
from tnst_mi.recipe.recipe import KINDS
from tnst_mi.rendering.cameras.views import text_of
from tnst_mi.resources import expanded

if TYPE_CHECKING:
    from tnst_mi.compare.bench import bench_report as written
else:
    # It imports matplotlib, and mistakes in flags are found without it.
    written = LazyModule("tnst_mi.compare.bench.bench_report")

_QUICK_SPP, _LEAST_SPP = 64, 32


def run_sides(arguments: CompareArguments) -> int:
    """Measure, write the report, print the verdict."""
    flags = arguments.sides
    settings = _settings(arguments)
    baseline = None if flags.baseline is None else read_baseline(flags.baseline)
    remedy = None if arguments.overwrite else "give another folder, or write into this one with --overwrite"
    require_writable(arguments.out, remedy=remedy)
    variant = activate()
    require_optix("compare")
    subject, described, smoke = _subject(arguments, settings)
    if baseline is not None:
        require_same(baseline, described, settings)
    prepared = prepare(subject, settings)
    if arguments.spp is None and not arguments.quick:
        settings = settings.with_more_where_pixels_are_few(prepared[0].shape)
    views = ("0",)
    if smoke is not None:
        views = tuple(text_of(view) for view in smoke.views)
        smoke.note()
    layout = "{desc:24s} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
    with progress_bar(total=1.0, bar_format=layout) as bar:

        def report(name: str, share: float) -> None:
            bar.set_description_str(name or "images", refresh=False)
            bar.update(min(share, 1.0 - bar.n))  # shares may add up to slightly more than 1

        measured = measure(prepared, views, settings, report)
        record = record_of(described, settings, measured)
        passed = record["outcome"] == "agree"
        if baseline is not None:
            families = measured.families()
            require_same_tests(baseline, families)
            record["baseline"] = held_against(baseline, families)
            passed = record["baseline"]["outcome"] == "unchanged"
        record |= {"versions": versions(), "device": device(variant), "seconds": bar.format_dict["elapsed"]}
        report("report", 0.0)
        written.write_bench(arguments.out, settings, measured, record)
    for line in record["not_tested"]:
        print(f"untested  {line}")
    print(f"report    {arguments.out / 'report.html'}")
    print(f"verdict   {record['verdict']}")
    if "baseline" in record:
        print(f"baseline  {record['baseline']['verdict']}")
    return 0 if passed else 1


def _settings(arguments: CompareArguments) -> BenchSettings:
    """What to compare, and how precisely; raises InputError for invalid values."""
    flags = arguments.sides
    if arguments.directions is not None:
        raise InputError("--directions: is of comparisons without --left and --right; give --gradients")
    _, gammas = views_and_gammas(arguments)
    spp = arguments.spp or str(_QUICK_SPP if arguments.quick else FULL_SPP)
    spp = checked("spp", spp, Integer(_LEAST_SPP, 1 << 24))
    settings = BenchSettings(
        left=side_of("left", flags.left or f"{OURS}:exact"),
        right=side_of("right", flags.right or "prbvolpath"),
        gammas=gammas,
        spp=0,
        gradient_spp=0,
        parameters=parameter_names(flags.gradients),
        tolerance=checked("tolerance", flags.tolerance or "0.001", Number(0.0, 1.0)),
        seed=checked("seed", arguments.seed, KINDS["seed"]),
    )
    return settings.with_paths(spp)


def _subject(
    arguments: CompareArguments, settings: BenchSettings
) -> tuple[SmokeScene | Path, dict[str, Any], ComparedSmoke | None]:
    """What both sides render, its description in the report, and the frame if it is one."""
    flags, path = arguments.sides, expanded(arguments.input)
    if path.suffix.lower() == ".xml":
        _require_no_smoke_flags(arguments)
        if not path.is_file():
            raise InputError(f"{path}: no such file, expected a Mitsuba scene")
        return path, {"input": path.name, "sha256": _sha256(path)}, None
    views, _ = views_and_gammas(arguments)
    albedo = checked("albedo", flags.albedo or "0", Number(0.0, 1.0))
    anisotropy = checked("anisotropy", flags.anisotropy or "0", Number(-0.99, 0.99))
    if not albedo:
        for flag, text in (("anisotropy", flags.anisotropy), ("light", flags.light)):
            if text is not None:
                raise InputError(f"--{flag} {text}: is of smoke that scatters, expected --albedo above 0")
    light = flags.light or "environment"
    file = LIGHTS / f"{light}.xml" if light in shipped_lights() else expanded(Path(light))
    found = read_smoke(arguments, views)
    smoke = SmokeScene(found.density, found.views, albedo, anisotropy, file if albedo else None)
    described = {
        "input": found.name,
        "sha256": hashlib.sha256(found.density.tobytes()).hexdigest(),
        "shape": list(found.density.shape),
        "views": [list(view) for view in found.views],
        "gammas": list(settings.gammas),
        "albedo": albedo,
        "anisotropy": anisotropy,
        "light": light if albedo else None,
        "light_sha256": _sha256(file) if albedo and file.is_file() else None,
        "density_scale": found.unit.factor,
    }
    return smoke, described, found


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _require_no_smoke_flags(arguments: CompareArguments) -> None:
    """A scene has its own views, extinctions and lights."""
    default = CompareArguments(input=arguments.input, out=arguments.out)
    given = {
        "views": arguments.views != COMPARE_VIEWS,
        "camera": arguments.camera is not None,
        "gamma": arguments.gamma != default.gamma,
        "density-scale": arguments.density_scale != default.density_scale,
        "albedo": arguments.sides.albedo is not None,
        "anisotropy": arguments.sides.anisotropy is not None,
        "light": arguments.sides.light is not None,
    }
    for flag, is_given in given.items():
        if is_given:
            raise InputError(f"--{flag}: is of a density, and {arguments.input} is a scene that has its own")

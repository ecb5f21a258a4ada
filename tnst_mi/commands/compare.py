"""`tnst-mi compare`: our integrator against Mitsuba's path tracer, a closed form and finite differences."""

from __future__ import annotations

import statistics
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from tnst_mi.commands.base import Command, Folder, view_of
from tnst_mi.errors import InputError
from tnst_mi.recipe.keys import Integer
from tnst_mi.recipe.recipe import KINDS

_SPP, _QUICK_SPP = 256, 64
_DIRECTIONS, _QUICK_DIRECTIONS = 64, 16

#: Derivatives need fewer paths than images: every path adds to many voxels.
_GRADIENT_SHARE = 4


@dataclass(kw_only=True)
class Compare(Command):
    """Compare our images and gradients of a density file with those of Mitsuba's path tracer, prbvolpath.

    Writes report.html, report.json, figures and EXR images, and ends with a verdict: exit code 0 if all checks pass, 1
    if not. A folder of numbered files is represented by its first one.
    """

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="INPUT")]
    """Density file or folder of numbered ones."""
    out: Folder
    """New or empty folder for the report."""
    views: Annotated[tuple[str, ...], tyro.conf.arg(metavar="AZIMUTH,ELEVATION…")] = ("0,0", "35,12", "-80,-25")
    """Views in degrees, one or more; 0,0 is the front, + is to the right and upwards."""
    gamma: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NUMBER…")] = ("0.05", "0.5", "2")
    """Extinctions γ for density 1, per cell, one or more."""
    spp: Annotated[str | None, tyro.conf.arg(metavar="INTEGER", help_behavior_hint=f"(default: {_SPP})")] = None
    """Paths per pixel, 32 or more; a quarter of them for gradients."""
    directions: Annotated[
        str | None, tyro.conf.arg(metavar="INTEGER", help_behavior_hint=f"(default: {_DIRECTIONS})")
    ] = None
    """Random smooth directions for derivatives, 3 or more."""
    quick: bool = False
    """Fewer paths and directions, and gradients at the middle γ alone."""
    seed: Annotated[str, tyro.conf.arg(metavar="INTEGER")] = "0"
    """Seed of paths and directions."""
    overwrite: bool = False
    """Write into a folder that is not empty, replacing files of the same names."""

    def run(self) -> int:
        """Measure, write the report, print the verdict."""
        views = tuple(view_of(text) for text in self.views)
        gammas = tuple(_checked("gamma", text, KINDS["gamma"]) for text in self.gamma)
        spp = _checked("spp", self.spp or (_QUICK_SPP if self.quick else _SPP), Integer(32, 1 << 24))
        directions = self.directions or (_QUICK_DIRECTIONS if self.quick else _DIRECTIONS)
        directions = _checked("directions", directions, Integer(3, 10_000))
        seed = _checked("seed", self.seed, KINDS["seed"])
        for flag, given in (("views", views), ("gamma", gammas)):
            if len(set(given)) < max(len(given), 1):
                raise InputError(f"--{flag}: expected one or more different values")

        from tqdm import tqdm

        from tnst_mi.io import open_frames
        from tnst_mi.machine.backend import activate
        from tnst_mi.machine.disk import require_writable
        from tnst_mi.machine.environment import device, peak_memory, versions

        remedy = None if self.overwrite else "give another folder, or write into this one with --overwrite"
        require_writable(self.out, remedy=remedy)
        frame = open_frames(self.input)[0]
        if not frame.density.any():
            raise InputError(f"{self.input}: the density is 0 everywhere, expected smoke to compare renderers on")
        variant = activate()
        from tnst_mi.compare.comparison import Settings, compare
        from tnst_mi.compare.report import verdict_line, write_report

        settings = Settings(
            views=views,
            gammas=gammas,
            gradient_gammas=(statistics.median_low(gammas),) if self.quick else gammas,
            spp=spp,
            gradient_spp=max(16, spp // _GRADIENT_SHARE),
            directions=directions,
            seed=seed,
        )
        layout = "{desc:24s} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
        with tqdm(total=1.0, bar_format=layout, dynamic_ncols=True, file=sys.stderr) as bar:

            def report(name: str, share: float) -> None:
                bar.set_description_str(name, refresh=False)
                bar.update(min(share, bar.total - bar.n))  # shares may add up to slightly more than 1

            results = compare(frame.density, settings, report)
            report("report", 0.0)
            environment = {
                "versions": versions(),
                "device": device(variant),
                "seconds": bar.format_dict["elapsed"],
                "peak_memory": peak_memory(),
            }
            passed = write_report(self.out, frame.name, settings, results, environment)
        for study in results.studies:
            print(study.in_words())
        print(f"report    {self.out / 'report.html'}")
        print(f"verdict   {verdict_line(results.checks())}")
        return 0 if passed else 1


def _checked(flag: str, given: str | int, kind: object) -> float | int:
    try:
        return kind.check(kind.read(str(given)))
    except (ValueError, OverflowError):
        raise InputError(f"--{flag} {given}: expected {kind.expected}") from None

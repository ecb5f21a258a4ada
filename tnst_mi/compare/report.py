"""The output of a comparison: the verdict, a self-contained HTML page, its figures, EXR images and numbers.

report.html   everything, with pictures       report.json   every number and check
figures/*.png                                 images/*.exr  exact, paper, prbvolpath, closed form and z-scores
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.compare import figures
from tnst_mi.compare.comparison import Results, Settings
from tnst_mi.compare.gradients import Directional
from tnst_mi.compare.paper_quadrature import PaperGradient, PaperImages
from tnst_mi.compare.quadrature_study import STEPS, QuadratureStudy
from tnst_mi.compare.values import Comparison, relative_rms
from tnst_mi.compare.verdict import Check
from tnst_mi.io.pictures.exr import write_exr
from tnst_mi.io.report_page import page, write_text
from tnst_mi.rendering.cameras.views import text_of


def write_report(out: Path, name: str, settings: Settings, results: Results, environment: dict[str, Any]) -> bool:
    """Write everything into a folder; return whether all checks passed."""
    checks = results.checks()
    passed = all(check.passed for check in checks)
    for values in results.values:
        _write_images(out / "images", values)
    pictures = _draw(out / "figures", results)
    record = {
        "input": name,
        "verdict": verdict_line(results),
        "passed": passed,
        "settings": vars(settings),
        "checks": [vars(check) for check in checks],
        **_numbers(results),
        **environment,
    }
    write_text(out / "report.json", json.dumps(record, indent=1, allow_nan=False, default=str) + "\n")
    write_text(out / "report.html", _page(name, settings, results, pictures))
    return passed


def verdict_line(results: Results) -> str:
    """One line: whether all checks passed, otherwise the first that failed, and what holds of each quadrature."""
    checks = results.checks()
    failed = [check for check in checks if not check.passed]
    outcome = f"agree: all {len(checks)} checks passed"
    if failed:
        first = failed[0]
        outcome = (
            f"DISAGREE: {len(failed)} of {len(checks)} checks failed, the first: {first.name}: {first.measured} "
            f"(expected {first.expected})"
        )
    departures = ", ".join(f"{images.departure:.1%} at γ {images.gamma:g}" for images in results.paper_images)
    return (
        f"{outcome}; “exact” against prbvolpath, the closed form and central differences: {_passed(checks, 'exact')}; "
        f"“paper”, another discretisation, which drives a stylization by default, against its own sum in float64 and "
        f"central differences: {_passed(checks, 'paper')}; “paper” is {departures} (RMS) from the continuous integral"
    )


def _passed(checks: Sequence[Check], quadrature: str) -> str:
    about = [check.passed for check in checks if check.quadrature == quadrature]
    return f"{sum(about)} of {len(about)} passed"


def _write_images(folder: Path, values: Comparison) -> None:
    stem = f"view_{text_of(values.view, '_')}_gamma_{values.gamma:g}"
    images = {
        "exact": (values.exact, "exact"),
        "paper": (values.paper, "paper"),
        "prbvolpath": (values.traced, "prbvolpath"),
        "closed_form": (values.closed, "closed form"),
        "z": (values.z, "z-score of prbvolpath − exact"),
    }
    for name, (image, quadrature) in images.items():
        attributes = {"view": values.view, "gamma": values.gamma, "quadrature": quadrature, "exposure": 1.0}
        write_exr(folder / f"{stem}_{name}.exr", image, attributes)


def _draw(folder: Path, results: Results) -> dict[str, Path]:
    drawn = {"z": figures.z_figure(results.values), "convergence": figures.convergence_figure(results.convergence)}
    for gamma in sorted({values.gamma for values in results.values}):
        drawn[f"images_{gamma:g}"] = figures.image_figure([v for v in results.values if v.gamma == gamma])
    drawn["directions"] = figures.directional_figure(results.directional)
    for fields in results.fields:
        drawn[f"gradient_{fields.gamma:g}"] = figures.field_figure(fields)
    drawn["paper"] = figures.paper_figure(results.paper_images, results.paper_gradients)
    drawn["orders"] = figures.order_figure(results.studies)
    drawn["departure"] = figures.departure_figure(results.studies)
    for name, figure in drawn.items():
        figures.write_figure(folder / f"{name}.png", figure)
    return {name: folder / f"{name}.png" for name in drawn}


# --------------------------------------------------------------------
# report.json
# --------------------------------------------------------------------


def _numbers(results: Results) -> dict[str, Any]:
    return {
        "values": [_value_numbers(values) for values in results.values],
        "convergence": [{**vars(c), "slope": c.slope} for c in results.convergence],
        "directions": [_directional_numbers(directional) for directional in results.directional],
        "fields": [
            {"gamma": f.gamma, "spp": f.spp, "central_error": f.central_error, "slope": f.slope} for f in results.fields
        ],
        "paper_images": [_paper_image_numbers(images) for images in results.paper_images],
        "paper_gradients": [_paper_gradient_numbers(gradient) for gradient in results.paper_gradients],
        "exact_departures": _exact_departures(results),
        "quadratures": [_study_numbers(study) for study in results.studies],
    }


def _value_numbers(values: Comparison) -> dict[str, Any]:
    names = (
        *("view", "gamma", "spp", "step", "outside", "mean_z", "untestable_difference", "untestable_paths"),
        *("discretisation", "coarse_z"),
    )
    return {"testable": int(values.testable.sum())} | {name: getattr(values, name) for name in names}


def _directional_numbers(directional: Directional) -> dict[str, Any]:
    names = ("gamma", "spp", "step", "slope", "slope_interval", "correlation", "covered")
    arrays = ("ours", "traced", "interval", "central", "paper", "paper_central")
    return (
        {name: getattr(directional, name) for name in names}
        | {name: getattr(directional, name) for name in ("traced_error", "central_error", "paper_error")}
        | {f"derivatives_{name}": np.asarray(getattr(directional, name)).tolist() for name in arrays}
    )


def _paper_image_numbers(images: PaperImages) -> dict[str, Any]:
    largest = [float(np.abs(deviation).max()) for deviation in images.deviations]
    names = ("gamma", "views", "relative_errors", "departure")
    return {name: getattr(images, name) for name in names} | {"largest_deviations": largest}


def _paper_gradient_numbers(gradient: PaperGradient) -> dict[str, Any]:
    return {name: getattr(gradient, name) for name in ("gamma", "pixels", "error", "tolerance")}


def _exact_departures(results: Results) -> dict[float, float]:
    """For each γ, the RMS of "exact" with a step of one cell minus the closed form, over that of the closed form."""
    departures = {}
    for gamma in sorted({values.gamma for values in results.values}):
        views = [values for values in results.values if values.gamma == gamma]
        departures[gamma] = relative_rms(np.stack([v.coarse for v in views]), np.stack([v.closed for v in views]))
    return departures


def _study_numbers(study: QuadratureStudy) -> dict[str, Any]:
    names = ("gamma", "view", "exact", "paper", "exact_order", "paper_order", "densest", "departure")
    return {"steps": STEPS} | {name: getattr(study, name) for name in names} | {"in_words": study.in_words()}


# --------------------------------------------------------------------
# report.html
# --------------------------------------------------------------------


def _page(name: str, settings: Settings, results: Results, pictures: dict[str, Path]) -> str:
    checks = results.checks()
    return page(
        "compare.html",
        name=name,
        settings=settings,
        results=results,
        checks=checks,
        passed=all(check.passed for check in checks),
        verdict=verdict_line(results),
        passes={name: _passed(checks, name) for name in ("exact", "paper")},
        exact_departures=_exact_departures(results),
        gammas=sorted({values.gamma for values in results.values}),
        encoded=lambda key: base64.b64encode(pictures[key].read_bytes()).decode("ascii"),
    )

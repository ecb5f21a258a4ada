"""What a comparison leaves behind: an HTML page that needs no other file, its figures, EXR images and numbers.

report.html   everything, pictures inside     report.json   every number and check
figures/*.png                                 images/*.exr  exact, paper, prbvolpath, closed form and z-scores
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.compare import figures
from tnst_mi.compare.comparison import Results, Settings
from tnst_mi.compare.gradients import Directional
from tnst_mi.compare.quadrature_study import STEPS, QuadratureStudy
from tnst_mi.compare.values import Comparison
from tnst_mi.compare.verdict import Check
from tnst_mi.io.atomic import written_whole
from tnst_mi.io.pictures.exr import write_exr

_STYLE = """
body { font: 16px/1.5 sans-serif; max-width: 1200px; margin: 2em auto; padding: 0 1em; color: #222; background: #fff }
img { max-width: 100%; display: block; margin: 1em 0 }
table { border-collapse: collapse; font-size: 14px }
td, th { padding: 2px 12px 2px 0; text-align: left; border-bottom: 1px solid #ddd }
.verdict { font-size: 20px; padding: .5em .8em; border-left: 8px solid }
.passed { border-color: #2a7 } .failed { border-color: #c33 } td.failed { color: #c33; font-weight: bold }
"""

_METHOD = (
    "Smoke of density d emits d and absorbs γd per cell. Emission over extinction is the constant 1/γ, so the "
    "continuous image is I = (1 − T)/γ with T = exp(−γ∫d). T is also what Mitsuba’s path tracer prbvolpath sees of a "
    "constant environment through the same, purely absorbing smoke: an estimate that is independent of our integrator "
    "and free of bias. Its paths are traced along our rays, through the pixel centres."
)
_IMAGES = (
    "A path is absorbed or escapes, so the standard error of a pixel is √(T(1 − T)/n)/γ, known from our own T. The "
    "z-score is the difference in standard errors; pixels with nT(1 − T) &lt; 5 are too nearly empty or opaque for it "
    "and are judged by their absolute difference. The step of “exact” is halved until no testable pixel changes by 0.1 "
    "standard errors; “paper” keeps its step of one cell. The closed form is computed apart from both, in float64."
)
_GRADIENTS = (
    "The objective is the sum of the “exact” images, weighted by smooth random images. Its derivatives are taken by "
    "our reverse mode, by that of prbvolpath (on the same rays), and by central differences of our images. Random "
    "directions are smooth noise where the smoke is. Errors are relative to the RMS of the derivatives."
)
_FIELDS = (
    "The gradient of every voxel, for the view 0, 0 alone; of each stack along z the value largest in magnitude. The "
    "medium of prbvolpath ends two cells outside the smoke."
)
_QUADRATURES = (
    "“exact” is opacity over γ: the continuous formula has no more in it, whatever the order of the smoke along the "
    "ray. What the paper calls the product of density and transmittance is its inclusive sum’s discretisation. It "
    "shows where γhd ≳ 1: dense smoke darkens by the factor x/(eˣ − 1), x = γhd, and thin rims stay bright. Recipes "
    "for thick smoke rely on that, and their look changes with the resolution."
)


def write_report(out: Path, name: str, settings: Settings, results: Results, environment: dict[str, Any]) -> bool:
    """Write everything into a folder; whether all checks passed."""
    checks = results.checks()
    passed = all(check.passed for check in checks)
    for values in results.values:
        _write_images(out / "images", values)
    pictures = _draw(out / "figures", results)
    record = {
        "input": name,
        "verdict": verdict_line(checks),
        "passed": passed,
        "settings": vars(settings),
        "checks": [vars(check) for check in checks],
        **_numbers(results),
        **environment,
    }
    _write_text(out / "report.json", json.dumps(record, indent=1, allow_nan=False, default=str) + "\n")
    _write_text(out / "report.html", _page(name, settings, results, checks, pictures))
    return passed


def verdict_line(checks: Sequence[Check]) -> str:
    """One line: whether the renderers agree, and otherwise the first check that failed."""
    failed = [check for check in checks if not check.passed]
    if not failed:
        return f"agree: all {len(checks)} checks passed"
    first = failed[0]
    return (
        f"DISAGREE: {len(failed)} of {len(checks)} checks failed, the first: {first.name}: {first.measured} "
        f"(expected {first.expected})"
    )


def _write_images(folder: Path, values: Comparison) -> None:
    stem = f"view_{values.view[0]:g}_{values.view[1]:g}_gamma_{values.gamma:g}"
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
        "quadratures": [_study_numbers(study) for study in results.studies],
    }


def _value_numbers(values: Comparison) -> dict[str, Any]:
    names = (
        *("view", "gamma", "spp", "step", "outside", "mean_z", "untestable_difference", "untestable_paths"),
        *("discretisation", "coarse_z", "paper_error", "paper_departure"),
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


def _study_numbers(study: QuadratureStudy) -> dict[str, Any]:
    names = ("gamma", "view", "exact", "paper", "exact_order", "paper_order", "densest", "departure")
    return {"steps": STEPS} | {name: getattr(study, name) for name in names} | {"in_words": study.in_words()}


# --------------------------------------------------------------------
# report.html
# --------------------------------------------------------------------


def _page(name: str, settings: Settings, results: Results, checks: Sequence[Check], pictures: dict[str, Path]) -> str:
    def picture(key: str, alternative: str) -> str:
        data = base64.b64encode(pictures[key].read_bytes()).decode("ascii")
        return f'<img alt="{html.escape(alternative)}" src="data:image/png;base64,{data}">'

    line = verdict_line(checks)
    outcome = "passed" if all(check.passed for check in checks) else "failed"
    paths = f"{settings.spp} paths per pixel for images, {settings.gradient_spp} for gradients; seed {settings.seed}."
    body = [
        f"<h1>{html.escape(name)}: our integrator against Mitsuba’s path tracer</h1>",
        f'<p class="verdict {outcome}">{html.escape(line)}</p>',
        f"<p>{_METHOD}</p>",
        f"<p>{paths}</p>",
        f"<h2>Images</h2><p>{_IMAGES}</p>",
        *(picture(f"images_{g:g}", f"images at γ = {g:g}") for g in sorted({v.gamma for v in results.values})),
        picture("z", "histograms of the z-scores"),
        picture("convergence", "error against the number of paths"),
        f"<h2>Gradients</h2><p>{_GRADIENTS}</p>",
        picture("directions", "derivatives along random directions"),
        f"<p>{_FIELDS}</p>",
        *(picture(f"gradient_{f.gamma:g}", f"gradients at γ = {f.gamma:g}") for f in results.fields),
        "<h2>Quadratures</h2>",
        "<p>Error against step size, relative to the closed form, and the fitted order.</p>",
        picture("orders", "error against step size"),
        f"<p>{_QUADRATURES}</p>",
        "<ul>" + "".join(f"<li>{html.escape(study.in_words())}</li>" for study in results.studies) + "</ul>",
        picture("departure", "paper against exact"),
        "<h2>Checks</h2>",
        "<table><tr><th>check</th><th>measured</th><th>expected</th><th></th></tr>",
        *(_row(check) for check in checks),
        "</table>",
    ]
    head = f'<meta charset="utf-8"><title>{html.escape(name)}: comparison</title><style>{_STYLE}</style>'
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head>\n<body>\n' + "\n".join(body) + "\n</body></html>\n"


def _row(check: Check) -> str:
    cells = "".join(f"<td>{html.escape(text)}</td>" for text in (check.name, check.measured, check.expected))
    outcome = "passed" if check.passed else "failed"
    return f'<tr>{cells}<td class="{outcome}">{outcome}</td></tr>'


def _write_text(path: Path, text: str) -> None:
    with written_whole(path) as temporary:
        temporary.write_text(text, "utf-8")

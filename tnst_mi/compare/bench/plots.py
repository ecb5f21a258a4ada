"""The pictures of a comparison of any two renderers, drawn with matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tnst_mi.compare.bench.statistics.batches import comparable, difference
from tnst_mi.compare.bench.statistics.decision import FALSE_ALARMS
from tnst_mi.compare.bench.statistics.hypotheses import ImagePair
from tnst_mi.compare.figures import Sheet

_DIFFERENCES = "RdBu_r"

#: Views of a figure, at most; the numbers are of all.
_VIEWS = 6


def pair_figure(pair: ImagePair, views: Sequence[str], names: tuple[str, str]) -> Figure:
    """A row for each view: both images, their difference and its z-scores, colours averaged."""
    left, right = (side.mean.mean(-1) for side in (pair.left, pair.right))
    found = difference(pair.left, pair.right)
    tested = (comparable(pair.left, pair.right) & (found.standard_error > 0))[..., 0]
    error = np.where(tested, found.standard_error[..., 0], 1.0)
    scores = np.where(tested, found.value[..., 0] / error, np.nan)
    rows = min(len(views), _VIEWS)
    sheet = Sheet(left.shape[1:], rows, (2, 1, 1))
    low, high = min(0.0, float(min(left.min(), right.min()))), max(1e-30, float(max(left.max(), right.max())))
    largest = max(1e-30, float(np.abs(left - right)[:rows].max()))
    for row in range(rows):
        for column, (image, name) in enumerate(zip((left, right), names, strict=True)):
            sheet.show(row, column, image[row], name, "gray", low, high)
        sheet.show(row, 2, (left - right)[row], "left − right", _DIFFERENCES, -largest, largest)
        sheet.show(row, 3, scores[row], "z-score (grey: not tested)", _DIFFERENCES, -4.0, 4.0)
        sheet.label(row, f"{pair.where} view {views[row]}".strip())
    return sheet.figure


def convergence_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """Against the paths per pixel: the RMS of the differences, with what noise lets one expect, and the mean."""
    figure = Figure(figsize=(7, 5.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for number, where in enumerate(dict.fromkeys(row["where"] for row in rows)):
        chosen = [row for row in rows if row["where"] == where]
        spp = np.array([row["spp"] for row in chosen])
        colour = f"C{number % 10}"
        above.plot(spp, [row["rms"] for row in chosen], "o", color=colour, label=where or "measured")
        above.plot(spp, [row["expected_rms"] for row in chosen], color=colour, linewidth=1)
        shifted = spp * 1.04**number  # lest intervals hide each other
        bias, width = ([row[key] for row in chosen] for key in ("bias", "bias_half_width"))
        below.errorbar(shifted, bias, width, fmt="o", color=colour, capsize=3, markersize=4)
    above.set(ylabel="RMS of left − right", title="dots: measured; lines: expected from noise alone", xscale="log")
    if any(row["rms"] > 0 for row in rows):
        above.set_yscale("log")
    above.legend()
    below.axhline(0, color="black", linewidth=1)
    below.set(xlabel="paths per pixel", ylabel="mean of left − right, 95%", xscale="log")
    return figure


def derivative_figure(derivatives: Sequence[dict[str, Any]]) -> Figure:
    """For each derivative, every estimate with its 95% interval."""
    columns = min(len(derivatives), 4)
    lines = -(-len(derivatives) // columns)
    figure = Figure(figsize=(3.4 * columns, 2.3 * lines), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    for place, derivative in zip(axes, derivatives, strict=False):
        estimates = [
            (f"{side}, {way}", estimate) for side in ("left", "right") for way, estimate in derivative[side].items()
        ]
        for height, (_, estimate) in enumerate(estimates):
            place.errorbar(
                estimate["value"], -height, xerr=estimate["half_width"], fmt="o", color=f"C{height}", capsize=4
            )
        place.set_yticks([-height for height in range(len(estimates))], labels=[label for label, _ in estimates])
        place.set_ylim(-len(estimates) + 0.4, 0.6)
        place.set_title(f"{derivative['where']} {derivative['parameter']}".strip(), fontsize=9)
        place.tick_params(labelsize=8)
        place.locator_params(axis="x", nbins=4)
        place.ticklabel_format(axis="x", style="sci", scilimits=(-3, 4))
    for place in axes[len(derivatives) :]:
        place.set_axis_off()
    return figure


def tail_figure(families: Sequence[Any]) -> Figure:
    """For each family, its tails in order: without differences, of N tests the k-th is about k/N."""
    figure = Figure(figsize=(7, 3.6), layout="constrained")
    axes = figure.subplots()
    for tests in families:
        tails = np.sort(tests.tail[tests.tested])
        if len(tails):
            axes.loglog((np.arange(len(tails)) + 1) / len(tails), np.maximum(tails, 1e-15), ".", label=tests.name)
    axes.plot([1e-4, 1], [1e-4, 1], color="black", linewidth=1, label="if the sides agree")
    axes.axhline(FALSE_ALARMS, color="grey", linestyle=":", linewidth=1, label=f"by chance {FALSE_ALARMS:g}")
    axes.set(xlabel="rank / number of tests", ylabel="tail probability")
    axes.set_title("far below the line, and below the dots: more than chance", fontsize=10)
    axes.legend(fontsize=8)
    return figure

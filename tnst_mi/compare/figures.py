"""The pictures of the report, drawn with matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tnst_mi.compare.quadrature_study import STEPS, QuadratureStudy, darkening
from tnst_mi.io.atomic import written_whole
from tnst_mi.rendering.cameras.views import text_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from tnst_mi.compare.gradients import Directional, GradientFields
    from tnst_mi.compare.paper_quadrature import PaperGradient, PaperImages
    from tnst_mi.compare.values import Comparison, Convergence

_DIFFERENCES = "RdBu_r"


def write_figure(path: Path, figure: Figure) -> None:
    """Write a figure as PNG."""
    with written_whole(path) as temporary:
        figure.canvas = FigureCanvasAgg(figure)
        figure.savefig(str(temporary), dpi=100, format="png")


def image_figure(values: Sequence[Comparison]) -> Figure:
    """A row for each view: the four images, the signed difference and the z-scores, with one scale for all rows."""
    sheet = Sheet(values[0].exact.shape, len(values), (4, 1, 1))
    brightest = max(float(compared.closed.max()) for compared in values)
    differences = [compared.traced - compared.exact for compared in values]
    largest = _largest(differences)
    for row, (compared, difference) in enumerate(zip(values, differences, strict=True)):
        images = (compared.exact, compared.paper, compared.traced, compared.closed)
        titles = ("exact", "paper", f"prbvolpath, {compared.spp} spp", "closed form")
        for column, (image, title) in enumerate(zip(images, titles, strict=True)):
            sheet.show(row, column, image, title, "gray", 0.0, brightest)
        sheet.show(row, 4, difference, "prbvolpath − exact", _DIFFERENCES, -largest, largest)
        sheet.show(row, 5, compared.z, "z-score (grey: not testable)", _DIFFERENCES, -4.0, 4.0)
        sheet.label(row, f"view {text_of(compared.view, ', ')}")
    return sheet.figure


def z_figure(values: Sequence[Comparison]) -> Figure:
    """Histograms of the z-scores at each γ, over the normal density that they should follow."""
    gammas = sorted({compared.gamma for compared in values})
    figure = Figure(figsize=(4 * len(gammas), 3.2), layout="constrained")
    grid = np.linspace(-5, 5, 200)
    for axes, gamma in zip(figure.subplots(1, len(gammas), squeeze=False)[0], gammas, strict=True):
        z = np.concatenate([c.z[c.testable] for c in values if c.gamma == gamma])
        axes.hist(np.clip(z, -5, 5), bins=40, range=(-5, 5), density=len(z) > 0, color="tab:blue", alpha=0.6)
        axes.plot(grid, np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), color="black", label="normal law")
        axes.set(title=f"γ = {gamma:g}, {len(z)} testable pixels", xlabel="z")
        axes.legend()
    return figure


def convergence_figure(convergence: Sequence[Convergence]) -> Figure:
    """Error of the path tracer against the number of paths, and its prediction from our own transmittance."""
    figure = Figure(figsize=(6, 4.2), layout="constrained")
    axes = figure.subplots()
    for i, measured in enumerate(convergence):
        label = f"γ = {measured.gamma:g}, slope {measured.slope:.3f}"
        axes.loglog(measured.spp, measured.error, "o", color=f"C{i}", label=label)
        axes.loglog(measured.spp, measured.predicted, "-", color=f"C{i}", linewidth=1)
    axes.set(
        xlabel="paths per pixel n",
        ylabel="RMS of T (prbvolpath − exact)",
        title="dots: measured, lines: √(T (1 − T)/n), slope −1/2",
    )
    axes.legend()
    return figure


def directional_figure(directional: Sequence[Directional]) -> Figure:
    """Derivatives along random directions: prbvolpath with 95% intervals above, central differences below."""
    figure = Figure(figsize=(4.6 * len(directional), 7), layout="constrained")
    upper, lower = figure.subplots(2, len(directional), squeeze=False)
    for top, bottom, measured in zip(upper, lower, directional, strict=True):
        ours, ends = measured.ours, np.array([measured.ours.min(), measured.ours.max()])
        top.errorbar(ours, measured.traced, measured.interval, fmt=".", linewidth=1, label="95% intervals")
        top.plot(ends, ends, color="black", linewidth=1, label="equal")
        top.set(
            title=f"γ = {measured.gamma:g}: slope {measured.slope:.4f} ± {measured.slope_interval:.4f}",
            xlabel="ours (exact)",
            ylabel="prbvolpath",
        )
        top.ticklabel_format(style="sci", scilimits=(0, 0))
        top.legend()
        rms = np.sqrt(np.mean(measured.central**2))
        traced = (measured.traced - ours) / rms
        bottom.errorbar(ours, traced, measured.interval / rms, fmt=".", linewidth=1, label="prbvolpath − ours")
        bottom.plot(ours, (measured.central - ours) / rms, "x", color="tab:orange", label="central differences − ours")
        bottom.axhline(0, color="black", linewidth=1)
        bottom.set(xlabel="ours (exact)", ylabel="difference / RMS of the derivatives")
        bottom.ticklabel_format(axis="x", style="sci", scilimits=(0, 0))
        bottom.legend()
    return figure


def field_figure(fields: GradientFields) -> Figure:
    """The gradient of every voxel, as the value largest in magnitude along z, and the differences."""
    ours = _projected(fields.ours)
    sheet = Sheet(ours.shape, 1, (3, 1, 1))
    limit = _largest([ours])
    sheet.show(0, 0, ours, "ours", _DIFFERENCES, -limit, limit)
    sheet.show(0, 1, _projected(fields.traced), f"prbvolpath, {fields.spp} spp", _DIFFERENCES, -limit, limit)
    sheet.show(0, 2, _projected(fields.central), "central differences", _DIFFERENCES, -limit, limit)
    for column, field, name in ((3, fields.traced, "prbvolpath"), (4, fields.central, "central")):
        difference = np.zeros_like(fields.ours)
        difference[fields.region] = (field - fields.ours)[fields.region]
        shown = _projected(difference)
        sheet.show(0, column, shown, f"{name} − ours", _DIFFERENCES, -_largest([shown]), _largest([shown]))
    sheet.label(0, f"γ = {fields.gamma:g}, view 0, 0")
    return sheet.figure


def paper_figure(images: Sequence[PaperImages], gradients: Sequence[PaperGradient]) -> Figure:
    """A row for each γ: the first view and the gradient, by us and by the sum in float64, and the differences."""
    sheet = Sheet(images[0].ours[0].shape, len(images), (2, 1, 2, 1))
    gradient_of = {gradient.gamma: gradient for gradient in gradients}
    for row, compared in enumerate(images):
        brightest, error = float(compared.sums[0].upper.max()), compared.errors[0]
        sheet.show(row, 0, compared.ours[0], "paper", "gray", 0.0, brightest)
        sheet.show(row, 1, compared.sums[0].upper, "sum in float64", "gray", 0.0, brightest)
        sheet.show(row, 2, error, "difference", _DIFFERENCES, -_largest([error]), _largest([error]))
        sheet.label(row, f"γ = {compared.gamma:g}, view {text_of(compared.views[0], ', ')}")
        if gradient := gradient_of.get(compared.gamma):
            shown = [_projected(gradient.ours), _projected(gradient.reference)]
            difference = _projected(gradient.ours - gradient.reference)
            limit = _largest(shown)
            sheet.show(row, 3, shown[0], "gradient", _DIFFERENCES, -limit, limit)
            sheet.show(row, 4, shown[1], "derivative in float64", _DIFFERENCES, -limit, limit)
            sheet.show(row, 5, difference, "difference", _DIFFERENCES, -_largest([difference]), _largest([difference]))
    return sheet.figure


def order_figure(studies: Sequence[QuadratureStudy]) -> Figure:
    """Step size against error for both quadratures."""
    figure = Figure(figsize=(4.2 * len(studies), 3.8), layout="constrained")
    for axes, study in zip(figure.subplots(1, len(studies), squeeze=False, sharey=True)[0], studies, strict=True):
        axes.loglog(STEPS, study.paper, "o-", label=f"paper, order {study.paper_order:.2f}")
        axes.loglog(STEPS, study.exact, "s-", label=f"exact, order {study.exact_order:.2f}")
        axes.set(title=f"γ = {study.gamma:g}", xlabel="step in cells", ylabel="error / RMS of the closed form")
        axes.set_xticks(STEPS, labels=[f"{step:g}" for step in STEPS])
        axes.minorticks_off()
        axes.legend()
    return figure


def departure_figure(studies: Sequence[QuadratureStudy]) -> Figure:
    """A column for each γ: exact, paper, and their ratio against γ h d of the smoke visible in a pixel."""
    figure = Figure(figsize=(4.2 * len(studies), 9), layout="constrained")
    for column, study in zip(figure.subplots(3, len(studies), squeeze=False).T, studies, strict=True):
        brightest = _largest([study.front_exact])
        for axes, image, name in ((column[0], study.front_exact, "exact"), (column[1], study.front_paper, "paper")):
            axes.imshow(image, cmap="gray", vmin=0, vmax=brightest)
            axes.set(title=f"{name}, γ = {study.gamma:g}", xticks=[], yticks=[])
        seen = (study.front_exact > 1e-3 * brightest) & (study.thickness > 0)
        ratio = study.front_paper[seen] / study.front_exact[seen]
        column[2].plot(study.thickness[seen], ratio, ".", markersize=2, label="pixels")
        curve = np.linspace(1e-3, max(2.0, study.densest), 200)
        column[2].plot(curve, darkening(curve), color="black", label="uniform opaque column: x/(eˣ − 1)")
        column[2].axvline(1, color="grey", linestyle=":", linewidth=1)
        column[2].set(xlabel="γhd of the smoke that the pixel shows", ylabel="paper / exact", ylim=(0, 1.1))
        column[2].legend()
    return figure


class Sheet:
    """A grid of pictures in groups of columns, each group with one colour bar.

    Positions are computed here: matplotlib's automatic layout takes seconds for so many axes.
    """

    _GAP, _BAR, _TITLE, _WIDTH = 0.08, 0.75, 0.3, 1.95  # inches

    def __init__(self, shape: tuple[int, int], rows: int, groups: tuple[int, ...]) -> None:
        self.height = self._WIDTH * shape[0] / shape[1]
        self.lefts, left = [], 0.3
        self.bars: dict[int, float] = {}
        for count in groups:
            for _ in range(count):
                self.lefts.append(left)
                left += self._WIDTH + self._GAP
            self.bars[len(self.lefts) - 1] = left
            left += self._BAR
        self.total = (left, rows * (self.height + self._TITLE) + self._GAP)
        self.figure = Figure(figsize=self.total)

    def _axes(self, left: float, row: int, width: float) -> Axes:
        bottom = self.total[1] - (row + 1) * (self.height + self._TITLE)
        place = (left / self.total[0], bottom / self.total[1], width / self.total[0], self.height / self.total[1])
        return self.figure.add_axes(place)

    def show(self, row: int, column: int, image: np.ndarray, title: str, colours: str, low: float, high: float) -> None:
        """Draw an image in its place; the last of a group gets the colour bar."""
        axes = self._axes(self.lefts[column], row, self._WIDTH)
        axes.set_facecolor("0.8")
        shown = axes.imshow(image, cmap=colours, vmin=low, vmax=high)
        axes.set_title(title, fontsize=9)
        axes.set(xticks=[], yticks=[])
        if column in self.bars:
            bar = self.figure.colorbar(shown, cax=self._axes(self.bars[column], row, 0.12))
            bar.ax.tick_params(labelsize=8)
            bar.ax.ticklabel_format(axis="y", scilimits=(-3, 3))  # lest labels be too long for their place

    def label(self, row: int, text: str) -> None:
        """Write text to the left of a row."""
        middle = self.total[1] - (row + 1) * (self.height + self._TITLE) + self.height / 2
        self.figure.text(0.12 / self.total[0], middle / self.total[1], text, rotation=90, va="center", ha="center")


def _largest(images: Sequence[np.ndarray]) -> float:
    """The largest magnitude, kept above 0 so that it can be the end of a scale."""
    return max(1e-30, *(float(np.abs(image).max()) for image in images))


def _projected(field: np.ndarray) -> np.ndarray:
    """(H, W), row 0 at the top: the value largest in magnitude along z, with its sign."""
    largest = np.abs(field).argmax(0)[None]
    return np.take_along_axis(field, largest, 0)[0, ::-1]

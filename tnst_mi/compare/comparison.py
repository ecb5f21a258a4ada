"""The whole comparison of one frame: values, gradients, quadratures, and the verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tnst_mi.compare.closed_form import column_density
from tnst_mi.compare.gradients import Directional, GradientFields, compare_directions, compare_fields
from tnst_mi.compare.paper_quadrature import (
    PaperGradient,
    PaperImages,
    compare_paper_gradients,
    compare_paper_images,
)
from tnst_mi.compare.quadrature_study import QuadratureStudy, study_quadratures
from tnst_mi.compare.values import TESTABLE, Comparison, Convergence, compare_values
from tnst_mi.compare.verdict import (
    Check,
    convergence_check,
    directional_checks,
    field_checks,
    paper_gradient_check,
    paper_image_checks,
    quadrature_checks,
    value_checks,
)
from tnst_mi.errors import InputError
from tnst_mi.rendering.cameras.views import View, text_of

#: Called with the name of the current measurement and the share of all work, 0 to 1, done since the last call.
Report = Callable[[str, float], None]

#: Optical depth from which on float32 knows no transmittance beside 1.
_OPAQUE = 16.0

#: Cost of a path whose derivative is taken, relative to one that is only traced.
_GRADIENT_WORK = 6.0


@dataclass(frozen=True)
class Settings:
    """What to compare, and how precisely.

    Attributes:
        views: orthographic or in perspective; see `rendering.cameras.views`.
        gammas: extinctions γ per unit of density and cell, for the values.
        gradient_gammas: the same for the derivatives.
        spp: paths per pixel for the values.
        gradient_spp: paths per pixel for the derivatives.
        directions: number of random smooth directions.
        seed: of paths, directions and weights.
    """

    views: tuple[View, ...]
    gammas: tuple[float, ...]
    gradient_gammas: tuple[float, ...]
    spp: int
    gradient_spp: int
    directions: int
    seed: int


@dataclass(frozen=True, eq=False)
class Results:
    """All measurements."""

    values: list[Comparison]
    convergence: list[Convergence]
    directional: list[Directional]
    fields: list[GradientFields]
    paper_images: list[PaperImages]
    paper_gradients: list[PaperGradient]
    studies: list[QuadratureStudy]

    def checks(self) -> list[Check]:
        """All checks, in the order of the report."""
        groups = [
            *(value_checks(values) for values in self.values),
            (convergence_check(convergence) for convergence in self.convergence),
            *(directional_checks(directional) for directional in self.directional),
            *(field_checks(fields) for fields in self.fields),
            *(paper_image_checks(images) for images in self.paper_images),
            (paper_gradient_check(gradient) for gradient in self.paper_gradients),
            *(quadrature_checks(study) for study in self.studies),
        ]
        return [check for group in groups for check in group]


def require_light(density: np.ndarray, settings: Settings) -> None:
    """Check that there are pixels to test, and derivatives to compare.

    Raises:
        InputError: the smoke lets nearly everything or nearly nothing through at some γ, in all of a view, or nothing
            in the view of the gradients of every voxel.
    """
    for view in settings.views:
        column = column_density(density, view)
        for gamma in settings.gammas:
            transmittance = np.exp(-gamma * column)
            if (settings.spp * transmittance * (1 - transmittance)).max() < TESTABLE:
                raise InputError(
                    f"compare: at gamma {gamma:g} the smoke lets nearly all paths through or nearly none in all pixels "
                    f"of the view {text_of(view)}: nothing can be tested; give another --gamma, more --spp, or "
                    "--density-scale auto"
                )
    thinnest = column_density(density, (0.0, 0.0)).min()
    for gamma in settings.gradient_gammas:
        if gamma * thinnest > _OPAQUE:
            raise InputError(
                f"compare: at gamma {gamma:g} no light gets through the smoke in the view 0,0, so that all derivatives "
                "are 0 and cannot be compared; give a smaller --gamma"
            )


def compare(density: np.ndarray, settings: Settings, report: Report) -> Results:
    """Compare the renderers on a density (D, H, W), float32, finite, ≥ 0.

    Raises:
        InputError: the density is 0 everywhere.
    """
    pixels = density.shape[1] * density.shape[2]
    weighted = len(settings.gammas) * len(settings.views) * settings.spp
    gradients = len(settings.gradient_gammas) * (len(settings.views) + 1) * settings.gradient_spp
    total = pixels * (weighted + _GRADIENT_WORK * gradients)

    def working(name: str, work: float) -> Callable[[int], None]:
        report(name, 0.0)
        return lambda paths: report(name, work * paths / total)

    report("references", 0.0)
    columns = [column_density(density, view) for view in settings.views]
    values, convergence = [], []
    for i, gamma in enumerate(settings.gammas):
        advance = working(f"images, γ {gamma:g}", 1.0)
        compared, converged = compare_values(
            density, settings.views, gamma, columns, settings.spp, (settings.seed, 0, i), advance
        )
        values += compared
        convergence.append(converged)
    directional, fields = [], []
    for i, gamma in enumerate(settings.gradient_gammas):
        advance = working(f"gradients, γ {gamma:g}", _GRADIENT_WORK)
        step = next((compared.step for compared in values if compared.gamma == gamma), 1.0)
        spp, seed = settings.gradient_spp, (settings.seed, 1, i)
        directional.append(
            compare_directions(density, settings.views, gamma, spp, step, settings.directions, seed, advance)
        )
        fields.append(compare_fields(density, gamma, spp, (settings.seed, 2, i), advance))
    report("quadratures", 0.0)
    paper_images = compare_paper_images(density, settings.views, settings.gammas, columns)
    paper_gradients = compare_paper_gradients(density, settings.views, settings.gradient_gammas, (settings.seed, 3))
    studies = study_quadratures(density, settings.views)
    return Results(values, convergence, directional, fields, paper_images, paper_gradients, studies)

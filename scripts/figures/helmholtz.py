"""Irrotational, mixed and incompressible velocities: what do they do to the smoke? (paper, figure fieldComparison)"""

from __future__ import annotations

import itertools

import numpy as np

from figures.figure import Claim, Figure, Made, Panel
from figures.measures import mass_change, relative_curl, relative_divergence
from figures.seen import images_of, smoke_box
from figures.setting import Run, Setting
from tnst_mi import advect
from tnst_mi.frame import Frame

#: λ and what the paper calls it.
NAMES = {1.0: "irrotational", 0.5: "mixed", 0.0: "incompressible"}

#: Four sub-steps: one long step of a velocity without divergence does not keep volumes by itself.
KEYS = {
    "small": {"style": ["spirals"], "octaves": 2, "iterations": 20, "views": 3, "steps": 4},
    "paper": {"style": ["spirals"], "octaves": 3, "iterations": 20, "views": 9, "steps": 4},
}
_STEPS = (1, 4, 16)


def frame_of(setting: Setting) -> Frame:
    """The frame that is stylized, here and in the figure of transport against values."""
    return setting.smoke("suzanne", 10)[0]


def run_of(setting: Setting, lam: float) -> Run:
    """Its stylization with a share λ."""
    return setting.stylized(f"lambda-{lam:g}", frame_of(setting), lam=lam, **KEYS[setting.size])


def make(setting: Setting) -> Made:
    """Stylize one frame with λ 1, 1/2 and 0, and measure what the velocities and the densities are like."""
    frame = frame_of(setting)
    runs = {lam: run_of(setting, lam) for lam in NAMES}
    images = {lam: images_of(run, run.density)[0] for lam, run in runs.items()}
    before = images_of(runs[1.0], frame.density)[0]
    masses = {lam: mass_change(frame.density, run.density) for lam, run in runs.items()}
    refined = {
        steps: mass_change(frame.density, advect(frame.density, runs[0.0].velocity, steps=steps)) for steps in _STEPS
    }
    divergences = {lam: relative_divergence(run.velocity) for lam, run in runs.items()}
    curls = {lam: relative_curl(run.velocity) for lam, run in runs.items()}
    apart = {
        f"{a:g} and {b:g}": float(np.linalg.norm(images[a] - images[b]) / np.linalg.norm(images[a] - before))
        for a, b in itertools.combinations(runs, 2)
    }
    box = smoke_box([before, *images.values()])
    panels = [
        Panel(images[lam][box], f"{name}, λ = {lam:g}\ndivergence {divergences[lam]:.1g}, mass {masses[lam]:+.1%}")
        for lam, name in NAMES.items()
    ]
    return Made(
        [[Panel(before[box], "input"), *panels]],
        [
            Claim(
                f"v* has no divergence for λ = 0: {divergences[0.0]:.1e}, against {divergences[0.5]:.2f} for λ = 1/2 "
                f"and {divergences[1.0]:.2f} for λ = 1 (RMS, relative to that of all derivatives of v*)",
                divergences[0.0] < 1e-5 < 1e-2 < divergences[0.5] < divergences[1.0],
            ),
            Claim(
                f"It has no curl for λ = 1: {curls[1.0]:.1e}, against {curls[0.0]:.2f} for λ = 0",
                curls[1.0] < 1e-5 < 1e-2 < curls[0.0],
            ),
            Claim(
                "The mass that λ = 0 loses is an error of long steps, which falls with their number: v* changes it by "
                + ", ".join(f"{change:+.1%} in {steps}" for steps, change in refined.items()),
                all(abs(fine) < 0.8 * abs(coarse) for coarse, fine in itertools.pairwise(refined.values())),
            ),
            Claim(
                "The pictures differ: what separates two of them, relative to what λ = 1 changes, is "
                + ", ".join(f"{value:.2f} (λ = {pair})" for pair, value in apart.items()),
                min(apart.values()) > 0.25,
            ),
        ],
        {
            "relative_divergence": divergences,
            "relative_curl": curls,
            "mass_change": masses,
            "mass_change_of_lambda_0_by_sub_steps": refined,
            "difference_of_pictures": apart,
        },
    )


FIGURE = Figure(
    "Irrotational, mixed, incompressible",
    "The share λ of the irrotational part decides what the flow may do: a gradient makes sources and sinks, a curl "
    "moves smoke without compressing it, and both together have most freedom.",
    make,
    "Four sub-steps of transport in place of the paper's one, since a trace back along a straight line keeps volumes "
    "only for small displacements. The sum of the mass says little of λ = 1, whose sources and sinks may cancel.",
)

"""Transport against value-based optimisation: what does it do to the mass of the smoke? (paper, figure gradVsVelocity)"""

from __future__ import annotations

from figures.figure import Claim, Figure, Made, Panel
from figures.setting import Setting

from tnst_mi import render

_KEYS = {"style": ["spirals"], "octaves": 2, "views": 3}


def make(setting: Setting) -> Made:
    """Stylize one frame by both parameterisations, and compare mass and pictures."""
    frame = setting.smoke("suzanne", 10)[0]
    runs = {
        kind: setting.stylized(f"density-{kind}", frame, parameterisation=kind, **_KEYS)
        for kind in ("transport", "density")
    }
    gamma = runs["transport"].record["recipe"]["gamma"] if "recipe" in runs["transport"].record else 0.1
    panels = [Panel(render(frame.density, gamma=gamma) * runs["transport"].exposure, "input")]
    changes = {}
    for kind, run in runs.items():
        changes[kind] = abs(run.density.sum() / frame.density.sum() - 1)
        panels.append(Panel(render(run.density, gamma=gamma) * run.exposure, f"{kind}: mass {changes[kind]:+.1%}"))
    return Made(
        [panels],
        [
            Claim(
                f"The mass changes by {changes['density']:.1%} with values, {changes['transport']:.1%} with transport",
                changes["density"] > 3 * changes["transport"],
            )
        ],
        {"mass_change": {kind: float(change) for kind, change in changes.items()}},
    )


FIGURE = Figure(
    "Transport against values",
    "Optimising velocities keeps the look of smoke; optimising density values directly adds and removes smoke.",
    make,
)

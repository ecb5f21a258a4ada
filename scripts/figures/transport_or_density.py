"""Transport against value-based optimisation: where does the smoke come from? (paper, figure gradVsVelocity)"""

from __future__ import annotations

import numpy as np

from figures.figure import Claim, Figure, Made, Panel
from figures.helmholtz import KEYS, frame_of, run_of
from figures.measures import EMPTY, appeared, made_or_removed, mass_change
from figures.seen import images_of, smoke_box
from figures.setting import Run, Setting

#: Step sizes that density values are optimised with, from the recipe's own upwards, until they do as well; and how
#: near to the loss of transport they are to come.
_ETAS, _NEAR = (0.002, 0.04, 0.08, 0.16), 0.02


def make(setting: Setting) -> Made:
    """Stylize one frame by both parameterisations, and compare mass, range and pictures at equal style loss."""
    frame = frame_of(setting)
    transport = run_of(setting, 0.0)
    same_step, *tried = _value_based(setting, _loss(transport))
    same_loss = min(tried, key=lambda run: abs(_loss(run) - _loss(transport)))
    runs = {"transport, λ = 0": transport, "values, same η": same_step, "values, same loss": same_loss}
    change = {name: mass_change(frame.density, run.density) for name, run in runs.items()}
    new = {name: appeared(frame.density, run.density) for name, run in runs.items()}
    loss = {name: _loss(run) for name, run in runs.items()}
    remade = {name: made_or_removed(frame.density, run.density) for name, run in runs.items()}
    highest = {name: float(run.density.max()) for name, run in runs.items()}
    images = {"input": images_of(transport, frame.density)[0]}
    images |= {name: images_of(run, run.density)[0] for name, run in runs.items()}
    middle = {"input": frame.density} | {name: run.density for name, run in runs.items()}
    middle = {name: density[len(density) // 2, ::-1] for name, density in middle.items()}
    box = smoke_box(list(images.values()))
    labels = {name: f"{name}\nstyle loss {loss[name]:.2f}, mass {change[name]:+.1%}" for name in runs}
    values, kept = "values, same loss", "transport, λ = 0"
    return Made(
        [
            [Panel(image[box], labels.get(name, name)) for name, image in images.items()],
            [Panel(_heat(cut[box]), f"slice, up to {cut.max():.2f}") for cut in middle.values()],
        ],
        [
            Claim(
                f"At equal style loss ({loss[values]:.2f} with values, {loss[kept]:.2f} with transport, from "
                f"{_loss(transport, 'before'):.2f}) the mass changes by {change[values]:+.1%} with values, "
                f"{change[kept]:+.1%} with transport: {abs(change[values] / change[kept]):.1f} times",
                abs(change[values]) >= 3 * abs(change[kept]) and abs(loss[values] / loss[kept] - 1) <= _NEAR,
            ),
            Claim(
                f"If smoke might be put anywhere at no cost, values would still have made or removed "
                f"{remade[values]:.1%} of it, transport {remade[kept]:.1%}",
                remade[values] >= 3 * remade[kept],
            ),
            Claim(
                f"Values leave the range of the smoke: up to {highest[values]:.2f}, where transport reaches "
                f"{highest[kept]:.2f} as the input does",
                highest[values] > 1.5 * highest[kept] and highest[kept] <= 1.001 * frame.density.max(),
            ),
            Claim(
                f"Smoke where there was none: {new[values]:.2%} of the mass with values, {new[kept]:.2%} with "
                "transport",
                new[values] > new[kept],
            ),
            Claim(
                f"With the same η and iterations, values hardly stylize: loss {loss['values, same η']:.2f}, "
                f"mass {change['values, same η']:+.1%}",
                loss["values, same η"] > loss[kept],
            ),
        ],
        {"mass_change": change, "style_loss": loss, "largest_density": highest, "appeared_in_empty_cells": new}
        | {"made_or_removed": remade, "eta_of_equal_loss": same_loss.recipe.eta, "empty_below": EMPTY},
    )


def _value_based(setting: Setting, wanted: float) -> list[Run]:
    """Runs with rising η, up to one whose loss is not above the wanted one, and others between, until one is near."""
    keys = {**KEYS[setting.size], "parameterisation": "density", "steps": 1}

    def run(eta: float) -> Run:
        return setting.stylized(f"density-{eta:.3g}", frame_of(setting), eta=eta, **keys)

    runs = []
    for eta in _ETAS:
        runs.append(run(eta))
        if _loss(runs[-1]) <= wanted:
            break
    low, high = runs[-2:]
    for _ in range(4):
        if abs(_loss(runs[-1]) / wanted - 1) <= _NEAR:
            break
        share = (_loss(low) - wanted) / (_loss(low) - _loss(high))
        eta = low.recipe.eta ** (1 - share) * high.recipe.eta**share
        runs.append(run(float(f"{eta:.3g}")))
        low, high = (runs[-1], high) if _loss(runs[-1]) > wanted else (low, runs[-1])
    return runs


def _loss(run: Run, when: str = "after") -> float:
    """The style loss of a run's result from three fixed views, unscaled."""
    return sum(run.record["frames"][0][f"terms_{when}"].values())


def _heat(values: np.ndarray) -> np.ndarray:
    """Densities in grey up to 1, and in red beyond, up to 3."""
    excess = np.clip((values - 1) / 2, 0, 1)[..., None]
    grey = np.clip(values, 0, 1)[..., None] * 0.8
    return (1 - np.sqrt(excess)) * grey + np.sqrt(excess) * np.array([1.0, 0.25, 0.1])


FIGURE = Figure(
    "Transport against values",
    "Optimising velocities keeps the look of smoke; optimising density values directly adds and removes smoke as it "
    "likes.",
    make,
    "The step size of values is raised until the style loss is that of transport: a change of density by η and one of "
    "a potential cannot be compared otherwise. Transport takes four sub-steps: in the paper's single one, velocities "
    "without divergence do not quite keep the mass (see the next figure). Below, slices through the middle; red is "
    "density above 1, which no smoke had.",
)

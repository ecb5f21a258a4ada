"""Stride 1 against 2 of the first convolution: where do checkerboards come from? (paper, figure of strides)"""

from __future__ import annotations

import numpy as np
import torch

from figures.figure import Claim, Figure, Made, Panel
from figures.measures import by_phase, unevenness
from figures.seen import smoke_box
from figures.setting import Setting
from tnst_mi import GoogLeNet, Recipe, render, sample_views
from tnst_mi.losses.evaluation import BoundObjective
from tnst_mi.machine.backend import torch_device
from tnst_mi.optimisation.goals import objective_of
from tnst_mi.optimisation.single_frame import optimise

#: Of the checkerboard, in pixels: two strides of 2, those of the first convolution and of the maximum after it.
_PERIOD = 4
_KEYS = {"small": {"octaves": 2, "iterations": 15, "views": 2}, "paper": {"octaves": 3, "iterations": 20, "views": 9}}


def make(setting: Setting) -> Made:
    """Look at the gradients of images, and at what they make of the smoke, with both strides."""
    frame = setting.close_up(setting.smoke("smokejet", 61)[0])
    style = setting.style("starry_night") or setting.style("spirals")
    recipe = Recipe(style=(style,), **_KEYS[setting.size])
    # Over many views, what comes from the smoke averages out, and what comes from the lattice of pixels does not.
    views = [tuple(view) for view in sample_views(8, (-90.0, 90.0), (-20.0, 20.0))]
    images = np.asarray(render(frame.density, views, recipe.gamma))
    exposure = 1 / images[0].max()
    images = images * exposure
    box = smoke_box(images[:1])
    pictures, numbers = [Panel(images[0][box], "input")], {}
    for stride in (2, 1):
        network = GoogLeNet.load(setting.weights, stride1=stride == 1).to(torch_device())
        gradients = _gradients(objective_of(recipe).bind(network, *images.shape[1:]), images)
        energy = by_phase(gradients, _PERIOD)
        density = optimise(frame, recipe, network).density
        after = np.asarray(render(density, views, recipe.gamma)) * exposure
        numbers[stride] = {"gradient": unevenness(energy), "change": unevenness(by_phase(after - images, _PERIOD))}
        pictures += [
            Panel(gradients[0][box] / 6 + 0.5, f"stride {stride}: gradient"),
            Panel(np.kron(0.5 + 2 * (energy - 1), np.ones((8, 6))), f"its energy by pixel mod {_PERIOD}"),
            Panel(after[0][box], f"stride {stride}: result"),
        ]
    return Made(
        [pictures],
        [
            Claim(
                f"The energy of image gradients is uneven on the lattice of {_PERIOD}×{_PERIOD} pixels by "
                f"{numbers[2]['gradient']:.1%} with stride 2, and by {numbers[1]['gradient']:.1%} with stride 1",
                numbers[2]["gradient"] > 1.5 * numbers[1]["gradient"],
            ),
        ],
        {"unevenness": {str(stride): found for stride, found in numbers.items()}},
        [
            f"In the change of the smoke as rendered, {numbers[2]['change']:.1%} are left with stride 2 and "
            f"{numbers[1]['change']:.1%} with stride 1."
        ],
    )


def _gradients(loss: BoundObjective, images: np.ndarray) -> np.ndarray:
    """Derivatives of a loss with respect to images (V, H, W), each with standard deviation 1."""
    gradients = []
    for image in images:
        pixels = torch.tensor(image[None], device=torch_device(), requires_grad=True)
        loss(pixels).backward()
        gradient = pixels.grad[0].cpu().numpy()
        gradients.append(gradient / gradient.std())
    return np.array(gradients)


FIGURE = Figure(
    "Stride 2 against 1 of the first convolution",
    "With the network's own stride of 2 in the first convolution, gradients have checkerboard patterns; with stride 1 "
    "they do not.",
    make,
    "Our gradients are smoothed and normalised by bands before they move the smoke, which takes most of the "
    "checkerboard away: it is measured where it arises, in the gradient of the image.",
)

"""What is seen of densities: images as a run's network sees them, losses of those, and panels cropped to the smoke."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
import torch

from figures.measures import spread
from figures.setting import Run, Setting
from tnst_mi import GoogLeNet, render
from tnst_mi.fields.density_unit import scaled
from tnst_mi.losses.objective import Objective
from tnst_mi.machine.backend import torch_device
from tnst_mi.rendering.cameras.views import View

FRONT = (0.0, 0.0)

#: Views that results are judged from; the first is for pictures.
JUDGED = (FRONT, (-8.0, 0.0), (8.0, 0.0))


def images_of(run: Run, density: np.ndarray, views: Sequence[View] = (FRONT,)) -> np.ndarray:
    """A density (D, H, W) as a run renders and exposes it, (V, H, W); the smoke is in about [0, 1]."""
    recipe = run.recipe
    density = scaled(density, run.record["density_scale"])
    return np.asarray(render(density, list(views), recipe.gamma, recipe.quadrature)) * run.exposure


def before_and_after(run: Run, view: View = FRONT) -> tuple[np.ndarray, np.ndarray]:
    """The first frame of a run from a view, unstylized and stylized, each (H, W)."""
    return images_of(run, run.frames[0].density, [view])[0], images_of(run, run.density, [view])[0]


def losses_of(setting: Setting, objective: Objective, images: np.ndarray) -> dict[str, np.ndarray]:
    """The unscaled terms of an objective by name, for each image (V, H, W) by itself: (V,)."""
    bound = objective.bind(network(setting.weights), *images.shape[1:])
    values = {name: [] for name in bound.names}
    with torch.no_grad():
        for image in np.asarray(images, np.float32):
            _, terms = bound.evaluate(torch.as_tensor(image[None]).to(torch_device()))
            for name, value in terms.items():
                values[name].append(float(value))
    return {name: np.array(found) for name, found in values.items()}


@functools.lru_cache(maxsize=1)
def network(weights: str | None) -> GoogLeNet:
    """The network of `Setting.weights`, loaded once."""
    return GoogLeNet.load(weights).to(torch_device())


def motif_radius(setting: Setting, layer: str, channels: Sequence[int], image: np.ndarray) -> float:
    """How far what a channel responds to in an image (H, W) extends, in pixels, mean over those that respond at all.

    This is the spread of the squared derivative, with respect to the pixels, of the channel at the place where it
    responds most: of the part of the image that made it respond.
    """
    net = network(setting.weights)
    pixels = torch.as_tensor(np.float32(image)).to(torch_device())[None, None].requires_grad_()
    responses = net(pixels.expand(-1, 3, -1, -1), layers=[layer])[layer][0]
    radii = []
    for channel in channels:
        (gradient,) = torch.autograd.grad(responses[channel].max(), pixels, retain_graph=True)
        if gradient.any():
            radii.append(spread(gradient[0, 0].double().square().cpu().numpy()))
    return float(np.mean(radii))


def smoke_box(images: Sequence[np.ndarray], margin: int = 4, aspect: float = 2 / 3) -> tuple[slice, slice]:
    """Rows and columns that hold all that is brighter than 0.02 in any image (H, W), and some cells around it.

    `aspect` is the least ratio of width to height, so that tall smoke has room for its label.
    """
    lit = np.max(images, axis=0) > 0.02
    ends = []
    for axis in (0, 1):
        cells = np.flatnonzero(lit.any(axis=1 - axis))
        low, high = (int(cells[0]), int(cells[-1]) + 1) if cells.size else (0, lit.shape[axis])
        ends.append([low - margin, high + margin])
    wanted = aspect * (ends[0][1] - ends[0][0]) - (ends[1][1] - ends[1][0])
    if wanted > 0:
        ends[1][0] -= int(wanted / 2)
        ends[1][1] += int(wanted / 2)
    rows, columns = (slice(max(low, 0), min(high, size)) for (low, high), size in zip(ends, lit.shape, strict=True))
    return rows, columns

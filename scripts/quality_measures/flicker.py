"""Flicker of pictures: how far those of two frames differ once the first is carried along with the smoke.

The simulation's velocity says how the smoke moves, so no optical flow has to be guessed. In the front view, where rays
run along the grid's z axis, a pixel moves with the mean velocity of what is seen in it: of its cells, weighted by the
light that reaches the camera from each (paper Eq. 11).
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F

from quality_measures.judge import features, shares
from tnst_mi import GoogLeNet
from tnst_mi.errors import InputError

#: Weight of a cell without smoke, relative to the largest: pixels without smoke move with the mean velocity of the air.
_AIR = 1e-6


def light(density: np.ndarray, gamma: float) -> np.ndarray:
    """What each cell of a density (D, H, W) contributes to the front view: d exp(−γ Σ d) over all cells up to it.

    Its sum over the first axis is the image, with row 0 at the bottom (`tnst_mi.render`, quadrature "paper").
    """
    before = np.cumsum(density[::-1], axis=0, dtype=np.float64)[::-1]
    return density * np.exp(-gamma * before)


def seen_motion(density: np.ndarray, velocity: np.ndarray, gamma: float) -> np.ndarray:
    """How the pixels of the front view move: (H, W, 2), columns to the right and rows down per frame, row 0 at the top.

    Args:
        density: (D, H, W).
        velocity: (D, H, W, 3), x, y and z in cells per frame.
        gamma: extinction per unit of density and cell.

    Raises:
        InputError: the velocity is on another grid.
    """
    if velocity.shape != (*density.shape, 3):
        raise InputError(f"velocity of shape {velocity.shape} given, expected {(*density.shape, 3)}, as the density")
    weights = light(density, gamma)
    weights = weights + _AIR * (weights.max() or 1.0)
    mean = (weights[..., None] * velocity[..., :2]).sum(0) / weights.sum(0)[..., None]
    return np.stack([mean[::-1, :, 0], -mean[::-1, :, 1]], axis=-1)


def carried(image: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """An image (H, W) one frame later: a pixel takes the value from where its motion (H, W, 2) says it came from.

    Cubic interpolation, so that carrying blurs little; values from beyond the border are those at the border.
    """
    rows, columns = image.shape
    row, column = np.indices(image.shape, dtype=np.float64)
    column, row = column - motion[..., 0], row - motion[..., 1]
    # Pixel centres in the coordinates of `grid_sample`, in which the image's outer edges are at −1 and 1.
    where = np.stack([(2 * column + 1) / columns - 1, (2 * row + 1) / rows - 1], axis=-1)
    source = torch.from_numpy(np.ascontiguousarray(image, np.float64))[None, None]
    sampled = F.grid_sample(
        source, torch.from_numpy(where)[None], mode="bicubic", padding_mode="border", align_corners=False
    )
    return sampled[0, 0].numpy()


def difference(moved: np.ndarray, image: np.ndarray, inside: np.ndarray) -> float:
    """The warp error: root mean square difference, over the pixels inside (H, W), of a carried image and the next."""
    return float(np.sqrt(np.square(moved - image)[inside].mean()))


def perceptual_distance(judge: GoogLeNet, one: np.ndarray, other: np.ndarray, inside: np.ndarray) -> float:
    """Distance of two images (H, W) in the judge's features, in the manner of LPIPS (Zhang et al. 2018), 0 or more.

    The features of each position are scaled to length 1; squared distances are averaged over the positions inside
    (H, W) and summed over the layers. The weights of channels that LPIPS learns from people's choices are all 1.
    """
    total = 0.0
    for values in features(judge, np.stack([one, other])).values():
        directions = F.normalize(values.double(), dim=1)
        weights = shares(inside[None], *values.shape[2:])[0].double()
        squared = (directions[0] - directions[1]).square().sum(0)
        total += float((weights * squared).sum() / weights.sum())
    return total

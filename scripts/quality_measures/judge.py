"""The network that judges: the one that took no part in the optimisation.

An optimised network is no judge of its own pictures, since it is satisfied by changes that only it sees. A published
network is judged by `patterns`, the one that ships with the package, and `patterns` by a published one.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from tnst_mi import GoogLeNet
from tnst_mi.errors import InputError
from tnst_mi.losses.evaluation import as_rgb
from tnst_mi.machine.backend import torch_device
from tnst_mi.network.shipped import DOWNLOAD_COMMAND, PATTERNS
from tnst_mi.network.weights import find_weights

#: Layers whose features are compared: those of strokes and textures. What higher ones see, networks that were trained
#: on different pictures do not share (docs/patterns.md).
LAYERS = ("conv1/7x7_s2", "conv2/3x3", "inception_3b/output")


def judge_of(driver: str) -> GoogLeNet:
    """The network that judges what the flavour `driver` has optimised.

    Raises:
        InputError: `driver` is "patterns", and no other network is found.
    """
    if driver != PATTERNS:
        return GoogLeNet.load(PATTERNS).to(torch_device())
    chosen = find_weights()
    if chosen.flavour == PATTERNS:
        raise InputError(
            f"judge: {PATTERNS} optimises, and no other network is found to judge it; get one with `{DOWNLOAD_COMMAND}`"
        )
    return GoogLeNet.from_file(chosen.path).to(torch_device())


def features(judge: GoogLeNet, images: np.ndarray) -> dict[str, Tensor]:
    """The judge's features (N, C, h, w) of grey images (N, H, W) by layer, without derivatives."""
    with torch.no_grad():
        batch = torch.as_tensor(np.ascontiguousarray(images, np.float32)).to(torch_device())
        return judge(as_rgb(batch), layers=list(LAYERS))


def shares(inside: np.ndarray, rows: int, columns: int) -> Tensor:
    """What share of each position of a layer is inside, (N, rows, columns), for pixels inside or not, (N, H, W)."""
    planes = torch.as_tensor(np.ascontiguousarray(inside, np.float32))
    return torch.nn.functional.adaptive_avg_pool2d(planes[:, None], (rows, columns))[:, 0].to(torch_device())

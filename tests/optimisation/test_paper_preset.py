"""`preset = "paper"` on the bundled smoke with the BVLC network: the loss terms of the first iteration are the paper's.

The other side is written here in torch, from the paper's formulas alone: the march of Eq. 11 along rotated rays, σ of
Eq. 2, the means of Eq. 5 as the authors maximise them, Gram matrices as sums (Eq. 6) with the constants of Eq. 7, and
plain weights. It shares the network and the views with ours, and nothing else.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

import tnst_mi
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.single_frame import optimise
from tnst_mi.recipe.paths import STYLES
from tnst_mi.recipe.recipe import Recipe

SCENES = Path(__file__).resolve().parents[2] / "scenes"
VIEWS = 3
CHANNEL = ("inception_4b/pool_proj", 63)
STYLE = {"conv2/3x3": 1.0, "inception_3b/output": 1.0, "inception_4b/output": 1.0}
WEIGHTS = {"semantic": 2.0, "style": 1e-3}


def marched(density: Tensor, view: tuple[float, float], gamma: float) -> Tensor:
    """Σ_k d_k exp(−γ Σ_{i≤k} d_i) along the rays of a view, one sample a cell: (H, W), row 0 at the top."""
    # Columns are the camera's axes, right, up and towards it: raised by the elevation, then turned by the azimuth.
    (sa, ca), (se, ce) = ((math.sin(angle), math.cos(angle)) for angle in map(math.radians, view))
    raised = torch.tensor([[1, 0, 0], [0, ce, se], [0, -se, ce]], dtype=torch.float64)
    turned = torch.tensor([[ca, 0, sa], [0, 1, 0], [-sa, 0, ca]], dtype=torch.float64)
    depth, height, width = density.shape
    # Samples from the camera away, as many as cross the box; one in the middle where a plane of cells is there.
    count = 2 * math.ceil(math.hypot(depth, height, width) / 2) + depth % 2
    axes = [(n - 1) / 2 - torch.arange(n, dtype=torch.float64) for n in (count, height, width)]
    z, y, x = torch.meshgrid(axes[0], axes[1], -axes[2], indexing="ij")
    world = torch.stack([x, y, z], -1) @ (turned @ raised).T
    half = torch.tensor([width, height, depth], dtype=torch.float64) / 2
    values = torch.nn.functional.grid_sample(
        density[None, None].double(), (world / half)[None], padding_mode="border", align_corners=False
    )[0, 0]
    values = values * (world.abs() <= half * (1 + 1e-9)).all(-1)
    return (values * torch.exp(-gamma * values.cumsum(0))).sum(0)


def gram(features: Tensor) -> Tensor:
    """Eq. 6: sums over the positions of products of channels."""
    flat = features.flatten(1).double()
    return flat @ flat.T


@pytest.mark.parametrize(("scene", "number"), [("suzanne", 10), ("smokejet", 61)])
def test_first_loss_terms_are_those_of_the_paper_s_formulas(scene: str, number: int, bvlc_weights: Path) -> None:
    network = GoogLeNet.load(bvlc_weights)
    (frame,) = tnst_mi.load_frames(SCENES / scene / f"frame_{number:04d}.npz")
    recipe = Recipe.from_dict(
        {
            "preset": "paper",
            "style": ["spirals"],
            "style_layers": STYLE,
            "semantic": [f"{CHANNEL[0]}:{CHANNEL[1]}"],
            "semantic_weight": WEIGHTS["semantic"],
            "style_weight": WEIGHTS["style"],
            "octaves": 1,
            "iterations": 1,
            "views": VIEWS,
        }
    )
    density = torch.from_numpy(frame.density)
    exposure = 1 / float(marched(density, (0.0, 0.0), recipe.gamma).max())
    first = optimise(frame, recipe, network, exposure).history[0]

    views = tnst_mi.sample_views(VIEWS, recipe.azimuth, recipe.elevation, seed=(recipe.seed, number, 0, 0))
    images = torch.stack([marched(density, tuple(view), recipe.gamma) for view in views]).float() * exposure
    height, width = images.shape[1:]
    picture = Image.open(STYLES / "spirals.png").convert("RGB")
    with torch.no_grad():
        seen = network(images[:, None].expand(-1, 3, -1, -1), layers=[CHANNEL[0], *STYLE])
        wanted = network(_grey(picture, height, width)[None, None].expand(-1, 3, -1, -1), layers=list(STYLE))
    sigma = images.double().sum((1, 2))
    semantic = -seen[CHANNEL[0]][:, CHANNEL[1]].double().mean((1, 2))
    style = torch.zeros(VIEWS, dtype=torch.float64)
    for layer, weight in STYLE.items():
        channels, area = wanted[layer].shape[1], wanted[layer][0, 0].numel()
        for view in range(VIEWS):
            difference = gram(seen[layer][view]) - gram(wanted[layer][0])
            style[view] += weight * difference.square().sum() / (4 * channels**2 * area**2)
    expected = {"semantic": float((sigma * semantic).sum()), "style": float((sigma * style).sum())}

    found = {name.split()[0]: value for name, value in first["terms"].items()}
    assert found == pytest.approx(expected, rel=1e-3)
    total = sum(WEIGHTS[name] * value for name, value in expected.items())
    assert first["loss"] == pytest.approx(total, rel=1e-3)


def _grey(picture: Image.Image, height: int, width: int) -> Tensor:
    """The mean of the channels / 255 of the largest centred crop of the aspect, resized by Pillow's bicubic filter."""
    grey = np.asarray(picture, np.float32).mean(-1) / 255
    rows, columns = grey.shape
    box = np.array([min(columns, rows * width / height), min(rows, columns * height / width)])
    low = (np.array([columns, rows]) - box) / 2
    resized = Image.fromarray(grey).resize((width, height), Image.Resampling.BICUBIC, tuple([*low, *(low + box)]))
    return torch.from_numpy(np.clip(np.asarray(resized), 0, 1))

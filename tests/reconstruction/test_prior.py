"""The prior: what it is of, and that a reconstruction with it is better than SART stopped at its best."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
import torch
from measure_reconstruction import sart
from render_views import camera_at, places, radius_around, write_views

import tnst_mi
from tnst_mi.io.pictures.exr import read_exr
from tnst_mi.reconstruction.fitting.prior import roughness
from tnst_mi.reconstruction.reconstruct import reconstruct
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

GAMMA = 0.3


@pytest.fixture
def extinction() -> torch.Tensor:
    return torch.rand(4, 5, 6, generator=torch.Generator().manual_seed(3), dtype=torch.float64)


def test_it_is_the_square_of_the_laplacian_over_that_of_the_smoke(extinction):
    σ = extinction.numpy()
    around = np.pad(σ, 1, mode="edge")
    laplacian = sum(
        np.diff(around, 2, axis)[tuple(slice(None) if a == axis else slice(1, -1) for a in range(3))]
        for axis in range(3)
    )
    typical = (σ**2).sum() / σ.sum()
    assert float(roughness(extinction)) == pytest.approx((laplacian**2).mean() / (0.7 * typical) ** 2, rel=1e-9)


def test_neither_units_nor_planes_matter(extinction):
    """A grid of one plane has no neighbours before and behind, and in all of them it is as rough as in one."""
    assert float(roughness(50 * extinction)) == pytest.approx(float(roughness(extinction)), rel=1e-9)
    plane = extinction[:1]
    assert float(roughness(plane.expand(3, 5, 6))) == pytest.approx(float(roughness(plane)), rel=1e-9)
    assert float(roughness(torch.zeros(3, 3, 3))) == 0


@pytest.mark.parametrize("scale_free", [False, True])
def test_smoke_is_drawn_thinner_unless_nothing_else_says_how_thick_it_is(extinction, scale_free):
    extinction.requires_grad_()
    value = roughness(extinction, scale_free)
    value.backward()
    along = float((extinction.grad * extinction.detach()).sum())
    assert along == pytest.approx(0 if scale_free else 2 * value.item(), abs=1e-9)


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_with_noise_it_is_better_than_the_best_of_sart(cloud, renderer, noise, tmp_path):
    """Of all sweeps at three relaxations, by the distance from the truth that only a test knows."""
    radius = radius_around(cloud.shape)
    judges = [camera_at(place) for place in places(3, radius, 0.37)]
    seen = renderer.render(mi.TensorXf(cloud), judges).numpy()

    def errors(density: np.ndarray) -> tuple[float, float]:
        """Relative L2 distance from the density, and mean square difference of views that took no part."""
        images = renderer.render(mi.TensorXf(density), judges).numpy()
        return float(np.linalg.norm(density - cloud) / np.linalg.norm(cloud)), float(((images - seen) ** 2).mean())

    views = write_views(tmp_path, [tnst_mi.Frame(cloud)], renderer, (12, 3), noise, GAMMA)
    found = reconstruct(views, tmp_path / "out", {"iterations": 80, "levels": 2}, progress=False)
    with np.load(found.densities[0]) as file:
        ours = errors(file["density"])
    images = np.stack([read_exr(tmp_path / f"view_{number:02d}.exr") for number in range(12)])
    linear = EmissionAbsorptionRenderer(cloud.shape, 1.0, "exact", 1.0, size=renderer.size)
    cameras = [camera_at(place) for place in places(12, radius)]
    others = [
        errors(density) for relaxation in (0.5, 0.2) for density in sart(images, cameras, linear, GAMMA, relaxation)
    ]
    assert ours[0] < 0.9 * min(distance for distance, _ in others)
    assert ours[1] < min(square for _, square in others)

"""The motif families that the network `patterns` is trained on: repeatable, varied, within range, and well named."""

from __future__ import annotations

import math

import pytest
import torch
from motifs import FAMILIES, draw
from motifs.canvas import Canvas, Family, blur, cell_coordinates, family, smoothstep
from motifs.shading import shade

from tnst_mi.network.class_names import class_index

SIZE = 48


@family(span=(3.0, 3.0), tilt=0.0)
def plain(canvas: Canvas) -> torch.Tensor:
    """Nothing but a ground to test on."""
    return torch.zeros_like(canvas.x)


def canvas_of(kind: Family = plain, count: int = 3, size: int = SIZE, seed: int = 5, warp: float = 0.0) -> Canvas:
    return Canvas(count, size, torch.Generator().manual_seed(seed), kind, warp)


def test_the_vocabulary():
    assert len(FAMILIES) == 64
    names = [", ".join(kind.names) for kind in FAMILIES]
    for number, kind in enumerate(FAMILIES):
        for name in kind.names:
            assert class_index(names, name) == number  # raises where two families share a name
    asked_for = "net square cloud flower fluffy fur ribbon spiral fire volcano plume brush cells cracks scales feathers"
    asked_for += " waves stars rings lace branches marble wood bubbles stripes checks dots knit honeycomb fern dragon"
    asked_for += " julia caustics voronoi crystals"
    for name in asked_for.split():
        class_index(names, name)


@pytest.mark.parametrize("kind", FAMILIES, ids=lambda kind: kind.name)
def test_a_family(kind: Family):
    raw = draw(kind, 4, SIZE, seed=1, shaded=False)
    assert raw.shape == (4, 3, SIZE, SIZE) and 0.0 <= raw.min() and raw.max() <= 1.0
    assert (raw.std((2, 3)) > 0.08).all(), "a picture is all but blank"
    pictures = draw(kind, 4, SIZE, seed=1)
    assert 0.0 <= pictures.min() and pictures.max() <= 1.0
    assert torch.equal(pictures, draw(kind, 4, SIZE, seed=1))
    # Neither the pictures of one seed nor those of another resemble each other.
    grey = torch.cat([raw, draw(kind, 4, SIZE, seed=2, shaded=False)])[:, 0].flatten(1)
    correlation = torch.corrcoef(grey).fill_diagonal_(0.0)
    assert correlation.max() < 0.9


def test_drawing_leaves_the_global_generator_alone():
    state = torch.get_rng_state()
    for kind in FAMILIES:
        draw(kind, 1, 16, seed=3)
    assert torch.equal(state, torch.get_rng_state())


def test_coordinates_span_as_many_units_as_they_say_and_y_points_up():
    canvas = canvas_of()
    assert torch.allclose(canvas.span, torch.tensor(3.0))
    assert torch.allclose(canvas.x[:, 0, -1] - canvas.x[:, 0, 0], torch.tensor(3.0 * (SIZE - 1) / SIZE))
    assert torch.allclose(canvas.y[:, 0, 0] - canvas.y[:, -1, 0], torch.tensor(3.0 * (SIZE - 1) / SIZE))
    assert torch.allclose(canvas.x[:, :, 0], canvas.x[:, :1, 0])


def test_rotation_and_shift_are_rigid():
    kind = Family(("turned",), plain.paint, (2.0, 5.0), math.pi)
    canvas = canvas_of(kind)
    step = torch.hypot(canvas.x[:, 0, 1] - canvas.x[:, 0, 0], canvas.y[:, 0, 1] - canvas.y[:, 0, 0])
    assert torch.allclose(step, canvas.pixel[:, 0, 0], rtol=1e-3)
    along = torch.stack([canvas.x[:, 0, 1] - canvas.x[:, 0, 0], canvas.y[:, 0, 1] - canvas.y[:, 0, 0]])
    across = torch.stack([canvas.x[:, 1, 0] - canvas.x[:, 0, 0], canvas.y[:, 1, 0] - canvas.y[:, 0, 0]])
    assert ((along * across).sum(0) / step**2).abs().max() < 1e-3


def test_noise_has_zero_mean_unit_features_and_independent_channels():
    canvas = canvas_of(Family(("wide",), plain.paint, (14.0, 14.0), 0.0), count=24, size=64)
    first, other = (canvas.noise(canvas.x, canvas.y, channel) for channel in (0, 1))
    assert abs(first.mean()) < 0.1 and 0.5 < first.std() < 1.0
    assert abs((first * other).mean()) < 0.05

    def correlation(distance: float) -> float:
        return ((first * canvas.noise(canvas.x + distance, canvas.y)).mean() / first.var()).item()

    assert correlation(0.05) > 0.95
    assert 0.2 < correlation(0.5) < 0.8
    assert abs(correlation(1.5)) < 0.1


def test_random_numbers_belong_to_their_cell():
    canvas = canvas_of()
    _, _, i, j = cell_coordinates(canvas.x, canvas.y)
    numbers = canvas.random(i, j)
    for picture in range(3):
        cells = set(zip(i[picture].flatten().tolist(), j[picture].flatten().tolist(), strict=True))
        assert len(numbers[picture].unique()) == len(cells)
    assert not torch.equal(numbers, canvas.random(i, j, 1))
    assert not torch.equal(numbers[0].unique(), numbers[1].unique())


def test_nearest_points_against_all_points_of_the_picture():
    # The points are where offsets lead back to; every pixel is then compared with all of them.
    canvas = canvas_of(Family(("many",), plain.paint, (5.0, 5.0), 0.0), count=1)
    nearest, second, dx, dy, number = (field[0] for field in canvas.nearest_points(canvas.x, canvas.y))
    x, y = canvas.x[0], canvas.y[0]
    points = torch.stack([x - dx, y - dy], -1).reshape(-1, 2)
    points = torch.unique((points * 1e3).round() / 1e3, dim=0)
    distances = torch.cdist(torch.stack([x, y], -1).reshape(-1, 2).double(), points.double()).sort(dim=1).values
    distances = distances.reshape(*x.shape, -1)
    assert (nearest - distances[..., 0]).abs().max() < 3e-3
    # The second nearest may lie outside the picture, where no pixel leads back to it.
    assert (second <= distances[..., 1] + 3e-3).all()
    inner = (slice(16, 32), slice(16, 32))
    assert (second - distances[..., 1])[inner].abs().max() < 3e-3
    assert len(number.unique()) == len(points)


def test_splat_keeps_the_weight_and_finds_the_place():
    canvas = canvas_of(Family(("turned",), plain.paint, (3.0, 3.0), math.pi))
    row, column = 20, 30
    x, y = (field[:, row, column, None] for field in (canvas.x, canvas.y))
    picture = canvas.splat(x, y, 2.5)
    assert torch.allclose(picture[:, row, column], torch.tensor(2.5), atol=1e-3)
    assert torch.allclose(picture.sum((1, 2)), torch.tensor(2.5), atol=1e-3)
    soft = canvas.splat(x, y, 2.5, radius=1.5)
    assert torch.allclose(soft.sum((1, 2)), torch.tensor(2.5), atol=1e-2)
    assert (soft.flatten(1).argmax(1) == row * SIZE + column).all()
    assert canvas.splat(x + 100.0, y).sum() == 0.0


def test_blur_keeps_a_constant_and_has_its_deviation():
    assert torch.allclose(blur(torch.full((1, 9, 9), 0.3), 2.0), torch.tensor(0.3))
    point = torch.zeros(1, 41, 41)
    point[0, 20, 20] = 1.0
    offset = torch.arange(41.0) - 20.0
    variance = (blur(point, 2.0).sum(1)[0] * offset**2).sum()
    assert variance.sqrt() == pytest.approx(2.0, rel=0.06)


@pytest.mark.parametrize(("low", "high"), [(0.2, 0.7), (0.7, 0.2)])
def test_smoothstep(low: float, high: float):
    x = torch.linspace(0.0, 1.0, 101)
    t = smoothstep(low, high, x)
    assert t[x.sub(low).abs().argmin()] == pytest.approx(0.0, abs=1e-5)
    assert t[x.sub(high).abs().argmin()] == pytest.approx(1.0, abs=1e-5)
    assert t[x.sub(0.45).abs().argmin()] == pytest.approx(0.5, abs=1e-5)
    assert ((t.diff() * (high - low)) >= -1e-6).all()


def test_shading_keeps_motifs_apart_from_their_ground():
    # What distinguishes families must survive the light, silhouettes and grain.
    canvas = canvas_of(count=64)
    checks = ((canvas.x.floor() + canvas.y.floor()) % 2.0).float()
    shaded = shade(checks, canvas).mean(1)
    middle = (slice(None), slice(12, 36), slice(12, 36))
    pairs = zip(shaded[middle].flatten(1), checks[middle].flatten(1), strict=True)
    correlations = torch.stack([torch.corrcoef(torch.stack(pair))[0, 1].abs() for pair in pairs])
    assert correlations.median() > 0.6
    assert (correlations > 0.1).float().mean() > 0.95

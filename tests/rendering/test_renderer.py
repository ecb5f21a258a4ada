"""`tnst_mi.render` against closed forms, a numpy march, symmetries, and finite differences."""

from __future__ import annotations

import gc
import weakref
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import ray_march
from fields import blob, directional_error, smooth_noise

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

SHAPE = (10, 14, 9)
QUADRATURES = ("paper", "exact", "transmittance", "integrated_transmittance")
VIEWS = [(0.0, 0.0), (-9.0, 4.0), (37.0, -12.0), (123.0, 48.0), (-80.0, 71.0)]
FRAME = Path(__file__).resolve().parents[2] / "scenes" / "suzanne" / "frame_0010.npz"


def smoke(seed: int, *shape: int) -> np.ndarray:
    """A density that does not vanish at the walls, where clamping and cutting would go unnoticed otherwise."""
    return np.abs(smooth_noise(np.random.default_rng(seed), *shape)) + 0.05


def gradient(density: np.ndarray, weights: np.ndarray, *arguments: object) -> np.ndarray:
    """Gradient of the weighted sum of the image(s)."""
    leaf = mi.TensorXf(density)
    dr.enable_grad(leaf)
    dr.backward(dr.sum(tnst_mi.render(leaf, *arguments) * mi.TensorXf(weights), axis=None))
    return dr.grad(leaf).numpy()


# --------------------------------------------------------------------
# Images
# --------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.05, 0.5, 5.0])
def test_exact_is_the_closed_form_of_the_column_sums_of_a_real_frame(gamma: float) -> None:
    with np.load(FRAME) as arrays:
        density = arrays["density"]
    columns = density.astype(np.float64).sum(0)[::-1]
    expected = (1 - np.exp(-gamma * columns)) / gamma
    assert expected.max() > 0.5 / gamma or columns.max() * gamma < 1, "the frame must be dense enough to matter"
    exact = tnst_mi.render(density, gamma=gamma, quadrature="exact")
    np.testing.assert_allclose(exact, expected, rtol=0, atol=1e-4 / gamma)
    transmittance = tnst_mi.render(density, gamma=gamma, quadrature="transmittance")
    np.testing.assert_allclose(transmittance, gamma * exact, rtol=0, atol=1e-6)


@pytest.mark.parametrize("gamma", [0.05, 0.5, 5.0])
@pytest.mark.parametrize(("shape", "h"), [((11, 14, 8), 1.0), ((10, 13, 12), 1.8)])
def test_paper_is_the_inclusive_sum_on_a_rotated_lattice(shape: tuple, h: float, gamma: float) -> None:
    density = smoke(1, *shape)
    images = tnst_mi.render(density, VIEWS, gamma, "paper", h)
    for view, image in zip(VIEWS, images, strict=True):
        expected = ray_march.render(density, view, gamma, "paper", h)
        np.testing.assert_allclose(image, expected, rtol=0, atol=2e-3 * expected.max(), err_msg=str(view))


@pytest.mark.parametrize("quadrature", ["exact", "transmittance", "integrated_transmittance"])
def test_the_other_quadratures_on_a_rotated_lattice(quadrature: str) -> None:
    density = smoke(2, *SHAPE)
    for view, image in zip(VIEWS, tnst_mi.render(density, VIEWS, 0.5, quadrature), strict=True):
        expected = ray_march.render(density, view, 0.5, quadrature)
        np.testing.assert_allclose(image, expected, rtol=0, atol=1e-4 * expected.max(), err_msg=str(view))


def test_faint_smoke_is_the_column_sum() -> None:
    """γ → 0: no cancellation in 1 − exp(−γ …)."""
    density = smoke(3, *SHAPE)
    columns = density.astype(np.float64).sum(0)[::-1]
    for quadrature in ("paper", "exact"):
        np.testing.assert_allclose(tnst_mi.render(density, gamma=1e-6, quadrature=quadrature), columns, rtol=2e-5)


@pytest.mark.parametrize("gamma", [0.05, 0.5, 5.0])
def test_uniform_smoke_is_a_geometric_series(gamma: float) -> None:
    """h Σ_{k=1..n} d e^{−γhdk} = h d e^{−γhd} (1 − e^{−γhdn}) / (1 − e^{−γhd}) in every pixel."""
    d, h = 0.7, 1.5
    e = np.exp(-gamma * h * d)
    expected = h * d * e * (1 - e ** SHAPE[0]) / (1 - e)
    image = tnst_mi.render(np.full(SHAPE, d), gamma=gamma, h=h)
    np.testing.assert_allclose(image, np.full(SHAPE[1:], expected), rtol=1e-5)


@pytest.mark.parametrize("gamma", [0.05, 0.5, 5.0])
@pytest.mark.parametrize("d", [0.0, 0.7])
def test_integrated_transmittance_of_a_uniform_column(d: float, gamma: float) -> None:
    """h Σ_{k=1..n} e^{−γhdk}: the length of the column where it is empty, else a geometric series."""
    h, n = 1.5, SHAPE[0]
    e = np.exp(-gamma * h * d)
    expected = h * n if d == 0 else h * e * (1 - e**n) / (1 - e)
    image = tnst_mi.render(np.full(SHAPE, d), gamma=gamma, quadrature="integrated_transmittance", h=h)
    np.testing.assert_allclose(image, np.full(SHAPE[1:], expected), rtol=1e-5)


def test_integrated_transmittance_is_dark_where_smoke_is_and_darker_the_nearer_it_is() -> None:
    """Of a column of n cells with one opaque cell, only the empty cells in front of it are seen."""
    density = np.zeros((6, 1, 6))
    density[range(6), 0, range(6)] = 20
    image = tnst_mi.render(density, quadrature="integrated_transmittance", gamma=1.0)
    # The camera stands at +z: in column i, 5 − i cells are in front of the opaque one. Samples lie at the centres of
    # cells up to rounding, ± 2⁻²², and so see as much of the opaque cell from the one beside it.
    np.testing.assert_allclose(image[0], [5, 4, 3, 2, 1, 0], atol=20 * 2.0**-22 + 1e-6)


@pytest.mark.parametrize(("shape", "h"), [((95, 33, 69), 1.8), ((29, 53, 29), 96 / 53)])
def test_no_ray_slips_between_the_triangles_of_the_box(shape: tuple, h: float) -> None:
    """Pixel centres on the diagonals of the box's faces see as much smoke as their neighbours."""
    views = [(0.0, 0.0), (180.0, 0.0)]
    images = tnst_mi.render(np.ones(shape), views, 0.01, "exact", h)
    expected = (1 - np.exp(-0.01 * shape[0] * h)) / 0.01
    np.testing.assert_allclose(images, np.full(images.shape, expected), rtol=1e-5)


# --------------------------------------------------------------------
# Views
# --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("side", "view", "right", "up"),
    [
        ("+x", (0, 0), 1, 0),
        ("+y", (0, 0), 0, 1),
        ("+z", (0, 0), 0, 0),
        ("+x", (90, 0), 0, 0),  # The camera stands at +x, looking along −x: z points to the left.
        ("+z", (90, 0), -1, 0),
        ("+y", (90, 0), 0, 1),
        ("+z", (-90, 0), 1, 0),
        ("+x", (180, 0), -1, 0),
        ("+y", (0, 90), 0, 0),  # From above z points down.
        ("+z", (0, 90), 0, -1),
        ("+x", (0, 90), 1, 0),
        ("+z", (0, 30), 0, -0.5),  # From higher up the near side sinks.
        ("+y", (0, 30), 0, np.sqrt(0.75)),
        ("+z", (30, 0), -0.5, 0),
        ("+x", (30, 0), np.sqrt(0.75), 0),
    ],
)
def test_where_a_blob_appears(side: str, view: tuple[float, float], right: float, up: float) -> None:
    n, away = 17, 4.0
    centre = np.full(3, (n - 1) / 2)
    centre["xyz".index(side[1])] += away
    image = tnst_mi.render(blob((n, n, n), tuple(centre), 1.2), view, 0.01, "exact").astype(np.float64)
    rows, columns = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    column, row = ((image * i).sum() / image.sum() for i in (columns, rows))
    assert (column - (n - 1) / 2) / away == pytest.approx(right, abs=0.02)
    assert ((n - 1) / 2 - row) / away == pytest.approx(up, abs=0.02)


@pytest.mark.parametrize(
    ("view", "axis", "near"),
    [
        ((0, 0), 0, "high"),
        ((180, 0), 0, "low"),
        ((90, 0), 2, "high"),
        ((-90, 0), 2, "low"),
        ((0, 90), 1, "high"),
        ((0, -90), 1, "low"),
    ],
)
def test_the_nearer_of_two_cells_attenuates_the_other(view: tuple, axis: int, near: str) -> None:
    n, gamma, a, b = 5, 2.0, 0.3, 0.8
    density = np.zeros((n, n, n))
    cell = [n // 2] * 3
    for value, position in ((a, n - 1), (b, 0)):
        cell[axis] = position
        density[tuple(cell)] = value
    front, back = (a, b) if near == "high" else (b, a)
    expected = front * np.exp(-gamma * front) + back * np.exp(-gamma * (front + back))
    assert tnst_mi.render(density, view, gamma)[n // 2, n // 2] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("n", [9, 10])
def test_a_quarter_turn_of_the_camera_is_one_of_the_grid(n: int) -> None:
    density = smoke(4, n, n, n)
    turned = {
        (90, 0): np.rot90(density, -1, (0, 2)),
        (180, 0): np.rot90(density, 2, (0, 2)),
        (-90, 0): np.rot90(density, 1, (0, 2)),
        (0, 90): np.rot90(density, -1, (0, 1)),
        (0, -90): np.rot90(density, 1, (0, 1)),
    }
    images = tnst_mi.render(density, list(turned), 0.5)
    assert np.abs(images - images[0]).max() > 0.1
    for image, grid in zip(images, turned.values(), strict=True):
        np.testing.assert_allclose(image, tnst_mi.render(grid, gamma=0.5), rtol=0, atol=1e-5)


@pytest.mark.parametrize("h", [1.0, 1.8])
def test_moving_the_smoke_moves_the_image(h: float) -> None:
    """One pixel is one cell at every octave: a cell to +x is a column to the right, a cell to +y a row up."""
    density = np.zeros(SHAPE, np.float32)
    density[2:7, 4:9, 2:6] = smoke(5, 5, 5, 4)
    image = tnst_mi.render(density, gamma=0.5, h=h)
    for cells, axis, pixels, image_axis in ((2, 2, 2, 1), (3, 1, -3, 0)):
        moved = tnst_mi.render(np.roll(density, cells, axis), gamma=0.5, h=h)
        np.testing.assert_allclose(moved, np.roll(image, pixels, image_axis), rtol=0, atol=1e-5)


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_views_rendered_together_are_those_rendered_alone(quadrature: str) -> None:
    density = smoke(6, *SHAPE)
    together = tnst_mi.render(density, VIEWS, 0.5, quadrature)
    alone = np.stack([tnst_mi.render(density, view, 0.5, quadrature) for view in VIEWS])
    assert together.shape == (len(VIEWS), *SHAPE[1:])
    # The rays' origins differ by rounding, a view being a part of the stack of all; on a GPU by more.
    # Integrated transmittances are lengths of many cells, all other images of the order of 1 here.
    largest = together.max()
    if mi.variant().startswith("llvm") and quadrature != "integrated_transmittance":
        largest = min(1.0, largest)
    atol = 1e-6 * largest
    np.testing.assert_allclose(together, alone, rtol=0, atol=atol)
    one = tnst_mi.render(density, VIEWS[1:2], 0.5, quadrature)
    np.testing.assert_array_equal(one, alone[1:2])


def test_the_image_scales_with_the_unit_of_length() -> None:
    """Cells twice as large: twice the length to emit and to absorb along."""
    density = smoke(7, *SHAPE)
    coarse = tnst_mi.render(density, VIEWS, 0.3, "paper", 2.0)
    np.testing.assert_allclose(coarse, 2 * tnst_mi.render(density, VIEWS, 0.6, "paper", 1.0), rtol=2e-5)


# --------------------------------------------------------------------
# Derivatives
# --------------------------------------------------------------------


@pytest.mark.parametrize("h", [1.0, 1.8])
@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_gradient_against_central_differences(quadrature: str, h: float) -> None:
    rng = np.random.default_rng(8)
    views, gamma = VIEWS[1:4], 0.5
    density, weights = smoke(8, *SHAPE), smooth_noise(rng, len(views), *SHAPE[1:])

    def objective(point: np.ndarray) -> float:
        return float((tnst_mi.render(point, views, gamma, quadrature, h).astype(np.float64) * weights).sum())

    directions = [smooth_noise(rng, *SHAPE) for _ in range(16)]
    exact = gradient(density, weights, views, gamma, quadrature, h)
    assert directional_error(objective, exact, density, directions, 1e-2) <= 1e-3


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_backward_is_the_transpose_of_forward(quadrature: str) -> None:
    rng = np.random.default_rng(9)
    density, tangent = smoke(9, *SHAPE), smooth_noise(rng, *SHAPE)
    weights = smooth_noise(rng, len(VIEWS), *SHAPE[1:])
    leaf = mi.TensorXf(density)
    dr.enable_grad(leaf)
    dr.set_grad(leaf, mi.TensorXf(tangent))
    images_tangent = dr.forward_to(tnst_mi.render(leaf, VIEWS, 0.5, quadrature)).numpy()
    adjoint = (gradient(density, weights, VIEWS, 0.5, quadrature) * tangent).sum()
    assert np.abs(images_tangent).max() > 0.1
    assert (images_tangent * weights).sum() == pytest.approx(adjoint, rel=1e-4)


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_gradient_of_several_views_is_the_sum_of_theirs(quadrature: str) -> None:
    density = smoke(10, *SHAPE)
    weights = smooth_noise(np.random.default_rng(10), len(VIEWS), *SHAPE[1:])
    together = gradient(density, weights, VIEWS, 0.5, quadrature)
    apart = sum(gradient(density, w, view, 0.5, quadrature) for view, w in zip(VIEWS, weights, strict=True))
    np.testing.assert_allclose(together, apart, rtol=0, atol=1e-5 * np.abs(apart).max())


def test_two_renders_before_either_backward_keep_their_own_densities_and_views() -> None:
    """Both pass through one cached scene, which holds one density at a time."""
    densities, views = (smoke(11, *SHAPE), 3 * smoke(12, *SHAPE)), ((5.0, 3.0), (-30.0, 10.0))
    weights = smooth_noise(np.random.default_rng(11), *SHAPE[1:], 1)[..., 0]
    leaves = [mi.TensorXf(density) for density in densities]
    dr.enable_grad(leaves)
    images = [tnst_mi.render(leaf, view, 0.5) for leaf, view in zip(leaves, views, strict=True)]
    dr.backward(dr.sum((images[0] + images[1]) * mi.TensorXf(weights), axis=None))
    for leaf, density, view in zip(leaves, densities, views, strict=True):
        np.testing.assert_array_equal(dr.grad(leaf).numpy(), gradient(density, weights, view, 0.5))


def test_gradient_flows_on_through_what_the_density_was_computed_from() -> None:
    density = smoke(13, *SHAPE)
    weights = np.ones((2, *SHAPE[1:]), np.float32)
    leaf = mi.TensorXf(np.sqrt(density))
    dr.enable_grad(leaf)
    dr.backward(dr.sum(tnst_mi.render(leaf * leaf, VIEWS[:2], 0.5), axis=None))
    expected = 2 * np.sqrt(density) * gradient(density, weights, VIEWS[:2], 0.5)
    np.testing.assert_allclose(dr.grad(leaf).numpy(), expected, rtol=0, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_gradient_has_the_same_bits_in_every_run(quadrature: str) -> None:
    shape = (24, 36, 24)
    density = np.random.default_rng(14).random(shape).astype(np.float32)
    weights = np.random.default_rng(15).standard_normal((3, *shape[1:])).astype(np.float32)
    runs = {gradient(density, weights, VIEWS[:3], 0.3, quadrature).tobytes() for _ in range(10)}
    assert len(runs) == 1


# --------------------------------------------------------------------
# Empty space
# --------------------------------------------------------------------


def scattered_cells(seed: int) -> np.ndarray:
    """Few cells that are not 0, some of them on the faces of the blocks that a march passes over as a whole."""
    rng, density = np.random.default_rng(seed), np.zeros((13, 18, 11), np.float32)
    for cell in rng.integers(0, density.shape, (12, 3)):
        density[tuple(cell)] = rng.uniform(0.5, 1)
    density[3, 4, 7] = density[4, 8, 3] = density[8, 7, 8] = 0.8
    return density


@pytest.mark.parametrize("seed", range(3))
def test_no_isolated_cell_is_passed_over(seed: int) -> None:
    density = scattered_cells(seed)
    for view, image in zip(VIEWS, tnst_mi.render(density, VIEWS, 0.5), strict=True):
        expected = ray_march.render(density, view, 0.5)
        np.testing.assert_allclose(image, expected, rtol=0, atol=1e-4 * expected.max(), err_msg=str(view))


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_empty_space_has_its_gradient(quadrature: str) -> None:
    """Smoke could appear there: against central differences along changes of empty cells alone."""
    rng, density = np.random.default_rng(16), scattered_cells(16)
    weights = smooth_noise(rng, 3, *density.shape[1:])

    def objective(point: np.ndarray) -> float:
        return float((tnst_mi.render(point, VIEWS[1:4], 0.5, quadrature).astype(np.float64) * weights).sum())

    directions = [smooth_noise(rng, *density.shape) * (density == 0) for _ in range(16)]
    exact = gradient(density, weights, VIEWS[1:4], 0.5, quadrature)
    assert directional_error(objective, exact, density, directions, 1e-2) <= 1e-3


# --------------------------------------------------------------------
# Kernels, memory and arguments
# --------------------------------------------------------------------


def test_what_a_view_stores_is_freed_without_garbage_collection(monkeypatch: pytest.MonkeyPatch) -> None:
    from tnst_mi.rendering.march.back_projection import BackProjection

    stored = []
    initialise = BackProjection.__init__

    def watched(self: BackProjection, *arguments: object) -> None:
        stored.append(weakref.ref(self))
        initialise(self, *arguments)

    monkeypatch.setattr(BackProjection, "__init__", watched)
    gc.disable()
    try:
        gradient(smoke(17, *SHAPE), np.ones((2, *SHAPE[1:]), np.float32), VIEWS[:2], 0.5)
        assert stored
        assert all(reference() is None for reference in stored)
    finally:
        gc.enable()


@pytest.mark.parametrize("shape", [SHAPE, (3, 2, 2)])
def test_the_adjoint_of_views_together_has_the_bits_of_one_after_the_other(
    monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int, int]
) -> None:
    density, weights = smoke(18, *shape), np.random.default_rng(18).normal(size=(len(VIEWS), *shape[1:]))
    found = {}
    for at_once in (1, len(VIEWS)):
        monkeypatch.setattr(EmissionAbsorptionRenderer, "_views_at_once", lambda *_, at_once=at_once: at_once)
        found[at_once] = gradient(density, np.float32(weights), VIEWS, 0.5)
    assert found[1].tobytes() == found[len(VIEWS)].tobytes()
    assert np.abs(found[1]).max() > 0


@pytest.mark.parametrize("changed", ["density", "views", "gamma", "h"])
@pytest.mark.parametrize("mode", ["forward", "backward"])
def test_no_kernel_is_compiled_after_the_first_renders(mode: str, changed: str) -> None:
    densities = {seed: mi.TensorXf(dr.linspace(mi.Float, 0.1, seed, int(np.prod(SHAPE))), SHAPE) for seed in (1, 2)}
    dr.eval(densities)

    def differentiate(seed: int, views: list, gamma: float, h: float) -> None:
        density = mi.TensorXf(densities[seed])
        dr.enable_grad(density)
        if mode == "forward":
            dr.set_grad(density, densities[seed])
            dr.eval(dr.forward_to(tnst_mi.render(density, views, gamma, h=h)))
        else:
            dr.backward(dr.sum(tnst_mi.render(density, views, gamma, h=h), axis=None))
            dr.eval(dr.grad(density))

    # Dr.Jit shares opaque numbers of equal value, so no γ or h may equal another number of the scene.
    usual = {"seed": 1, "views": VIEWS[:2], "gamma": 0.37, "h": 1.3}
    for _ in range(2):
        differentiate(**usual)
    changes = {"density": {"seed": 2}, "views": {"views": VIEWS[3:]}, "gamma": {"gamma": 0.123}, "h": {"h": 1.8}}
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        differentiate(**(usual | changes[changed]))
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert len(kernels) > 0
    # A kernel from the cache on disk is new to this process: without that cache it would have been compiled. Those of
    # one thread are no part of rendering: they ask the medium of a new h for its place, once.
    kernels = [kernel for kernel in kernels if kernel["size"] > 1]
    assert sum(not kernel["cache_hit"] or kernel["cache_disk"] for kernel in kernels) == 0


@pytest.mark.parametrize(
    "change",
    [
        {"density": np.zeros((3, 3))},
        {"density": np.zeros((0, 3, 3))},
        {"density": np.zeros((3, 3, 3, 1))},
        {"view": (0.0, 0.0, 0.0)},
        {"view": []},
        {"view": (np.nan, 0.0)},
        {"quadrature": "simpson"},
        {"gamma": 0.0},
        {"gamma": -1.0},
        {"gamma": np.nan},
        {"gamma": np.inf},
        {"h": 0.0},
        {"h": np.inf},
    ],
)
def test_bad_arguments_are_named(change: dict) -> None:
    with pytest.raises(tnst_mi.InputError, match=r"render: .*expected") as error:
        tnst_mi.render(**({"density": np.zeros((3, 3, 3))} | change))
    (key,) = change
    assert key in str(error.value)


def test_renderers_of_one_grid_do_not_disturb_each_other() -> None:
    """Recipes may change γ from frame to frame; a pass differentiates with the γ and the density that it rendered."""
    rng = np.random.default_rng(12)
    densities, views = np.float32(rng.uniform(0, 1, (2, *SHAPE))), VIEWS[:2]
    thin, thick = (EmissionAbsorptionRenderer(SHAPE, gamma, "paper", 1.0) for gamma in (0.1, 2.0))

    def alone(renderer: EmissionAbsorptionRenderer, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        leaf = mi.TensorXf(density)
        dr.enable_grad(leaf)
        images = renderer.render(leaf, views)
        dr.backward(dr.sum(images, axis=None))
        return images.numpy(), dr.grad(leaf).numpy()

    leaves = [mi.TensorXf(density) for density in densities]
    dr.enable_grad(leaves)
    images = [renderer.render(leaf, views) for renderer, leaf in zip((thin, thick), leaves, strict=True)]
    for renderer, density, image, leaf in zip((thin, thick), densities, images, leaves, strict=True):
        dr.backward(dr.sum(image, axis=None))
        expected_image, expected_gradient = alone(renderer, density)
        np.testing.assert_array_equal(image.numpy(), expected_image)
        np.testing.assert_array_equal(dr.grad(leaf).numpy(), expected_gradient)


def test_no_scene_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """A medium is enough: on a GPU a scene needs OptiX, which many machines lack."""
    described = []
    load = mi.load_dict

    def watched(description: dict, *arguments: object, **named: object) -> object:
        described.append(description["type"])
        assert description["type"] != "scene"
        return load(description, *arguments, **named)

    monkeypatch.setattr(mi, "load_dict", watched)
    monkeypatch.setattr(mi, "Scene", type("Scene", (), {"__init__": lambda *_: pytest.fail("a scene is made")}))
    # A grid and a γ of its own, so that nothing is taken from a cache.
    density = smoke(18, 6, 7, 9)
    image = tnst_mi.render(density, gamma=0.377)
    recipe = tnst_mi.Recipe(style=("spirals",), octaves=1, iterations=1, views=2, gamma=0.377, weights="patterns")
    result = tnst_mi.stylize(tnst_mi.Frame(density), recipe, progress=False)
    assert image.max() > 0 and not np.array_equal(result.densities[0], density)
    assert set(described) == {"heterogeneous", "emission_absorption"}


def test_a_recipe_can_follow_the_integrated_transmittance() -> None:
    density = smoke(19, 6, 7, 9)
    recipe = tnst_mi.Recipe(
        style=("spirals",), octaves=1, iterations=1, views=2, quadrature="integrated_transmittance", weights="patterns"
    )
    stylized = tnst_mi.stylize(tnst_mi.Frame(density), recipe, progress=False).densities[0]
    assert np.isfinite(stylized).all() and not np.array_equal(stylized, density)


@pytest.mark.parametrize("number", [0.0, -1.0, float("nan"), float("inf"), "auto"])
@pytest.mark.parametrize("name", ["gamma", "h"])
def test_render_refuses_what_is_no_number_above_0(name, number):
    with pytest.raises(InputError, match=f"render: {name} {number!r} given, expected a finite number > 0"):
        tnst_mi.render(np.ones((2, 2, 2), np.float32), **{name: number})

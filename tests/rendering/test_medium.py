"""Resolving a medium: the recovered transform, the lattice of samples, and Mitsuba's own coefficients at its points."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from fields import smooth_noise
from smoke_scenes import EXTINCTION, affine, medium, orthographic, smoke_scene

from tnst_mi.rendering.march.lattice import Lattice
from tnst_mi.rendering.march.medium import GridMedium, GridTransform, probe_transform
from tnst_mi.rendering.march.scene_media import SceneMedia

SHAPE = (7, 9, 6)


def random_edges(rng: np.random.Generator, condition: float = 100.0) -> np.ndarray:
    """Edges (columns) of a rotated, sheared, possibly mirrored box, its condition number limited."""
    while True:
        edges = rng.standard_normal((3, 3)) * 10 ** rng.uniform(-1, 1, 3)
        if np.linalg.cond(edges) < condition:
            return edges


def grid_volume(data: np.ndarray, edges: np.ndarray, centre: np.ndarray) -> mi.Volume:
    to_world = affine(edges, centre) @ mi.ScalarTransform4f().translate(-0.5)
    return mi.load_dict({"type": "gridvolume", "grid": mi.VolumeGrid(data), "to_world": to_world})


def sigma_t(medium: mi.Medium, points: np.ndarray) -> np.ndarray:
    """Mitsuba's extinction (points, 3) at world positions (points, 3)."""
    interaction = dr.zeros(mi.MediumInteraction3f, len(points))
    interaction.p = mi.Point3f(*np.float32(points.T))
    return medium.get_scattering_coefficients(interaction)[2].numpy().T


# --------------------------------------------------------------------
# The transform
# --------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("channels", [1, 3])
def test_probe_recovers_a_random_affine_transform(channels: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    edges, centre = random_edges(rng), rng.uniform(-3, 3, 3)
    data = rng.random((*SHAPE, channels)).astype(np.float32)
    volume = grid_volume(data, edges, centre)
    found = probe_transform(volume)
    inverse = np.linalg.inv(edges)
    np.testing.assert_allclose(found.matrix, inverse, rtol=0, atol=1e-5 * np.abs(inverse).max())
    np.testing.assert_allclose(found.centre, centre, rtol=0, atol=1e-5 * np.abs(edges).max())
    np.testing.assert_array_equal(mi.traverse(volume)["data"].numpy(), data)


@pytest.mark.parametrize("suspended", [False, True])
def test_probe_leaves_the_data_attached(suspended: bool) -> None:
    """Integrators resolve the medium while derivatives are suspended."""
    rng = np.random.default_rng(7)
    volume = grid_volume(np.zeros((*SHAPE, 1), np.float32), random_edges(rng), np.zeros(3))
    parameters = mi.traverse(volume)
    values = rng.random((*SHAPE, 1)).astype(np.float32)
    leaf = mi.TensorXf(values)
    dr.enable_grad(leaf)
    parameters["data"] = 3 * leaf
    parameters.update()
    if suspended:
        with dr.suspend_grad():
            probe_transform(volume)
    else:
        probe_transform(volume)
    dr.backward(dr.sum(dr.square(mi.traverse(volume)["data"]), axis=None))
    np.testing.assert_allclose(dr.grad(leaf).numpy(), 18 * values, rtol=1e-6)


def test_voxel_edges_and_diagonal_of_a_box() -> None:
    """A 6×9×7 grid over a box of 12×3×4, turned: cells of 2, 1/3 and 4/7, the diagonal 13."""
    turn = np.linalg.qr(np.random.default_rng(8).standard_normal((3, 3)))[0]
    transform = GridTransform(np.linalg.inv(turn @ np.diag([12.0, 3.0, 4.0])), np.zeros(3))
    np.testing.assert_allclose(transform.voxel_edges(SHAPE), [2, 1 / 3, 4 / 7], rtol=1e-12)
    assert transform.diagonal() == pytest.approx(13, rel=1e-12)


def test_diagonal_of_a_sheared_box_is_its_longest() -> None:
    edges = np.array([[4.0, 3, 0], [0, 1, 0], [0, 0, 0.1]])
    corners = np.array(list(np.ndindex(2, 2, 2))) @ edges.T
    longest = max(np.linalg.norm(a - b) for a in corners for b in corners)
    assert GridTransform(np.linalg.inv(edges), np.zeros(3)).diagonal() == pytest.approx(longest, rel=1e-12)


# --------------------------------------------------------------------
# The lattice
# --------------------------------------------------------------------


def resolve(density: np.ndarray, edges: np.ndarray, centre: np.ndarray, scale: float = 1.0) -> tuple:
    scene = smoke_scene(density, orthographic(SHAPE), {}, edges, centre, scale)
    return scene, scene.integrator().resolve(scene).media[0]


def rays_through(edges: np.ndarray, centre: np.ndarray, count: int, rng: np.random.Generator) -> tuple:
    """Origins around the grid and directions towards points inside it, (count, 3) each."""
    outwards = rng.standard_normal((count, 3))
    distance = np.linalg.norm(edges, axis=0).sum()
    origins = centre + distance * outwards / np.linalg.norm(outwards, axis=1, keepdims=True)
    directions = centre + rng.uniform(-0.4, 0.4, (count, 3)) @ edges.T - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def marched(grid: GridMedium, lattice: Lattice) -> tuple[np.ndarray, np.ndarray]:
    """The extinction (samples, rays) along the lattice, and whether each sample exists."""
    values, exists = [], []
    for k in range(int(lattice.count.numpy().max())):
        stencil = lattice.stencil(mi.UInt32(k))
        value = stencil.value(stencil.read(grid.extinction.array, grid.channels))[0]
        values.append((value * grid.scale).numpy())
        exists.append((mi.UInt32(k) < lattice.count).numpy())
    return np.array(values), np.array(exists)


@pytest.mark.parametrize("seed", range(4))
def test_samples_are_the_medium_s_own_coefficients(seed: int) -> None:
    """For any placement of the grid: the lattice's points by their definition, the values by Mitsuba."""
    rng = np.random.default_rng(seed)
    edges, centre, scale = random_edges(rng, 6.0), rng.uniform(-2, 2, 3), 1.6
    scene, grid = resolve(0.2 + np.abs(smooth_noise(rng, *SHAPE)), edges, centre, scale)
    origins, directions = rays_through(edges, centre, 50, rng)
    step = 0.11 * np.linalg.norm(edges, axis=0).min()

    ray = mi.Ray3f(mi.Point3f(*np.float32(origins.T)), mi.Vector3f(*np.float32(directions.T)))
    lattice = Lattice(grid, ray, step)
    values, exists = marched(grid, lattice)

    nearest = ((centre - origins) * directions).sum(-1)
    n = 2 * lattice.longest + SHAPE[0] % 2
    offsets = (np.arange(n) - (n - 1) / 2) * step
    points = origins[:, None] + (nearest[:, None] + offsets)[..., None] * directions[:, None]
    local = (points - centre) @ np.linalg.inv(edges).T
    depth = 0.5 - np.abs(local).max(-1)
    # Rounding decides about a sample on a face of the box.
    clear = (np.abs(depth) > 1e-5).all(-1)
    assert clear.sum() > 40
    assert exists.sum(0).max() <= lattice.longest
    for ray_index in np.flatnonzero(clear):
        inside = points[ray_index][depth[ray_index] > 0]
        assert exists[:, ray_index].sum() == len(inside)
        expected = sigma_t(scene.shapes()[0].interior_medium(), inside)[:, 0]
        np.testing.assert_allclose(values[exists[:, ray_index], ray_index], expected, rtol=0, atol=2e-4)
    assert values[exists].std() > 0.02


@pytest.mark.parametrize("depth", [1, 6, 7])
def test_a_ray_along_z_samples_the_cell_centres_front_to_back(depth: int) -> None:
    density = np.random.default_rng(9).random((depth, 4, 5)).astype(np.float32)
    edges = 1.7 * np.diag([5.0, 4.0, depth])
    _, grid = resolve(density, edges, np.zeros(3))
    x, y = np.meshgrid(1.7 * (np.arange(5) - 2), 1.7 * (np.arange(4) - 1.5))
    ray = mi.Ray3f(mi.Point3f(np.float32(x.ravel()), np.float32(y.ravel()), 100.0), mi.Vector3f(0, 0, -1))
    lattice = Lattice(grid, ray, 1.7)
    np.testing.assert_array_equal(lattice.count.numpy(), depth)
    values, _ = marched(grid, lattice)
    np.testing.assert_allclose(values, density[::-1].reshape(depth, -1), rtol=0, atol=2e-5)


def test_the_crossing_and_the_origin_bound_the_samples() -> None:
    """A ray along −z from 100 above a grid of 7 unit cells: its samples lie at distances 97, 98, …, 103."""
    _, grid = resolve(np.ones(SHAPE), np.diag(SHAPE[::-1]).astype(float), np.zeros(3))
    limits = {(0, np.inf): 7, (97.5, np.inf): 6, (0, 98.5): 2, (99.5, 101.5): 2, (99.2, 99.8): 0, (np.inf, -np.inf): 0}
    for limit, count in limits.items():
        ray = mi.Ray3f(mi.Point3f(0, 0, 100), mi.Vector3f(0, 0, -1))
        lattice = Lattice(grid, ray, 1.0, tuple(mi.Float(distance) for distance in limit))
        assert lattice.count.numpy() == [count], limit
    for height, count in ((1.25, 5), (-2.9, 1), (-4.0, 0), (3.6, 7)):
        ray = mi.Ray3f(mi.Point3f(0, 0, height), mi.Vector3f(0, 0, -1))
        lattice = Lattice(grid, ray, 1.0)
        assert lattice.count.numpy() == [count], height


def test_entry_and_exit_are_distances_along_the_ray() -> None:
    _, grid = resolve(np.ones(SHAPE), np.diag(SHAPE[::-1]).astype(float), np.zeros(3))
    ray = mi.Ray3f(mi.Point3f([0, 0], [0, 0], [100, 1]), mi.Vector3f(0, 0, -1))
    lattice = Lattice(grid, ray, 1.0)
    np.testing.assert_allclose(lattice.entry.numpy(), [96.5, 0], atol=1e-4)
    np.testing.assert_allclose(lattice.exit.numpy(), [103.5, 4.5], atol=1e-4)


@pytest.mark.parametrize("axis", range(3))
def test_rays_parallel_to_the_faces_outside_the_box_have_no_samples(axis: int) -> None:
    _, grid = resolve(np.ones(SHAPE), np.diag(SHAPE[::-1]).astype(float), np.zeros(3))
    direction, origin = np.zeros(3), np.zeros(3)
    direction[axis], origin[axis] = 1, -50
    for sideways, hits in ((0.0, True), (20.0, False), (-20.0, False)):
        origin[(axis + 1) % 3] = sideways
        ray = mi.Ray3f(mi.Point3f(*origin.tolist()), mi.Vector3f(*direction.tolist()))
        lattice = Lattice(grid, ray, 1.0)
        assert (lattice.count.numpy()[0] >= SHAPE[2 - axis] - 1) if hits else (lattice.count.numpy() == [0])


# --------------------------------------------------------------------
# The medium of a scene
# --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("boundary", "fills"),
    [
        ({"type": "cube", "size": 1.0}, True),
        ({"type": "cube", "size": 0.9}, False),
        ({"type": "cube", "size": 1.001}, False),
        ({"type": "sphere", "size": 1.0}, False),
        ({"type": "cylinder", "size": 1.0}, False),
    ],
)
def test_whether_the_shape_is_the_box_of_the_grid(boundary: dict, fills: bool) -> None:
    rng = np.random.default_rng(12)
    edges, centre = random_edges(rng, 6.0), rng.uniform(-2, 2, 3)
    scaled = mi.ScalarTransform4f().scale(0.5 * boundary["size"])
    # Only cubes and meshes may be sheared.
    placed = affine(edges, centre) if boundary["type"] == "cube" else mi.ScalarTransform4f().translate(centre.tolist())
    shape = {"type": boundary["type"], "to_world": placed @ scaled}
    scene = smoke_scene(np.ones(SHAPE), orthographic(SHAPE), {}, edges, centre, boundary=shape)
    assert (SceneMedia(scene).box is not None) is fills


def test_refresh_takes_over_new_data_and_scale() -> None:
    scene, grid = resolve(np.ones(SHAPE), np.eye(3), np.zeros(3))
    parameters = mi.traverse(scene)
    data = np.random.default_rng(10).random((3, 4, 5, 1)).astype(np.float32)
    parameters[EXTINCTION] = mi.TensorXf(data)
    parameters["smoke.interior_medium.scale"] = 2.5
    parameters.update()
    grid.refresh()
    np.testing.assert_array_equal(grid.extinction.numpy(), data)
    assert (grid.grid_shape, grid.channels, grid.scale) == ((3, 4, 5), 1, 2.5)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"interior": {"type": "heterogeneous", "sigma_t": 0.5}}, "`heterogeneous` with a `gridvolume`"),
        ({"bsdf": {"type": "diffuse"}}, "`null` BSDF"),
    ],
)
def test_media_that_cannot_be_resolved_are_named(change: dict, named: str) -> None:
    ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium(np.ones(SHAPE), affine(np.eye(3), [0] * 3))}
    scene = mi.load_dict({"type": "scene", "ball": ball | change})
    with pytest.raises(RuntimeError, match=rf"emission_absorption: .*{named}"):
        SceneMedia(scene)


def test_a_volume_without_a_gradient_is_named_and_keeps_its_data() -> None:
    data = np.random.default_rng(11).random((*SHAPE, 1)).astype(np.float32)
    volume = mi.load_dict({"type": "gridvolume", "grid": mi.VolumeGrid(data), "filter_type": "nearest"})
    with pytest.raises(RuntimeError, match=r'emission_absorption: .*filter_type "trilinear"'):
        probe_transform(volume)
    np.testing.assert_array_equal(mi.traverse(volume)["data"].numpy(), data)

"""Any number of media in a scene: in order along the ray, inside one another, clipped, mirrored and moved."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import ray_march
from fields import directional_error, smooth_noise
from smoke_scenes import EXTINCTION, affine, cube, error_message, extinction_of, film, image_of, medium

from tnst_mi.machine.backend import on_gpu

GAMMA = 0.5
SHAPE = (5, 4, 6)
NULL = {"bsdf": {"type": "null"}}


def transform() -> mi.ScalarTransform4f:
    """The identity, of the active variant."""
    return mi.ScalarTransform4f()


def homogeneous(extinction: float | list[float], scale: float = 1.0) -> dict[str, object]:
    """A homogeneous medium that only absorbs, as far as Mitsuba is concerned."""
    value = extinction if isinstance(extinction, float) else {"type": "rgb", "value": extinction}
    return {"type": "homogeneous", "albedo": 0.0, "sigma_t": value, "scale": scale}


def box(low: float, high: float, interior: dict[str, object] | None = None, width: float = 20.0) -> dict[str, object]:
    """A box between two planes of constant z."""
    to_world = transform().translate([0, 0, (low + high) / 2]).scale([width, width, (high - low) / 2])
    return cube(to_world) | NULL | ({"interior": interior} if interior else {})


def grid_box(density: np.ndarray, centre: list[float], edges: np.ndarray | None = None) -> dict[str, object]:
    """Smoke of a grid of unit cells, or of any box's, that fills its box."""
    edges = np.diag(density.shape[::-1]).astype(float) if edges is None else edges
    placed = affine(edges, np.array(centre))
    return cube(placed @ transform().scale(0.5)) | NULL | {"interior": medium(GAMMA * density, placed)}


def camera(
    origin: tuple[float, float, float] = (0, 0, 30), fov: float = 2.0, width: int = 5, height: int = 4, **others: object
) -> dict[str, object]:
    """A perspective camera that looks at the origin."""
    to_world = transform().look_at(list(origin), [0, 0, 0], [0, 1, 0])
    return {"type": "perspective", "fov": fov, "to_world": to_world, **film(width, height, "rgb"), **others}


def scene_of(integrator: dict[str, object], sensor: dict[str, object], **others: object) -> mi.Scene:
    integrator = {"type": "emission_absorption", "gamma": GAMMA, **integrator}
    return mi.load_dict({"type": "scene", "integrator": integrator, **others, "sensor": sensor})


def smoke(seed: int, shape: tuple[int, int, int] = SHAPE) -> np.ndarray:
    return np.abs(smooth_noise(np.random.default_rng(seed), *shape)) + 0.05


def sky(radiance: float) -> dict[str, object]:
    return {"type": "constant", "radiance": radiance}


def volpath(sensor: dict[str, object], paths: int = 4096, **others: object) -> np.ndarray:
    """Mitsuba's image of the scene by path tracing."""
    sensor = sensor | {"sampler": {"type": "independent", "sample_count": paths}}
    return image_of(mi.load_dict({"type": "scene", "integrator": {"type": "volpath"}, **others, "sensor": sensor}))


def parameter_objective(scene: mi.Scene, key: str, weights: np.ndarray) -> Callable[[np.ndarray], float]:
    """The weighted sum of the image as a function of one parameter."""
    parameters = mi.traverse(scene)
    kind = type(parameters[key])

    def objective(values: np.ndarray) -> float:
        parameters[key] = kind(values.tolist()) if kind is mi.Color3f else kind(values)
        parameters.update()
        return float((mi.render(scene).numpy().astype(np.float64) * weights).sum())

    return objective


def parameter_gradient(scene: mi.Scene, keys: list[str], weights: np.ndarray) -> list[np.ndarray]:
    """Gradients of that weighted sum with respect to several parameters."""
    parameters = mi.traverse(scene)
    for key in keys:
        dr.enable_grad(parameters[key])
    parameters.update()
    dr.backward(dr.sum(mi.render(scene, parameters) * mi.TensorXf(weights), axis=None))
    return [np.array(dr.grad(parameters[key])).copy() for key in keys]


# --------------------------------------------------------------------
# Order along the ray
# --------------------------------------------------------------------


@pytest.mark.parametrize("quadrature", ["paper", "exact", "transmittance", "integrated_transmittance"])
def test_homogeneous_slabs_against_the_closed_form(quadrature: str) -> None:
    """L = E₁ + T₁ (E₂ + T₂ B), the rays almost perpendicular to the slabs."""
    first, second, behind = 0.3, 0.9, 0.7
    shown = scene_of(
        {"quadrature": quadrature},
        camera(),
        far=box(-6, -2, homogeneous(second)),
        near=box(1, 3, homogeneous(first)),
        sky=sky(behind),
    )
    expected = behind
    for extinction, length in ((second, 4), (first, 2)):
        T, per_length = np.exp(-extinction * length), (1 - np.exp(-extinction * length)) / extinction
        source = {"transmittance": extinction, "integrated_transmittance": 1}.get(quadrature, extinction / GAMMA)
        expected = source * per_length + T * expected
    np.testing.assert_allclose(image_of(shown), expected, rtol=1e-3)


@pytest.mark.parametrize("turned", [False, True])
def test_the_nearer_of_two_grids_attenuates_the_other(turned: bool) -> None:
    """From either side, against marches of each grid alone."""
    densities, places = [smoke(1), 2 * smoke(2)], [[0.3, 0, 6], [-0.2, 0.4, -5]]
    sensor = {"type": "orthographic", "to_world": transform().rotate([0, 1, 0], 180.0 * turned).translate([0, 0, 40])}
    sensor["to_world"] = sensor["to_world"] @ transform().rotate([0, 1, 0], 180).scale([3, 3, 1])
    sensor |= film(12, 12, "rgb")
    both = scene_of({}, sensor, a=grid_box(densities[0], places[0]), b=grid_box(densities[1], places[1]))
    near, far = (1, 0) if turned else (0, 1)
    alone = [scene_of({}, sensor, a=grid_box(densities[i], places[i])) for i in (near, far)]
    through = scene_of({"quadrature": "transmittance"}, sensor, a=grid_box(densities[near], places[near]))
    expected = image_of(alone[0]) + (1 - image_of(through)) * image_of(alone[1])
    assert (image_of(alone[0]) * image_of(alone[1])).max() > 0.1
    np.testing.assert_allclose(image_of(both), expected, rtol=0, atol=1e-5)


def test_derivatives_of_all_media_against_central_differences() -> None:
    """A grid before a coloured homogeneous ball before a grid, the sky behind; forwards they are the transposes."""
    scene = scene_of(
        {}, camera(fov=14, width=9, height=8),
        near=grid_box(smoke(3), [0, 0, 6]), far=grid_box(smoke(4), [0.5, 0, -7]),
        ball={"type": "sphere", "radius": 3.0, **NULL, "interior": homogeneous([0.4, 0.2, 0.1], 0.7)}, sky=sky(0.6),
    )  # fmt: skip
    keys = [f"{name}.interior_medium.sigma_t.data" for name in ("near", "far")]
    keys.append("ball.interior_medium.sigma_t.value.value")
    rng = np.random.default_rng(5)
    weights = smooth_noise(rng, 8, 9, 3)
    starts = [np.array(mi.traverse(scene)[key]).copy() for key in keys]
    gradients = parameter_gradient(scene, keys, weights)
    for key, start, gradient in zip(keys, starts, gradients, strict=True):
        directions = [rng.standard_normal(start.shape).astype(np.float32) for _ in range(4)]
        assert directional_error(parameter_objective(scene, key, weights), gradient, start, directions, 1e-2) <= 2e-3
        parameter_objective(scene, key, weights)(start)

    parameters = mi.traverse(scene)
    tangents = [rng.standard_normal(start.shape).astype(np.float32) for start in starts]
    for key, tangent in zip(keys, tangents, strict=True):
        dr.enable_grad(parameters[key])
        dr.set_grad(parameters[key], type(parameters[key])(tangent.tolist() if "value" in key else tangent))
    parameters.update()
    image = dr.forward_to(mi.render(scene, parameters)).numpy()
    expected = sum((gradient * tangent).sum() for gradient, tangent in zip(gradients, tangents, strict=True))
    assert (image * weights).sum() == pytest.approx(expected, rel=1e-3)


def test_a_derivative_flows_on_through_what_a_homogeneous_extinction_was_computed_from() -> None:
    """Two balls of one medium, σ = 2 s: every ray meets the medium twice."""
    interior = {"type": "ref", "id": "fog"}
    scene = scene_of(
        {"quadrature": "exact"}, camera(), fog=homogeneous(0.1) | {"id": "fog"},
        near=box(1, 3, interior), far=box(-6, -2, interior),
    )  # fmt: skip
    parameters = mi.traverse(scene)
    (key,) = (key for key in parameters.keys() if key.endswith("sigma_t.value.value"))

    def rendered(s: mi.Float) -> mi.TensorXf:
        dr.enable_grad(s)
        parameters[key] = 2 * s
        parameters.update()
        return mi.render(scene, parameters)

    expected = 2 * 6 * np.exp(-0.1 * 6) / GAMMA
    s = mi.Float(0.05)
    dr.backward(dr.mean(rendered(s), axis=None))
    assert dr.grad(s).numpy() == pytest.approx(expected, rel=1e-3)
    s = mi.Float(0.05)
    image = rendered(s)
    dr.set_grad(s, 1.0)
    np.testing.assert_allclose(dr.forward_to(image).numpy(), expected, rtol=1e-3)


def test_the_derivative_of_a_scale_is_that_of_a_number_the_extinction_is_multiplied_by() -> None:
    """Mitsuba keeps `scale` as a plain number, without derivative."""
    density = smoke(6)
    scene = scene_of({}, camera(fov=14, width=9, height=8), smoke=grid_box(density, [0, 0, 0]), sky=sky(0.5))
    parameters, start, s = mi.traverse(scene), mi.TensorXf(extinction_of(scene)), mi.Float(1.3)
    dr.enable_grad(s)
    parameters[EXTINCTION] = s * start
    parameters.update()
    dr.backward(dr.sum(mi.render(scene, parameters), axis=None))
    sums = []
    parameters[EXTINCTION] = start
    for scale in (1.29, 1.31):
        parameters["smoke.interior_medium.scale"] = scale
        parameters.update()
        sums.append(mi.render(scene).numpy().astype(np.float64).sum())
    assert dr.grad(s).numpy() == pytest.approx((sums[1] - sums[0]) / 0.02, rel=2e-3)


# --------------------------------------------------------------------
# Shapes
# --------------------------------------------------------------------


def test_a_medium_inside_another_that_it_names_as_its_exterior() -> None:
    """Fog of 0.2 from −4 to 4 with a core of 0.7 from −1 to 1; seen by volpath, too."""
    scene = {
        "outer": homogeneous(0.2) | {"id": "outer"},
        "fog": box(-4, 4, {"type": "ref", "id": "outer"}),
        "core": box(-1, 1, homogeneous(0.7), 10) | {"exterior": {"type": "ref", "id": "outer"}},
        "sky": sky(1.0),
    }
    transmittance = np.exp(-0.2 * 6 - 0.7 * 2)
    shown = image_of(scene_of({"quadrature": "exact"}, camera(), **scene))
    np.testing.assert_allclose(shown, (1 - transmittance) / GAMMA + transmittance, rtol=1e-3)
    traced = volpath(camera(), **scene)
    assert abs(traced.mean() - transmittance) < 4 * np.sqrt(transmittance / (4096 * traced.size))


@pytest.mark.parametrize(("low", "high"), [(-1, 1), (2, 6)])
def test_media_that_overlap_are_an_error(low: float, high: float) -> None:
    """Inside without an `exterior`, and partly outside."""
    scene = scene_of({}, camera(), fog=box(-4, 4, homogeneous(0.2)), other=box(low, high, homogeneous(0.7), 10))
    with pytest.raises(RuntimeError) as error:
        mi.render(scene)
    assert "media overlap" in error_message(error.value) and "`exterior`" in error_message(error.value)


def test_an_instance_of_a_medium_is_an_error() -> None:
    scene = scene_of(
        {},
        camera(),
        group={"type": "shapegroup", "fog": box(-1, 1, homogeneous(0.5))},
        instance={"type": "instance", "group": {"type": "ref", "id": "group"}},
        smoke=grid_box(smoke(12), [0, 0, 8]),
    )
    with pytest.raises(RuntimeError) as error:
        mi.render(scene)
    assert "a medium is in a shape group" in error_message(error.value)


def test_touching_boxes_are_one_column() -> None:
    if on_gpu():
        pytest.skip("of boundaries that coincide, OptiX may tell of the same medium twice and of another never")
    scene = {"a": box(-4, 1, homogeneous(0.2)), "b": box(1, 3, homogeneous(0.7)), "c": box(3, 4, homogeneous(0.1))}
    transmittance = np.exp(-0.2 * 5 - 0.7 * 2 - 0.1)
    shown = image_of(scene_of({"quadrature": "transmittance"}, camera(), **scene))
    np.testing.assert_allclose(shown, 1 - transmittance, rtol=1e-3)


@pytest.mark.parametrize("inside", [False, True])
def test_a_shape_with_a_dent_is_entered_twice(inside: bool) -> None:
    """A torus-like pair of walls as one mesh: two boxes in one shape, the camera outside or in the nearer one."""
    vertices, faces = [], []
    for low, high in ((-6, -2), (1, 3)):
        corners = np.array([[x, y, z] for z in (low, high) for y in (-9, 9) for x in (-9, 9)], np.float32)
        quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
        faces += [[len(vertices) + i for i in side] for a, b, c, d in quads for side in ((a, b, c), (a, c, d))]
        vertices += corners.tolist()
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(NULL["bsdf"])
    properties["interior"] = mi.load_dict(homogeneous(0.3))
    mesh = mi.Mesh("walls", len(vertices), len(faces), props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ravel(vertices)
    parameters["faces"] = np.ravel(faces)
    parameters.update()
    origin = (0, 0, 2) if inside else (0, 0, 30)
    shown = image_of(scene_of({"quadrature": "transmittance"}, camera(origin), walls=mesh))
    np.testing.assert_allclose(shown, 1 - np.exp(-0.3 * (5 if inside else 6)), rtol=1e-3)


@pytest.mark.parametrize("kind", ["cube", "smaller cube", "sphere"])
def test_a_mirrored_shape_is_an_error_and_flipped_it_is_what_volpath_shows(kind: str) -> None:
    density = smoke(7)
    edges = np.diag([-6.0, 4, 5])
    interior = medium(GAMMA * density, affine(edges, np.zeros(3)))
    scaled = affine(edges, np.zeros(3)) @ transform().scale(0.5 if kind == "cube" else 0.4)
    shape = {"type": "sphere" if kind == "sphere" else "cube", "to_world": scaled, **NULL, "interior": interior}
    if kind == "sphere":
        shape["to_world"] = transform().scale([-2, 2, 2])
    sensor = camera(fov=14, width=6, height=6)
    with pytest.raises(RuntimeError) as error:
        mi.render(scene_of({}, sensor, smoke=shape))
    assert "normals" in error_message(error.value) and "`flip_normals`" in error_message(error.value)

    shape["flip_normals"], interior["albedo"] = True, 0.0
    sensor["sampler"] = {"type": "independent", "sample_count": 1024}
    shown = image_of(scene_of({"quadrature": "transmittance", "step": 0.02}, sensor, smoke=shape))
    traced = 1 - volpath(sensor, smoke=shape, sky=sky(1.0))
    assert shown.mean() > 0.04
    assert abs(traced.mean() - shown.mean()) < 0.005


def test_a_box_moved_by_its_vertices_is_followed() -> None:
    """The box of a grid after the first render: shrunk, it cuts the smoke; put back, all of it is there again."""
    density = smoke(8)
    scene = scene_of({}, camera(fov=14, width=9, height=8), smoke=grid_box(density, [0, 0, 0]))
    whole = image_of(scene)
    parameters = mi.traverse(scene)
    start = mi.Float(parameters["smoke.vertex_positions"])
    parameters["smoke.vertex_positions"] = 0.6 * start
    parameters.update()
    shrunk = grid_box(density, [0, 0, 0])
    shrunk["to_world"] = shrunk["to_world"] @ transform().scale(0.6)
    expected = image_of(scene_of({}, camera(fov=14, width=9, height=8), smoke=shrunk))
    assert np.abs(expected - whole).max() > 0.1
    np.testing.assert_allclose(image_of(scene), expected, rtol=0, atol=1e-5)
    parameters["smoke.vertex_positions"] = start
    parameters.update()
    np.testing.assert_array_equal(image_of(scene), whole)


@pytest.mark.parametrize("change", ["dielectric", "mask", "emitter", "nearest", "repeat"])
def test_what_cannot_be_marched_is_named(change: str) -> None:
    named = {
        "dielectric": "`null` BSDF",
        "mask": "`null` BSDF",
        "emitter": "must not be an emitter",
        "nearest": 'filter_type "trilinear"',
        "repeat": 'wrap_mode "clamp"',
    }
    shape = grid_box(smoke(9), [0, 0, 0])
    if change == "dielectric":
        shape["bsdf"] = {"type": "dielectric"}
    elif change == "mask":
        # In part `null`: rays end at it.
        shape["bsdf"] = {"type": "mask", "opacity": 0.5, "nested": {"type": "diffuse"}}
    elif change == "emitter":
        shape["emitter"] = {"type": "area"}
    else:
        shape["interior"]["sigma_t"]["filter_type" if change == "nearest" else "wrap_mode"] = change
    with pytest.raises(RuntimeError) as error:
        mi.render(scene_of({}, camera(), smoke=shape))
    assert error_message(error.value).startswith("emission_absorption:") and named[change] in error_message(error.value)


def test_a_grid_that_mirrors_itself_beyond_its_box_is_that_which_ends_there() -> None:
    shape, sensor = grid_box(smoke(14), [0, 0, 0]), camera(fov=14, width=9, height=8)
    ends = image_of(scene_of({}, sensor, smoke=shape))
    shape["interior"]["sigma_t"]["wrap_mode"] = "mirror"
    np.testing.assert_array_equal(image_of(scene_of({}, sensor, smoke=shape)), ends)


def test_a_second_scene_that_shares_a_boundary_has_media_of_its_own() -> None:
    """One integrator, two scenes: fog behind the smoke in the second one only."""
    sensor = camera(fov=14, width=9, height=8)
    shape, integrator = mi.load_dict(grid_box(smoke(13), [0, 0, 0])), {"type": "emission_absorption", "gamma": GAMMA}
    fog = box(-9, -5, homogeneous(0.2))
    scenes = [mi.load_dict({"type": "scene", "sensor": sensor, "a": shape} | more) for more in ({}, {"fog": fog})]
    shared = mi.load_dict(integrator)
    for scene in (*scenes, *scenes):
        alone, shown = (mi.render(scene, integrator=i).numpy() for i in (mi.load_dict(integrator), shared))
        np.testing.assert_array_equal(shown, alone)
    assert np.abs(mi.render(scenes[0], integrator=shared).numpy() - alone).max() > 0.1


# --------------------------------------------------------------------
# Cameras
# --------------------------------------------------------------------


def uniform(kind: str) -> dict[str, object]:
    """Smoke of extinction 0.35 from −2 to 2: a grid in its box, the same in a wider box, or homogeneous."""
    if kind == "homogeneous":
        return box(-2, 2, homogeneous(0.35))
    edges = np.diag([40.0, 40, 4])
    interior = medium(np.full((4, 3, 3), 0.35), affine(edges, np.zeros(3)))
    return box(-2, 2, interior) if kind == "box" else {"type": "sphere", "radius": 60.0, **NULL, "interior": interior}


@pytest.mark.parametrize("kind", ["box", "sphere", "homogeneous"])
@pytest.mark.parametrize(
    ("near", "far", "length"),
    [(0.1, 100, 4), (29, 100, 3), (31.5, 100, 0.5), (33, 100, 0), (0.1, 29.5, 1.5), (29, 31, 2), (0.1, 25, 0)],
)
def test_only_smoke_between_the_clipping_planes_is_seen(kind: str, near: float, far: float, length: float) -> None:
    sensor = camera(near_clip=near, far_clip=far)
    shown = scene_of({"quadrature": "transmittance", "step": 0.002}, sensor, smoke=uniform(kind), sky=sky(0.0))
    np.testing.assert_allclose(image_of(shown), 1 - np.exp(-0.35 * length), rtol=0, atol=2e-3)


@pytest.mark.parametrize("lens", [{"type": "perspective"}, {"type": "thinlens", "aperture_radius": 1.0}])
@pytest.mark.parametrize(("near", "far"), [(0.1, 100), (0.1, 25), (29, 100)])
def test_cameras_and_clipping_planes_against_volpath(lens: dict, near: float, far: float) -> None:
    """In front of the smoke the far plane hides it; a near plane inside needs a sensor that names its medium."""
    interior = medium(GAMMA * smoke(10), affine(np.diag([6.0, 4, 5]), np.zeros(3))) | {"albedo": 0.0, "id": "inside"}
    shape = cube(affine(np.diag([6.0, 4, 5]), np.zeros(3)) @ transform().scale(0.5)) | NULL
    shape["interior"] = {"type": "ref", "id": "inside"}
    sensor = camera(fov=7, width=4, height=4, near_clip=near, far_clip=far) | lens
    if lens["type"] == "thinlens":
        sensor["focus_distance"] = 30.0
    if near > 28:
        sensor["medium"] = {"type": "ref", "id": "inside"}
    sensor["sampler"] = {"type": "independent", "sample_count": 1024}
    parts = {"inside": interior, "smoke": shape, "sky": sky(1.0)}
    shown = image_of(scene_of({"quadrature": "exact", "gamma": 1e9, "step": 0.02}, sensor, **parts))
    traced = volpath(sensor, 16384, **parts)
    error = np.sqrt(np.maximum(shown * (1 - shown), 1e-6) / 16384 + 1e-6)
    assert (np.abs(traced - shown) < 4 * error).all()


def test_samples_of_a_grid_beyond_the_far_plane_do_not_count() -> None:
    density = smoke(11, (9, 4, 6))
    sensor = camera(fov=5, width=9, height=8, far_clip=29.3)
    scene = scene_of({}, sensor, smoke=grid_box(density, [0, 0, 0]))
    row, column = np.divmod(np.arange(72), 9)
    position = mi.Point2f((column + 0.5) / 9, (row + 0.5) / 8)
    rays, _ = scene.sensors()[0].sample_ray(0.0, 0.0, position, mi.Point2f(0.5))
    origins, directions = (np.float64(vectors).T for vectors in (rays.o, rays.d))
    edges = np.diag([6.0, 4, 9])
    values = ray_march.samples(
        density, edges, np.zeros(3), origins, directions, 1.0, lambda points: points[..., 2] > 30 - 29.3
    )
    expected = ray_march.radiance(values, GAMMA, 1.0, "paper").reshape(8, 9)
    np.testing.assert_allclose(image_of(scene), expected, rtol=0, atol=1e-4)

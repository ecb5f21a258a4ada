"""Fog without a boundary of its own: rays start in it, or end in it, because sensors and surfaces name it."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from fields import smooth_noise
from smoke_scenes import affine, cube, error_message, film, image_of, medium

GAMMA = 0.5
FOG = 0.05
NAMED = {"type": "ref", "id": "fog"}
NULL = {"bsdf": {"type": "null"}}


def homogeneous(extinction: float, **others: object) -> dict[str, object]:
    return {"type": "homogeneous", "albedo": 0.0, "sigma_t": extinction, **others}


def smoke(**others: object) -> dict[str, object]:
    """Absorbing smoke of a 5×4×6 grid in its box, about the origin."""
    density = np.abs(smooth_noise(np.random.default_rng(1), 5, 4, 6)) + 0.1
    placed = affine(np.diag([4.0, 2.5, 5]), np.zeros(3))
    shape = cube(placed @ mi.ScalarTransform4f().scale(0.5))
    return shape | NULL | {"interior": medium(GAMMA * density, placed) | {"albedo": 0.0}, **others}


def ball(radius: float, **others: object) -> dict[str, object]:
    return {"type": "sphere", "radius": radius, **NULL, **others}


def wall(**others: object) -> dict[str, object]:
    """A 10×8 rectangle at z = −8 that faces +z."""
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, -8]).scale([5, 4, 1]), **others}


def bright(**others: object) -> dict[str, object]:
    return wall(emitter={"type": "area", "radiance": 1.0}, **others)


def camera(fov: float = 36.0, distance: float = 12.0, **others: object) -> dict[str, object]:
    """A camera on the z axis that looks at the origin; its widest angle sees the smoke, the wall and past them."""
    to_world = mi.ScalarTransform4f().look_at([0, 0, distance], [0, 0, 0], [0, 1, 0])
    return {"type": "perspective", "fov": fov, "to_world": to_world, **film(16, 12), **others}


def scene_of(integrator: dict[str, object], **parts: object) -> mi.Scene:
    return mi.load_dict({"type": "scene", "fog": homogeneous(FOG, id="fog"), **parts, "integrator": integrator})


def march(**properties: object) -> dict[str, object]:
    return {"type": "emission_absorption", "gamma": GAMMA, "quadrature": "exact", **properties}


def renders(scene: mi.Scene, seeds: int, paths: int) -> np.ndarray:
    """Independent images (seeds, H, W)."""
    return np.stack([mi.render(scene, spp=paths, seed=seed).numpy()[..., 0] for seed in range(seeds)])


VIEWS = {
    "a wall that shines": lambda: {"wall": bright(exterior=NAMED)},
    "a wall that shines and names nothing": lambda: {"wall": bright()},
    "a lit wall": lambda: {
        "wall": wall(exterior=NAMED, bsdf={"type": "diffuse", "reflectance": 0.8}),
        "lamp": {"type": "point", "position": [1, 5, 3], "intensity": 300.0},
    },
    "a wall and the sky": lambda: {"wall": bright(exterior=NAMED), "sky": {"type": "constant"}},
    "the sky": lambda: {"sky": {"type": "constant"}},
}


@pytest.mark.parametrize("view", VIEWS)
def test_all_in_fog_that_the_sensor_names_is_what_volpath_shows(view: str) -> None:
    """Emission of nearly nothing leaves the transmittance; in front of no smoke, too, and where rays meet nothing."""
    parts = {
        "sensor": camera(medium=NAMED) | {"sampler": {"type": "independent"}},
        "smoke": smoke(exterior=NAMED),
        **VIEWS[view](),
    }
    behind = {"behind": {"type": "volpath"}} if "lamp" in parts else {}
    ours = renders(scene_of(march(gamma=1e9, step=0.05, **behind), **parts), 40, 64)
    theirs = renders(scene_of({"type": "volpath"}, **parts), 40, 64)
    error = np.sqrt((ours.var(0, ddof=1) + theirs.var(0, ddof=1)) / len(ours))
    assert (np.abs(ours.mean(0) - theirs.mean(0)) <= 3 * error + 1e-6).mean() >= 0.99
    assert abs(ours.mean() - theirs.mean()) * error.size <= 4 * np.sqrt((error**2).sum()) + 1e-6
    if "wall" in parts:
        clear = parts | {"fog": homogeneous(0.0, id="fog")}
        assert renders(scene_of({"type": "volpath"}, **clear), 2, 64).mean() > 1.5 * theirs.mean(), "the fog matters"


@pytest.mark.parametrize("named", ["by the wall", "by the sensor", "by both"])
@pytest.mark.parametrize("others", [False, True])
def test_fog_up_to_a_wall_against_the_closed_form(named: str, others: bool) -> None:
    """Rays meet no boundary; smoke elsewhere, or none."""
    T = np.exp(-FOG * 20)
    parts = {"sensor": camera(fov=1.0), "wall": bright()}
    if named != "by the sensor":
        parts["wall"]["exterior"] = NAMED
    if named != "by the wall":
        parts["sensor"]["medium"] = NAMED
    if others:
        parts["smoke"] = smoke(exterior=NAMED)
        parts["smoke"]["to_world"] = mi.ScalarTransform4f().translate([40, 0, 0]) @ parts["smoke"]["to_world"]
    np.testing.assert_allclose(image_of(scene_of(march(), **parts)), (1 - T) / GAMMA + T, rtol=1e-3)


def test_rays_that_meet_nothing_are_in_the_fog_for_ever() -> None:
    """Its image is 1/γ, whether the sky is bright or not."""
    for sky in ({}, {"sky": {"type": "constant"}}):
        shown = image_of(scene_of(march(), sensor=camera(medium=NAMED), **sky))
        np.testing.assert_allclose(shown, 1 / GAMMA, rtol=1e-5)


def test_behind_smoke_the_fog_goes_on_up_to_a_wall_that_names_it() -> None:
    """Fog, a ball of twice its extinction, fog: with and without the sensor's word, since the ball has it as well."""
    T = np.exp(-FOG * (20 + 6))
    other = homogeneous(2 * FOG)
    for word in ({}, {"medium": NAMED}):
        shown = scene_of(
            march(), sensor=camera(fov=1.0, **word), ball=ball(3.0, interior=other, exterior=NAMED),
            wall=bright(exterior=NAMED),
        )  # fmt: skip
        np.testing.assert_allclose(image_of(shown), (1 - T) / GAMMA + T, rtol=2e-3)


def test_each_sensor_of_a_scene_has_its_own_word() -> None:
    """In any order, and that of a sensor outside the scene: what an integrator of its own shows, to the bit."""
    parts = {"smoke": smoke(), "sky": {"type": "constant"}}
    scene = scene_of(march(), **parts, a_sensor=camera(), b_sensor=camera(medium=NAMED))
    outside = [mi.load_dict(camera()), mi.load_dict(camera(medium=homogeneous(0.02)))]
    images = []
    for sensor in (0, 1, 0, *outside, 1, *outside, 0):
        shown, alone = (
            mi.render(scene, sensor=sensor, integrator=i) for i in (scene.integrator(), mi.load_dict(march()))
        )
        np.testing.assert_array_equal(shown.numpy(), alone.numpy())
        images.append(shown.numpy())
    np.testing.assert_array_equal(images[0], images[3])
    for i, j in ((0, 1), (1, 4), (0, 4)):
        assert np.abs(images[i] - images[j]).max() > 0.1


def test_the_image_of_a_box_does_not_depend_on_what_another_sensor_named_before() -> None:
    scene = scene_of(march(), smoke=smoke(), a_sensor=camera(), b_sensor=camera(medium=NAMED))
    first = mi.render(scene, sensor=0).numpy()
    mi.render(scene, sensor=1)
    np.testing.assert_array_equal(mi.render(scene, sensor=0).numpy(), first)


def test_the_derivative_of_fog_that_the_sensor_alone_names() -> None:
    """Of (1 − T)/γ + T B with B = 1, forwards and backwards, against the closed form."""
    scene = scene_of(march(), sensor=camera(fov=1.0, medium=NAMED), wall=bright())
    parameters = mi.traverse(scene)
    (key,) = (key for key in parameters.keys() if key.endswith("sigma_t.value.value"))
    expected = 20 * np.exp(-FOG * 20) * (1 / GAMMA - 1)
    dr.enable_grad(parameters[key])
    parameters.update()
    dr.backward(dr.mean(mi.render(scene, parameters), axis=None))
    assert np.array(dr.grad(parameters[key])).sum() == pytest.approx(expected, rel=1e-3)
    dr.set_grad(parameters[key], 1.0)
    parameters.update()
    np.testing.assert_allclose(dr.forward_to(mi.render(scene, parameters)).numpy(), expected, rtol=2e-3)


CONTRADICTIONS = {
    "a boundary in front of which there is another medium": lambda: {"smoke": smoke(exterior=homogeneous(0.2))},
    "the boundary of the fog, met from outside": lambda: {"fog_ball": ball(4.0, interior=NAMED)},
    "smoke in the fog that does not say so": lambda: {"smoke": smoke(), "wall": bright(exterior=NAMED)},
}


@pytest.mark.parametrize("contradiction", CONTRADICTIONS)
def test_a_sensor_that_contradicts_the_boundaries_is_an_error(contradiction: str) -> None:
    with pytest.raises(RuntimeError) as error:
        mi.render(scene_of(march(), sensor=camera(medium=NAMED), **CONTRADICTIONS[contradiction]()))
    assert "media overlap" in error_message(error.value) and "a sensor" in error_message(error.value)


@pytest.mark.parametrize("inside", [False, True])
def test_smoke_may_stand_in_a_wall_that_names_the_fog_around_it(inside: bool) -> None:
    """The box ends behind the wall, so that rays never meet it: just in front of the wall they are in smoke."""
    extinction, smoke_box = 0.3, cube(mi.ScalarTransform4f().translate([0, 0, -6.5]).scale([4, 4, 2]))
    smoke_box |= NULL | {"interior": {"type": "ref", "id": "smoke"}, "exterior": NAMED}
    parts = {"smoke": homogeneous(extinction, id="smoke"), "box": smoke_box, "wall": bright(exterior=NAMED)}
    named, distance = ({"type": "ref", "id": "smoke"}, -5.0) if inside else (NAMED, 4.0)
    sensor = camera(fov=1.0, distance=distance, medium=named)
    away = mi.ScalarTransform4f().look_at([0, 0, distance], [0, 0, distance - 1], [0, 1, 0])
    T = np.exp(-extinction * 3 if inside else -extinction * 3.5 - FOG * 8.5)
    shown = image_of(scene_of(march(), sensor=sensor | {"to_world": away}, **parts))
    np.testing.assert_allclose(shown, (1 - T) / GAMMA + T, rtol=1e-3)


@pytest.mark.parametrize("word", [{}, {"medium": NAMED}])
def test_surfaces_in_shape_groups_leave_the_word_to_the_sensor(word: dict[str, object]) -> None:
    """As for Mitsuba's path tracers. The wall is black."""
    shown = scene_of(
        march(behind={"type": "direct"}),
        sensor=camera(fov=1.0, **word),
        group={"type": "shapegroup", "wall": wall(exterior=NAMED, bsdf={"type": "diffuse", "reflectance": 0.0})},
        instance={"type": "instance", "group": {"type": "ref", "id": "group"}},
        ball=ball(1.0, center=[40, 0, 0], interior=homogeneous(0.2), exterior=NAMED),
    )
    expected = (1 - np.exp(-FOG * 20)) / GAMMA if word else 0.0
    np.testing.assert_allclose(image_of(shown), expected, rtol=1e-3)

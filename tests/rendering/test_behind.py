"""What is seen behind the smoke: by a nested integrator, and never black without a word."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from fields import directional_error, smooth_noise
from smoke_scenes import (
    affine,
    cube,
    error_message,
    extinction_gradient,
    extinction_objective,
    extinction_of,
    film,
    image_of,
    medium,
)

GAMMA = 0.5
ABSORBING = {"gamma": 1e9, "quadrature": "exact", "step": 0.05}
"""An emission of nearly nothing: what is left is the transmittance times what lies behind."""


def smoke_box(seed: int, centre: list[float], edges: np.ndarray | None = None) -> dict[str, object]:
    """Absorbing smoke of a 5×4×6 grid in its box."""
    density = np.abs(smooth_noise(np.random.default_rng(seed), 5, 4, 6)) + 0.1
    placed = affine(np.diag([6.0, 4, 5]) if edges is None else edges, np.array(centre))
    interior = medium(GAMMA * density, placed) | {"albedo": 0.0}
    shape = cube(placed @ mi.ScalarTransform4f().scale(0.5))
    return shape | {"bsdf": {"type": "null"}, "interior": interior}


def room(**others: object) -> dict[str, object]:
    """A diffuse wall lit by a point light, smoke in a grid and a ball of fog before it, and a perspective camera."""
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    transform = mi.ScalarTransform4f
    return {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 30,
            "to_world": transform().look_at([1, 2, 20], [0, 0, 0], [0, 1, 0]),
            **film(20, 16),
        },
        "wall": {
            "type": "rectangle",
            "to_world": transform().translate([0, 0, -8]).scale([7, 5, 1]),
            "bsdf": {"type": "diffuse", "reflectance": 0.8},
        },
        "lamp": {"type": "point", "position": [5, 9, 3], "intensity": 300.0},
        "smoke": smoke_box(2, [-1, 0.5, 5], turn @ np.diag([6.0, 4, 5])),
        "fog": {
            "type": "sphere",
            "center": [1, -0.5, -2],
            "radius": 2.5,
            "bsdf": {"type": "null"},
            "interior": {"type": "homogeneous", "albedo": 0.0, "sigma_t": 0.25},
        },
        **others,
    }


def renders(scene: dict[str, object], integrator: dict[str, object], seeds: int, paths: int) -> np.ndarray:
    """Independent images (seeds, H, W)."""
    loaded = mi.load_dict(scene | {"integrator": integrator})
    return np.stack([mi.render(loaded, spp=paths, seed=seed).numpy()[..., 0] for seed in range(seeds)])


def assert_agree(ours: np.ndarray, theirs: np.ndarray) -> None:
    """Means over independent images differ by less than 3 of their standard errors in 99% of the pixels."""
    count = len(ours)
    error = np.sqrt((ours.var(0, ddof=1) + theirs.var(0, ddof=1)) / count)
    difference = np.abs(ours.mean(0) - theirs.mean(0))
    assert (difference <= 3 * error + 1e-6).mean() >= 0.99
    assert np.abs((ours.mean() - theirs.mean()) / np.sqrt((error**2).sum()) * error.size) < 4


def independent(scene: dict[str, object]) -> dict[str, object]:
    return scene | {"sensor": scene["sensor"] | {"sampler": {"type": "independent"}}}


def test_a_lit_wall_behind_two_media_is_what_volpath_shows() -> None:
    """Light falls on the wall through the smoke, too: its shadows are the nested integrator's."""
    scene = independent(room())
    ours = renders(scene, {"type": "emission_absorption", **ABSORBING, "behind": {"type": "volpath"}}, 40, 64)
    theirs = renders(scene, {"type": "volpath"}, 40, 64)
    clear = {name: part for name, part in scene.items() if name not in ("smoke", "fog")}
    without = renders(clear, {"type": "volpath"}, 2, 64).mean(0)
    assert (without - theirs.mean(0)).max() > 0.3 * without.max(), "the smoke is thick enough to matter"
    assert_agree(ours, theirs)


@pytest.mark.parametrize("media", [1, 2])
def test_an_object_inside_the_smoke_is_lit_through_it(media: int) -> None:
    """The nested integrator is told that its rays start inside the medium."""
    ball = {"type": "sphere", "radius": 1.2, "center": [-1, 0.5, 5], "bsdf": {"type": "diffuse"}}
    scene = independent(room(ball=ball))
    if media == 1:
        del scene["fog"]
    ours = renders(scene, {"type": "emission_absorption", **ABSORBING, "behind": {"type": "volpath"}}, 40, 64)
    theirs = renders(scene, {"type": "volpath"}, 40, 64)
    assert_agree(ours, theirs)


@pytest.mark.parametrize("nested", ["path", "direct", "volpath", "prb", "prbvolpath"])
def test_emission_is_added_before_what_a_nested_integrator_shows(nested: str) -> None:
    """Without noise: the wall shines."""
    wall = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, -9]).scale(50)}
    wall["emitter"] = {"type": "area", "radiance": 0.8}
    scene = room(smoke=smoke_box(3, [0, 0, 0]), wall=wall)
    for name in ("fog", "lamp"):
        del scene[name]
    plain = {"type": "emission_absorption", "gamma": GAMMA}
    dark = scene | {"wall": wall | {"emitter": {"type": "area", "radiance": 0.0}}}
    emission = image_of(mi.load_dict(dark | {"integrator": plain}))
    opacity = image_of(mi.load_dict(dark | {"integrator": plain | {"quadrature": "transmittance"}}))
    shown = image_of(mi.load_dict(scene | {"integrator": plain | {"behind": {"type": nested}}}))
    assert opacity.max() > 0.4
    np.testing.assert_allclose(shown, emission + (1 - opacity) * 0.8, rtol=0, atol=1e-5)


def test_a_gradient_before_a_lit_wall_against_central_differences() -> None:
    """What is behind counts as constant; its noise is the same in each render."""
    scene = room(smoke=smoke_box(4, [0, 0, 0]))
    del scene["fog"]
    integrator = {"type": "emission_absorption", "gamma": GAMMA, "behind": {"type": "direct"}}
    scene = mi.load_dict(scene | {"integrator": integrator})
    rng = np.random.default_rng(4)
    weights = smooth_noise(rng, 16, 20, 1)
    start, objective = extinction_of(scene), extinction_objective(scene, weights)
    gradient = extinction_gradient(scene, weights)
    directions = [smooth_noise(rng, 5, 4, 6)[..., None] for _ in range(8)]
    assert directional_error(objective, gradient, start, directions, 1e-2) <= 1e-3


def test_a_nested_integrator_shows_the_sky_too_unless_it_hides_emitters() -> None:
    scene = {"type": "scene", "sensor": room()["sensor"], "smoke": smoke_box(5, [0, 0, 0]), "sky": {"type": "constant"}}
    images = []
    for behind in ({}, {"behind": {"type": "path"}}, {"behind": {"type": "path", "hide_emitters": True}}):
        integrator = {"type": "emission_absorption", "gamma": GAMMA, **behind}
        images.append(image_of(mi.load_dict(scene | {"integrator": integrator})))
    black = image_of(mi.load_dict({k: v for k, v in scene.items() if k != "sky"} | {"integrator": integrator}))
    np.testing.assert_allclose(images[1], images[0], rtol=1e-5)
    np.testing.assert_allclose(images[2], black, rtol=0, atol=1e-6)


def test_a_nested_integrator_in_xml() -> None:
    nested = '<integrator type="emission_absorption"><integrator type="volpath"/></integrator>'
    scene = mi.load_string(f'<scene version="3.0.0">{nested}</scene>')
    assert "EmissionAbsorption" in str(scene.integrator())


@pytest.mark.parametrize(
    ("nested", "named"),
    [
        ({"a": {"type": "path"}, "b": {"type": "volpath"}}, "2 nested integrators, expected one at most"),
        ({"a": {"type": "ptracer"}}, "cannot sample single rays"),
        ({"a": {"type": "diffuse"}}, "cannot sample single rays"),
    ],
)
def test_bad_nested_integrators_are_named(nested: dict, named: str) -> None:
    with pytest.raises((RuntimeError, ValueError)) as error:
        mi.load_dict({"type": "emission_absorption", **nested})
    assert named in str(error.value) or named in error_message(error.value)

"""The scenes of scenes/known: their numbers, computed again, and what every integrator finds in them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.compare.bench.renderers.known_answers import Answer, answer_of, known_scenes
from tnst_mi.compare.bench.renderers.parameters import SceneParameters
from tnst_mi.compare.bench.renderers.scene_file import scene_renderer
from tnst_mi.compare.bench.renderers.sides import OURS, PATH_TRACERS, side_of
from tnst_mi.errors import InputError
from tnst_mi.io.grids.vol import read_vol
from tnst_mi.resources import scene_file

ANSWERS = {path.stem: (path, answer) for path, answer in known_scenes().items()}


def single_scattering(factor: float = 1.0, albedo: float = 0.5, g: float = 0.4, x: float = 0.0) -> float:
    """Of the point light, by another quadrature than that of answers.toml: Simpson's rule on 2000 intervals."""
    σ = 0.2 * factor
    z = np.linspace(-1, 1, 2001)
    weights = np.where(np.arange(2001) % 2, 4.0, 2.0)
    weights[[0, -1]] = 1.0
    distance = np.sqrt((0.5 - x) ** 2 + 0.3**2 + z**2)
    phase = (1 - g**2) / (4 * math.pi * (1 + g**2 - 2 * g * z / distance) ** 1.5)
    values = σ * albedo * phase / distance**2 * np.exp(-σ * ((1 - z) + distance))
    return float((weights * values).sum() * 1e-3 / 3)


def optical_depth(name: str) -> float:
    gaussian = 2 * 0.3 * math.sqrt(2 * math.pi) * math.erf(1.25 / (0.3 * math.sqrt(2)))
    return {"slab": 1.0, "tight_majorant": 1.0, "two_layers": 0.7 * 1 + 1.6 * 0.5, "gaussian": gaussian}[name]


@pytest.mark.parametrize("name", ["slab", "two_layers", "gaussian", "tight_majorant"])
def test_transmittances_are_those_of_their_formulas(name: str) -> None:
    τ, answer = optical_depth(name), ANSWERS[name][1]
    assert answer.radiance == pytest.approx(math.exp(-τ), rel=1e-12)
    assert answer.derivatives["extinction"] == pytest.approx(-τ * math.exp(-τ), rel=1e-12)
    assert answer.source and answer.formula and not answer.scatters


def test_single_scattering_is_that_of_another_quadrature() -> None:
    answer, h = ANSWERS["point_light"][1], 1e-4
    assert answer.radiance == pytest.approx(single_scattering(), rel=1e-9)
    for key, argument, at in (
        ("extinction", "factor", 1),
        ("albedo", "albedo", 0.5),
        ("anisotropy", "g", 0.4),
        ("sensor", "x", 0),
    ):
        sides = [single_scattering(**{argument: at + sign * h}) for sign in (1, -1)]
        assert answer.derivatives[key] == pytest.approx((sides[0] - sides[1]) / (2 * h), rel=1e-6), key


def test_grids_are_what_they_are_said_to_be() -> None:
    r = (np.arange(25) - 12) * 0.1
    squares = r[:, None, None] ** 2 + r[:, None] ** 2 + r**2
    np.testing.assert_allclose(
        read_vol(scene_file("known/gaussian.vol")), 2 * np.exp(-squares / (2 * 0.3**2)), rtol=1e-6
    )
    np.testing.assert_array_equal(read_vol(scene_file("known/uniform.vol")), 1)
    row = read_vol(scene_file("known/gaussian.vol"))[:, 12, 12].astype(np.float64)
    assert row.sum() * 0.1 == pytest.approx(optical_depth("gaussian"), rel=2e-5), "of the grid, up to the tails"


@pytest.mark.parametrize("name", ANSWERS)
@pytest.mark.parametrize("integrator", PATH_TRACERS)
def test_every_integrator_of_mitsuba_finds_the_radiance(name: str, integrator: str) -> None:
    """Within three standard errors of 32 batches, by Student's law 1 in 190 by chance; the seed is fixed."""
    path, answer = ANSWERS[name]
    found = scene_renderer(path, side_of("left", integrator)).images(1 << 12, 32, (1,), lambda paths: None)
    error = float(found.standard_error.squeeze())
    assert 0 < error < 0.05 * max(answer.radiance, 0.2)
    assert abs(float(found.mean.squeeze()) - answer.radiance) <= 3 * error


@pytest.mark.parametrize("name", [name for name, (_, answer) in ANSWERS.items() if not answer.scatters])
def test_ours_finds_radiance_and_derivative_to_1e_4(name: str) -> None:
    path, answer = ANSWERS[name]
    renderer = scene_renderer(path, side_of("left", OURS))
    assert float(renderer.images(1, 1, (1,), lambda paths: None).mean.squeeze()) == pytest.approx(
        answer.radiance, rel=1e-4
    )
    parameters = SceneParameters(renderer.scene)
    for way in (renderer.derivatives, renderer.differences):
        found = way(parameters, "extinction", 1, 1, (2,), lambda paths: None)
        assert float(found.mean) == pytest.approx(answer.derivatives["extinction"], rel=1e-4)


def prb_derivative(name: str, parameter: str) -> tuple[float, float, Answer]:
    """By differentiation of prbvolpath, its standard error, and the answer."""
    path, answer = ANSWERS[name]
    renderer = scene_renderer(path, side_of("left", "prbvolpath"))
    found = renderer.derivatives(SceneParameters(renderer.scene), parameter, 1 << 14, 32, (3,), lambda paths: None)
    return float(found.mean), float(found.standard_error), answer


@pytest.mark.parametrize(
    ("name", "parameter"),
    [("slab", "extinction"), ("gaussian", "extinction"), ("point_light", "albedo"), ("point_light", "anisotropy")],
)
def test_prbvolpath_finds_derivatives(name: str, parameter: str) -> None:
    value, error, answer = prb_derivative(name, parameter)
    assert 0 < error < 0.05 * abs(answer.derivatives[parameter])
    assert abs(value - answer.derivatives[parameter]) <= 3 * error


def test_with_a_tight_majorant_the_derivative_of_prbvolpath_is_0() -> None:
    """The pitfall that docs/physics.md names: no null collisions, no derivative."""
    value, _, answer = prb_derivative("tight_majorant", "extinction")
    assert value == 0 and answer.derivatives["extinction"] < -0.3


def test_prbvolpath_leaves_out_the_way_from_a_light_inside_a_homogeneous_medium() -> None:
    """The derivative without that of the transmittance from the light, which docs/physics.md explains: if this fails,
    Mitsuba has mended it, and the page is to be changed."""
    value, error, answer = prb_derivative("point_light", "extinction")
    assert value - answer.derivatives["extinction"] > 5 * error
    z, weights = np.polynomial.legendre.leggauss(100)
    distance = np.sqrt(0.34 + z**2)
    phase = (1 - 0.4**2) / (4 * math.pi * (1 + 0.4**2 - 0.8 * z / distance) ** 1.5)
    shown = weights * 0.1 * phase / distance**2 * np.exp(-0.2 * ((1 - z) + distance))
    assert abs(value - (shown * (1 - 0.2 * (1 - z))).sum()) <= 3 * error


def test_what_is_wrong_with_answers_is_said(tmp_path: Path) -> None:
    scene, file = tmp_path / "mine.xml", tmp_path / "answers.toml"
    with pytest.raises(InputError, match=r"answers\.toml"):
        answer_of(scene)
    for text, message in (
        ("radiance = 1", r"knows no answer of mine\.xml, expected a table \[mine\]"),
        ("[mine]\nradiance = nan", r"\[mine\] radiance is nan, expected a finite number"),
        ("[mine]\nderivatives = 3", r"\[mine\] derivatives is 3, expected a table of extinction"),
        ("[mine]\nradiance = 1\nderivatives = {g = 1}", r"expected a table of extinction, albedo, anisotropy, sensor"),
        ("[mine]\nradiance = 1\nscatters = 'false'", r"\[mine\] scatters is 'false', expected true or false"),
        ("[mine]\nradiance = 1\nderivative = {}", r"\[mine\] has the key 'derivative', expected some of derivatives, "),
        ("[mine", "cannot be read as TOML"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=message) as error:
            answer_of(scene)
        assert str(file) in str(error.value) and "\n" not in str(error.value)
    file.write_text("[mine]\nradiance = 2")
    assert answer_of(scene) == Answer(2.0, {}, True, "", "")

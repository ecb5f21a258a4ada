"""Mitsuba's variants in `tnst-mi compare --left A@VARIANT`: what agrees in which, and what is refused."""

from __future__ import annotations

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from command_line import Run, refused, run

from tnst_mi.compare.bench.bench_settings import BenchSettings
from tnst_mi.compare.bench.measurement import prepare
from tnst_mi.compare.bench.renderers.known_answers import answer_of
from tnst_mi.compare.bench.renderers.parameters import SceneParameters
from tnst_mi.compare.bench.renderers.scene_file import scene_renderer
from tnst_mi.compare.bench.renderers.sides import side_of
from tnst_mi.compare.bench.renderers.smoke_scene import SmokeScene, smoke_renderer
from tnst_mi.compare.bench.renderers.variants import LUMINANCE, SPECTRAL_WHITE, variant_of, within
from tnst_mi.errors import InputError
from tnst_mi.machine.backend import activate
from tnst_mi.resources import scene_file

__all__ = ["run"]

KINDS = ("mono", "spectral")

CENTRED, NEAR = (25.0, -12.0), (25.0, -12.0, 20.0)

COLOURED = """<scene version="3.0.0">
    <sensor type="orthographic">
        <transform name="to_world"><lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="2"/><integer name="height" value="1"/>
            <string name="pixel_format" value="rgba"/><rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="constant"><rgb name="radiance" value="0.9, 0.5, 0.1"/></emitter>
    <shape type="cube">
        <bsdf type="null"/>
        <medium name="interior" type="homogeneous">
            <spectrum name="sigma_t" value="0.5"/><spectrum name="albedo" value="0"/>
        </medium>
    </shape>
    <integrator type="volpath"/>
</scene>"""


def blob() -> np.ndarray:
    z, y, x = np.meshgrid(*(np.linspace(-2, 2, n) for n in (6, 9, 7)), indexing="ij")
    return np.exp(-(x**2) - y**2 - z**2).astype(np.float32)


def test_a_side_may_name_a_variant(tmp_path: Path) -> None:
    side = side_of("left", "emission_absorption:paper@spectral")
    assert (side.kind, side.quadrature, side.variant) == ("emission_absorption", "paper", "spectral")
    folder = tmp_path / "render@mono"
    folder.mkdir()
    assert side_of("left", str(folder)).kind == "pictures" and side_of("left", str(folder)).variant == ""
    backend = activate().removesuffix("rgb")
    assert variant_of(side, True) == f"{backend}spectral" and variant_of(side_of("left", "volpath"), True)
    for text in ("float64@mono", "answer@mono", f"{tmp_path}@mono"):
        with pytest.raises(InputError, match="is not rendered by Mitsuba, expected it without @mono"):
            side_of("left", text)


@pytest.mark.parametrize(
    ("text", "of_smoke", "message"),
    [
        ("volpath@rgb_quadruple", True, "has no variant rgb_quadruple, expected one of .*scalar_rgb.* compiled from"),
        ("prbvolpath@scalar_rgb", False, "is not in scalar_rgb, which does not differentiate; expected volpath"),
        ("volpath@scalar_rgb", True, "scalar_rgb renders one ray after the other, expected a Mitsuba scene as INPUT"),
        (
            "volpathmis@llvm_ad_mono_polarized",
            False,
            "does not work with the Stokes vectors of .*, expected vol",
        ),
        ("volpath@llvm_ad_mono_polarized", True, "the views of smoke have no Stokes vectors"),
    ],
)
def test_what_does_not_work_in_a_variant_is_refused(text: str, of_smoke: bool, message: str) -> None:
    activate()
    with pytest.raises(InputError, match=message) as error:
        variant_of(side_of("left", text), of_smoke)
    assert str(error.value).startswith(f"{text}: ") and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("integrator", "variant"),
    [
        ("volpath", "scalar_rgb"),
        ("volpathmis", "scalar_spectral"),
        ("volpath", "mono"),
        ("volpath", "spectral_polarized"),
        ("prbvolpath", "spectral"),
    ],
)
def test_path_tracers_find_the_radiance_of_a_grid_in_every_kind_of_variant(integrator: str, variant: str) -> None:
    """Within three standard errors of 32 batches, 2% of the answer or less."""
    activate()
    path = scene_file("known/gaussian.xml")
    side = side_of("left", f"{integrator}@{variant}")
    with within(variant_of(side, False)):
        white = SPECTRAL_WHITE if mi.is_spectral else 1.0
        found = scene_renderer(path, side).images(1 << 14, 32, (1,), lambda paths: None)
    error = float(found.standard_error.squeeze())
    assert 0 < error < 0.02 * answer_of(path).radiance
    assert abs(float(found.mean.squeeze()) - white * answer_of(path).radiance) <= 3 * error


def test_ours_is_the_same_in_mono_and_noisy_by_wavelengths_alone_in_spectral() -> None:
    """Each is used again after the others were active, with rays from an eye, whose samples lie in planes."""
    activate()
    smoke = SmokeScene(blob(), (CENTRED, NEAR))
    sides = [side_of("left", text) for text in ("emission_absorption", *(f"emission_absorption@{v}" for v in KINDS))]
    variants = [variant_of(side, True) for side in sides]
    renderers = []
    with within(variants[0]):
        before = smoke_renderer(smoke, 0.4, sides[0], 1e-3).images(1, 1, (3,), lambda paths: None)
    for side, variant in zip(sides, variants, strict=True):
        with within(variant):
            renderers.append(smoke_renderer(smoke, 0.4, side, 1e-3))
    images = []
    for _ in range(2):
        for renderer, variant in zip(renderers, variants, strict=True):
            with within(variant):
                images.append(renderer.images(1 << 10, 16, (3,), lambda paths: None))
    rgb, mono, spectral = images[3:]
    np.testing.assert_array_equal(rgb.values, before.values)
    np.testing.assert_allclose(mono.values, rgb.values, rtol=1e-6)
    assert rgb.exact and mono.exact and not spectral.exact
    scores = (spectral.mean - rgb.mean) / spectral.standard_error
    assert 0.6 < scores.std() < 1.4 and spectral.standard_error.max() < 2e-3 * rgb.mean.max()
    assert abs(scores.mean()) < 3 / np.sqrt(scores.size), "a white spectrum is 1"


def test_a_white_spectrum_is_not_quite_1_on_a_film() -> None:
    """By the integral of what Mitsuba makes of it; if this fails, its constant has changed."""
    activate()
    with within(variant_of(side_of("left", "volpath@spectral"), False)):
        wavelengths = np.linspace(360, 830, 4701)
        y = mi.spectrum_to_xyz(mi.Spectrum(1.0), mi.Spectrum(mi.Float(wavelengths))).y
        assert np.trapezoid(np.array(y), wavelengths) == pytest.approx(SPECTRAL_WHITE, rel=1e-6)
        dr.eval(y)


def test_a_film_of_colours_is_held_against_one_without_by_its_luminance(tmp_path: Path) -> None:
    """Also its derivative, whose adjoint has the channels of the film."""
    activate()
    path = tmp_path / "coloured.xml"
    path.write_text(COLOURED)
    sides = [side_of("left", "emission_absorption"), side_of("right", "emission_absorption@mono")]
    settings = BenchSettings(*sides, (), 32, 32, ("extinction",), 1e-3, 0)
    (ready,) = prepare(path, settings)
    assert ready.shape == (1, 1, 2, 1)
    left, right = (side.images(32, lambda share: None).mean for side in ready.sides)
    expected = np.exp(-1.0) * np.dot(LUMINANCE, (0.9, 0.5, 0.1))
    np.testing.assert_allclose(left, expected, rtol=1e-4)
    np.testing.assert_allclose(right, expected, rtol=1e-4)
    assert ready.sides[0].untested == ["colours: emission_absorption@mono has luminance alone"]
    taken, _ = ready.sides[0].derivatives("extinction", 32, lambda share: None)
    for way, found in taken.items():
        assert float(found.mean) == pytest.approx(-expected, rel=1e-3), way
    renderer = scene_renderer(path, sides[0])
    coloured = renderer.derivatives(SceneParameters(renderer.scene), "extinction", 32, 1, (0,), lambda paths: None)
    assert float(coloured.mean) == pytest.approx(-np.exp(-1.0) * 0.5, rel=1e-3), "the mean of three, beside alpha"


def test_the_variant_is_part_of_the_report(run: Run, tmp_path: Path) -> None:
    before = activate()
    out = tmp_path / "out"
    sides = ("--left", "volpath@scalar_rgb", "--right", "answer", "--spp", 4096)
    ran = run("compare", scene_file("known/slab.xml"), "--out", out, *sides)
    assert ran.code == 0 and '"left": "scalar_rgb",\n  "right": null' in (out / "report.json").read_text("utf-8")
    assert mi.variant() == before
    refused(
        run,
        tmp_path,
        ["compare", scene_file("known/slab.xml"), "--out", tmp_path / "no", "--left", "volpath@quad"],
        "volpath@quad: Mitsuba .* has no variant quad",
    )

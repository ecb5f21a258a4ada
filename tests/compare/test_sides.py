"""`tnst-mi compare --left A --right B`: what agrees, what does not, baselines, and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from command_line import Ran, Run, refused, run
from fields import smooth_noise

from tnst_mi.compare.bench.renderers.parameters import PARAMETERS, SceneParameters
from tnst_mi.compare.bench.renderers.renderer import ramp
from tnst_mi.compare.bench.renderers.sides import side_of
from tnst_mi.compare.bench.renderers.smoke_scene import SmokeScene, float64_images, smoke_renderer
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.io.pictures.exr import write_exr
from tnst_mi.resources import DATA, scene_file

__all__ = ["run"]

SHAPE = (6, 9, 7)
VIEWS = ("--views", "0,0", "25,-12")
FLAGS = (*VIEWS, "--gamma", "0.4")

#: Where "paper" is a fifth darker than the continuous image.
THICK = (*VIEWS, "--gamma", "2")


def density() -> np.ndarray:
    return (0.9 * np.abs(smooth_noise(np.random.default_rng(1), *SHAPE)) + 0.1).astype(np.float32)


@pytest.fixture
def smoke(tmp_path: Path) -> Path:
    save_frames(tmp_path / "cloud.npz", Frame(density(), name="cloud"))
    return tmp_path / "cloud.npz"


@pytest.fixture(autouse=True)
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few batches, and no figures, which take longer than the rest for so small a frame."""
    monkeypatch.setattr("tnst_mi.compare.bench.renderers.prepared_side.BATCHES", 8)
    monkeypatch.setattr("tnst_mi.compare.bench.bench_report.write_figure", lambda path, figure: _empty(path))


def _empty(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"")


def compared(run: Run, source: Path, out: Path, *flags: object) -> tuple[Ran, dict[str, Any]]:
    """Run the command and read the report."""
    ran = run("compare", source, "--out", out, *flags)
    assert (out / "report.json").is_file(), ran.errors
    return ran, json.loads((out / "report.json").read_text("utf-8"))


def test_two_path_tracers_agree_on_smoke_that_scatters(run: Run, smoke: Path, tmp_path: Path) -> None:
    flags = ("--albedo", 0.8, "--anisotropy", 0.3, "--light", "key", "--spp", 256, "--gradients", "albedo", "sensor")
    ran, report = compared(run, smoke, tmp_path / "out", "--left", "volpath", *FLAGS, *flags)
    assert ran.code == 0 and report["agree"], report["verdict"]
    assert ran.out.splitlines()[-1] == f"verdict   {report['verdict']}"
    assert re.search(
        r"^agree: volpath and prbvolpath .*; tested: 2 of 2 means, .* 126 pixels, 4 of 4 deriv", report["verdict"]
    )
    assert "volpath: does not differentiate" in report["not_tested"]
    assert report["arbiters"] == [], "there is no closed form"
    albedo, sensor = report["derivatives"]
    assert albedo["right"].keys() == {"central differences", "differentiation"}
    assert albedo["left"].keys() == sensor["left"].keys() == {"central differences"}
    assert albedo["left"]["central differences"]["value"] > 5 * albedo["left"]["central differences"]["half_width"]
    spp = [row["spp"] for row in report["convergence"]]
    assert spp == [64, 128, 256]
    for row in report["convergence"]:
        assert row["rms"] == pytest.approx(row["expected_rms"], rel=0.3), "noise alone"
    assert {"versions", "device", "seconds"} <= report.keys()
    assert len(list((tmp_path / "out" / "images").glob("*.exr"))) == 4
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert report["verdict"] in page and not re.search(r'(src|href)="(?!data:)', page)


def test_the_schema_describes_the_report(run: Run, smoke: Path, tmp_path: Path) -> None:
    """By the keys that the schema requires, which it closes against others; by jsonschema too, where there is one."""
    flags = ("--left", "float64", "--right", "emission_absorption", "--spp", 32, "--gradients", "extinction")
    _, report = compared(run, smoke, tmp_path / "out", *FLAGS, *flags)
    schema = json.loads((DATA / "compare.schema.json").read_text("utf-8"))
    assert set(schema["required"]) == report.keys() and not schema["additionalProperties"]
    for name in ("tests", "families", "convergence", "arbiters", "derivatives"):
        described = schema["properties"][name]["items"]
        for row in report[name]:
            assert set(described["required"]) == row.keys(), name
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed: its keys were compared alone")
    jsonschema.validate(report, schema)


@pytest.mark.parametrize("quadrature", ["exact", "paper"])
def test_ours_is_the_sum_in_float64(run: Run, smoke: Path, tmp_path: Path, quadrature: str) -> None:
    sides = ("--left", f"emission_absorption:{quadrature}", "--right", f"float64:{quadrature}", "--tolerance", 0.005)
    # Where smoke is cut at a wall of the grid, the step of 1/64 leaves 0.2% in a pixel.
    ran, report = compared(run, smoke, tmp_path / "out", *sides, *FLAGS)
    assert ran.code == 0, report["verdict"]
    distances = {row["arbiter"]: row["left"] for row in report["arbiters"]}
    other = "paper" if quadrature == "exact" else "exact"
    assert distances[f"float64:{quadrature}"] < 1e-3 and distances[f"float64:{other}"] > 0.02


def test_another_discretisation_disagrees_and_the_arbiter_says_which_is_which(
    run: Run, smoke: Path, tmp_path: Path
) -> None:
    flags = ("--left", "emission_absorption:paper", "--right", "prbvolpath", "--spp", 256, "--gradients", "extinction")
    ran, report = compared(run, smoke, tmp_path / "out", *THICK, *flags)
    assert ran.code == 1 and report["verdict"].startswith(
        "DISAGREE: emission_absorption:paper and prbvolpath differ in"
    )
    assert "clearest of the means: γ 2, view" in report["verdict"]
    exact, paper = report["arbiters"]
    assert paper["left"] < 1e-5 and exact["left"] > 0.05, "it is the sum that it should be"
    assert exact["right"] < 0.1 < paper["right"]
    assert any(test["alarm"] for test in report["tests"] if test["family"] == "derivatives")


def test_a_baseline_finds_what_has_changed_and_nothing_else(run: Run, smoke: Path, tmp_path: Path) -> None:
    flags = (*THICK, "--spp", 64, "--right", "volpath", "--gradients", "extinction")
    paper, exact = (("--left", f"emission_absorption:{name}") for name in ("paper", "exact"))
    assert compared(run, smoke, tmp_path / "a", *paper, *flags)[0].code == 1
    baseline = tmp_path / "a" / "report.json"
    ran, report = compared(run, smoke, tmp_path / "b", *paper, *flags, "--seed", 5, "--baseline", baseline)
    assert ran.code == 0 and report["baseline"]["outcome"] == "unchanged" and not report["agree"], (
        "they differ as they did"
    )
    assert ran.out.splitlines()[-1].startswith("baseline  unchanged: none of ")

    # As if paths had become brighter by a fifth: "right" is noisy, "left" is not.
    record = json.loads(baseline.read_text("utf-8"))
    for test in record["tests"]:
        test["right"] *= 1.2
    (tmp_path / "moved.json").write_text(json.dumps(record))
    ran, report = compared(run, smoke, tmp_path / "c", *paper, *flags, "--baseline", tmp_path / "moved.json")
    assert ran.code == 1 and re.search("^CHANGED: .*the clearest of the right: ", report["baseline"]["verdict"])

    again = ["compare", smoke, "--out", tmp_path / "d", *exact, *flags, "--baseline", baseline]
    ran = run(*again)
    message = r'report\.json: its left is "emission_absorption:paper", here it is "emission_absorption:exact"; compare'
    assert ran.code == 2 and re.search(message, ran.errors[-1]) and not list((tmp_path / "d").glob("*"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "cannot be read as JSON"),
        ("[" * 100_000, "cannot be read as JSON"),
        ("[]", "its format is None, expected 'tnst_mi.compare/1'"),
        ('{"format": "tnst_mi.compare/1"}', "tests is null, expected a list of tables"),
        ('{"format": "tnst_mi.compare/1", "tests": []}', "outcome is null, expected one of agree, disagree"),
        ('{"format": "tnst_mi.compare/1", "tests": [{"label": 3}]}', "test 0 lacks its label"),
        (
            '{"format": "tnst_mi.compare/1", "tests": [{"label": "a", "tested": true, "left": NaN}]}',
            "test 0 left is NaN, expected a finite number",
        ),
    ],
)
def test_damaged_baselines_are_refused(run: Run, smoke: Path, tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "baseline.json"
    file.write_text(text)
    refused(
        run, tmp_path, ["compare", smoke, "--out", tmp_path / "out", "--baseline", file], f"baseline.json: .*{message}"
    )


def pictures_of(folder: Path, image: np.ndarray, noise: float, count: int) -> Path:
    folder.mkdir()
    rng = np.random.default_rng(4)
    for number in range(count):
        for view, values in enumerate(image):
            write_exr(folder / f"{view}_{number:02d}.exr", values + noise * rng.normal(size=values.shape), {})
    return folder


def test_a_folder_of_pictures_stands_for_a_renderer(run: Run, smoke: Path, tmp_path: Path) -> None:
    image = float64_images(SmokeScene(density(), ((0.0, 0.0), (25.0, -12.0))), 0.4, "exact")[0][..., 0]
    flags = (*FLAGS, "--spp", 4096, "--left", "emission_absorption")
    good = pictures_of(tmp_path / "good", image, 0.05, 24)
    assert compared(run, smoke, tmp_path / "a", *flags, "--right", good)[0].code == 0
    bad = pictures_of(tmp_path / "bad", image + 0.05, 0.05, 24)
    ran, report = compared(run, smoke, tmp_path / "b", *flags, "--right", bad)
    assert ran.code == 1 and report["families"][0]["alarms"] == 2
    one = pictures_of(tmp_path / "one", image * 1.01, 0.0, 1)
    ran, report = compared(run, smoke, tmp_path / "c", *flags, "--right", one)
    assert ran.code == 1 and "without noise" in report["verdict"]
    (good / "1_00.exr").unlink()
    arguments = ["compare", smoke, "--out", tmp_path / "d", *flags, "--right"]
    refused(
        run, tmp_path, [*arguments, good], "good: 47 OpenEXR pictures, expected one or more of each view; with 2 views"
    )
    refused(
        run,
        tmp_path,
        [*arguments, pictures_of(tmp_path / "wide", np.zeros((2, 4, 5)), 0, 1)],
        "has 5×4 pixels, expected 7×9",
    )


def test_scene_files_are_rendered_with_their_own_integrator(run: Run, tmp_path: Path) -> None:
    scene = scene_file("known/point_light.xml")
    text = scene.read_text("utf-8")
    ran, report = compared(run, scene, tmp_path / "a", "--left", "volpathmis", "--right", scene, "--spp", 1024)
    assert ran.code == 0 and report["subject"]["input"] == "point_light.xml"
    deeper = tmp_path / "deeper.xml"
    deeper.write_text(text.replace('"max_depth" value="2"', '"max_depth" value="1"'))
    ran, report = compared(run, scene, tmp_path / "b", "--left", "volpath", "--right", deeper, "--spp", 1024)
    assert ran.code == 1, "nothing is scattered"


def test_what_is_refused(run: Run, smoke: Path, tmp_path: Path) -> None:
    def refuse(message: str, *arguments: object) -> None:
        refused(run, tmp_path, ["compare", *arguments, "--out", tmp_path / "out"], message)

    slab = scene_file("known/slab.xml")
    refuse("--left pbrt: expected emission_absorption.*volpath, .*a Mitsuba scene file", smoke, "--left", "pbrt")
    refuse(
        "--right float64:sharp: expected float64:QUADRATURE with one of exact, paper", smoke, "--right", "float64:sharp"
    )
    refuse("--left no.xml: no such file", smoke, "--left", "no.xml")
    refuse("--albedo 2: expected a number", smoke, "--left", "volpath", "--albedo", 2)
    refuse("emission_absorption:exact with --albedo 0.5: it does not scatter", smoke, "--albedo", 0.5)
    refuse("--anisotropy 0.5: is of smoke that scatters, expected --albedo above 0", smoke, "--anisotropy", 0.5)
    refuse("--gradients colour: expected some of extinction, albedo", smoke, "--gradients", "colour")
    refuse("--directions: is of comparisons without --left and --right", smoke, "--left", "volpath", "--directions", 4)
    refuse("answer: is known of scenes such as scenes/known/slab.xml", smoke, "--right", "answer")
    refuse("slab.xml: is a Mitsuba scene, expected --left and --right", slab)
    refuse("--gamma: is of a density, and .*slab.xml is a scene", slab, "--left", "volpath", "--gamma", 1)
    refuse(
        "furnace.xml|a medium of the scene scatters", scene_file("known/furnace.xml"), "--left", "emission_absorption"
    )
    (tmp_path / "bad.xml").write_text("<scene version='3.0.0'><integrator type='nothing'/></scene>")
    refuse("bad.xml: cannot be read as a Mitsuba scene", tmp_path / "bad.xml", "--left", "volpath")
    (tmp_path / "blind.xml").write_text("<scene version='3.0.0'/>")
    refuse("blind.xml: the scene has no sensor", tmp_path / "blind.xml", "--left", "volpath")


def test_derivatives_by_both_ways_are_one_and_leave_the_scene_as_it_was() -> None:
    """Ours has no noise: what differs is the error of the step, of its fourth order."""
    z, y, x = np.meshgrid(*(np.linspace(-3, 3, n) for n in (12, 14, 10)), indexing="ij")
    smoke = SmokeScene(np.exp(-(x**2) - y**2 - z**2).astype(np.float32), ((25.0, -12.0),))
    renderer = smoke_renderer(smoke, 0.4, side_of("left", "emission_absorption"), 1e-3)
    parameters = SceneParameters(renderer.scene)
    before = renderer.images(1, 1, (0,), lambda paths: None).values
    taken = [
        way(parameters, "extinction", 1, 1, (0,), lambda paths: None)
        for way in (renderer.derivatives, renderer.differences)
    ]
    assert float(taken[0].mean) == pytest.approx(float(taken[1].mean), rel=3e-5)
    # A tenth of the step of the sensor, by images alone.
    with parameters.displaced("sensor", 0.01):
        moved = renderer.images(1, 1, (0,), lambda paths: None).values
    assert np.abs(moved - before).max() > 1e-4
    assert float((ramp(renderer.shape) * (moved - before)[0]).sum()) / 0.01 == pytest.approx(
        float(renderer.differences(parameters, "sensor", 1, 1, (0,), lambda paths: None).mean), rel=0.2
    )
    np.testing.assert_array_equal(renderer.images(1, 1, (0,), lambda paths: None).values, before)
    assert [name for name in PARAMETERS if parameters.missing(name)] == ["albedo", "anisotropy"]


def test_rays_go_through_the_centres_of_pixels_where_path_tracers_are_compared_with_ours() -> None:
    """Each path passes or is absorbed; without smoke's noise two seeds differ, and their mean is the closed form."""
    smoke = SmokeScene(density(), ((25.0, -12.0),))
    film = {"type": "hdrfilm", "width": 4, "height": 3, "rfilter": {"type": "box"}}
    sensor = mi.load_dict({"type": "camera_views", "film": film, "through_centres": True})
    free = mi.load_dict({"type": "camera_views", "film": film})
    position = mi.Point2f([0.3, 0.99], [0.01, 0.5])
    centre = mi.Point2f([0.375, 0.875], [1 / 6, 0.5])
    rays = [
        camera.sample_ray(0.0, 0.0, where, mi.Point2f(0.5))[0].o.numpy()
        for camera, where in ((sensor, position), (free, centre))
    ]
    np.testing.assert_allclose(*rays, atol=1e-6)
    found = smoke_renderer(smoke, 0.4, side_of("left", "volpath"), 1e-3).images(2048, 32, (3,), lambda paths: None)
    closed = float64_images(smoke, 0.4, "exact")[0]
    scores = (found.mean - closed) / found.standard_error
    assert abs(scores.mean()) < 3 / np.sqrt(scores.size) and 0.7 < scores.std() < 1.3

"""What a comparison concludes: that two agree only where something was tested, and what a baseline must notice."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from command_line import Ran, Run, refused, run

from tnst_mi.compare.bench.baseline import Baseline, held_against, pixel_columns
from tnst_mi.compare.bench.renderers.parameters import SceneParameters
from tnst_mi.compare.bench.renderers.sides import spelled_out
from tnst_mi.compare.bench.statistics.batches import Batches, difference, missed
from tnst_mi.compare.bench.statistics.decision import FALSE_ALARMS, Family, alarms, detectable, family
from tnst_mi.compare.bench.statistics.hypotheses import value_families
from tnst_mi.machine.backend import activate
from tnst_mi.resources import scene_file

__all__ = ["run"]

LIGHT = (0.0, np.inf)


@pytest.fixture(autouse=True)
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """No figures."""

    def empty(path: Path, figure: object) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")

    monkeypatch.setattr("tnst_mi.compare.bench.bench_report.write_figure", empty)


def compared(run: Run, source: Path, out: Path, *flags: object) -> tuple[Ran, dict[str, Any]]:
    """Run the command and read the report."""
    ran = run("compare", source, "--out", out, *flags)
    assert (out / "report.json").is_file(), ran.errors
    return ran, json.loads((out / "report.json").read_text("utf-8"))


# --------------------------------------------------------------------
# Sides whose batches are all the same
# --------------------------------------------------------------------


def test_what_paths_cannot_have_missed_is_found() -> None:
    """256 paths in 32 batches that all pass, of light between 0 and 1: Clopper and Pearson's bound, from either end."""
    passed = Batches(np.ones((32, 1)), True, 8, (0.0, 1.0))
    for mean in (0.99, 0.9, 0.5):
        assert missed(passed, Batches(np.array([[mean]])), np.zeros(1)) == pytest.approx(mean**256, rel=1e-9)
    black = Batches(np.zeros((32, 1)), True, 8, (0.0, 1.0))
    assert missed(Batches(np.array([[0.1]])), black, np.zeros(1)) == pytest.approx(0.9**256, rel=1e-9)
    assert missed(Batches(np.array([[0.1]])), black, np.array(0.2)) == 1, "allowed"


def test_rounding_beyond_an_end_is_no_light() -> None:
    """Where all paths come through, float32 leaves opacities a hair below 0 or above."""
    opacity = np.random.default_rng(2).choice([-4e-7, 0.0, 2e-7, 1e-6], (32, 6))
    opacity[:, 5], opacity[0, :5] = 0.3, [-4e-7, -4e-7, 1e-6, 1e-6, 0.0]
    exact, allowance = Batches(np.array([[6e-4, 0.0, 6e-4, 0.0, 0.0, 0.3]])), np.array([1e-3, 0.0, 1e-3, 0.0, 0.0, 0.0])
    tail = missed(exact, Batches(opacity, paths=8, ends=(0.0, 1.0)), allowance)
    np.testing.assert_allclose(tail, 1.0, atol=1e-12)


def test_light_may_be_missed_but_not_found_where_there_is_none() -> None:
    """Without an upper end, paths that count for any amount may have been missed. Between the ends, Markov's bound."""
    answer = Batches(np.full((1, 2), 0.5))
    same = Batches(np.broadcast_to([0.0, 1.0], (32, 2)), True, 8, LIGHT)
    np.testing.assert_allclose(missed(same, answer, np.zeros(2)), [1.0, 0.5**32])
    tests = family("means", ["black", "bright"], same, answer, np.zeros(2))
    np.testing.assert_array_equal(tests.tested, [False, True])
    np.testing.assert_array_equal(alarms([tests])[0], [False, True])


def test_an_integrator_that_ignores_the_medium_does_not_agree_with_the_answer(run: Run, tmp_path: Path) -> None:
    """Every path of it finds the sky behind: without scatter, and wrong."""
    scene = tmp_path / "slab.xml"
    scene.write_text(scene_file("known/slab.xml").read_text("utf-8").replace('value="volpath"', 'value="path"'))
    (tmp_path / "answers.toml").write_text("[slab]\nradiance = 0.36787944")
    flags = ("--left", f"{scene}@scalar_rgb", "--right", "answer", "--spp", 256)
    ran, report = compared(run, scene, tmp_path / "out", *flags)
    assert ran.code == 1 and report["outcome"] != "agree", report["verdict"]


def test_where_no_mean_can_be_tested_two_do_not_agree(run: Run, tmp_path: Path) -> None:
    """32 paths through haze that hardly any path is absorbed by."""
    scene = tmp_path / "slab.xml"
    thin = (
        scene_file("known/slab.xml")
        .read_text("utf-8")
        .replace('name="sigma_t" value="1"', 'name="sigma_t" value="1e-6"')
    )
    scene.write_text(thin)
    (tmp_path / "answers.toml").write_text("[slab]\nradiance = 0.999999")
    ran, report = compared(
        run, scene, tmp_path / "out", "--left", "volpath@scalar_rgb", "--right", "answer", "--spp", 32
    )
    assert ran.code == 1 and report["outcome"] == "inconclusive" and not report["agree"]
    assert report["verdict"].startswith(
        "INCONCLUSIVE: volpath@scalar_rgb and answer: nothing could be tested of the images"
    )


def test_a_derivative_that_was_asked_for_and_is_not_there_is_not_agreed_on(run: Run, tmp_path: Path) -> None:
    flags = ("--left", "volpath@scalar_rgb", "--right", "answer", "--spp", 256, "--gradients", "anisotropy")
    ran, report = compared(run, scene_file("known/slab.xml"), tmp_path / "out", *flags)
    assert ran.code == 1 and report["outcome"] == "inconclusive"
    assert "nothing could be tested of the derivative with respect to anisotropy" in report["verdict"]


# --------------------------------------------------------------------
# How precisely
# --------------------------------------------------------------------


def test_differences_that_are_said_to_be_found_are_found_nine_times_in_ten() -> None:
    rng = np.random.default_rng(3)
    count = 1000
    left, right = rng.normal(1.0, 0.1, (32, count)), rng.normal(1.0, 0.1, (32, count))

    def tests(shift: np.ndarray | float) -> Family:
        return family("means", [""] * count, Batches(left), Batches(right + shift), np.array(0.0))

    # Each for itself, not as one of many.
    (least,) = detectable([tests(0.0)], FALSE_ALARMS * count)
    assert 0.85 * count < (tests(float(np.median(least))).tail <= FALSE_ALARMS).sum() < 0.95 * count
    assert (tests(float(np.median(least)) / 2).tail <= FALSE_ALARMS).sum() < 0.2 * count


def test_a_side_with_little_light_found_is_not_taken_for_certain() -> None:
    """Exponential light on a tenth of the paths: the batches with little of it scatter little too."""
    found = Batches(np.array([[0.1], [0.2], [0.1], [0.2]]), True, 8, LIGHT)
    answer = Batches(np.array([[0.6]]))
    assert difference(found, answer).standard_error == pytest.approx(4 * found.standard_error)
    assert difference(found, Batches(np.array([[0.1]]))).standard_error == found.standard_error


# --------------------------------------------------------------------
# Baselines
# --------------------------------------------------------------------

SHAPE = (32, 1, 12, 10, 1)


def families_of(left: np.ndarray, right: np.ndarray) -> list[Family]:
    return value_families("", Batches(left), Batches(right), 1e-3)


def baseline_of(families: list[Family], outcome: str) -> Baseline:
    tests = [
        {"label": label} | {name: column[i] for name, column in pixel_columns(each).items()}
        for each in families
        if each.name != "pixels"
        for i, label in enumerate(each.labels)
    ]
    pixels = next(each for each in families if each.name == "pixels")
    return Baseline(Path("report.json"), {"tests": tests, "outcome": outcome}, pixel_columns(pixels))


def test_a_side_that_turns_black_is_a_change() -> None:
    rng = np.random.default_rng(4)
    left, right = (rng.normal(1.0, 0.1, SHAPE) for _ in "lr")
    baseline = baseline_of(families_of(left, right), "agree")
    assert held_against(baseline, families_of(left, right))["outcome"] == "unchanged"
    assert held_against(baseline, families_of(left, np.zeros(SHAPE)))["outcome"] == "changed"
    # Where both are, nothing can be tested, which could be before.
    both = held_against(baseline, families_of(np.zeros(SHAPE), np.zeros(SHAPE)))
    assert both["outcome"] == "inconclusive" and "cannot be tested now: view 0 and " in both["verdict"]


def test_rows_that_move_against_each_other_are_a_change_though_no_tile_moves() -> None:
    """Also where the pixels of the two disagreed before."""
    rng = np.random.default_rng(5)
    left, right = (rng.normal(1.0, 0.02, SHAPE) for _ in "lr")
    rows = 0.3 * (-1.0) ** np.arange(SHAPE[2])[:, None, None]
    right[..., 0, 0, 0] += 1.0
    # Twelve rows make four tiles of three: of each, an even number would be needed.
    rows[2::3] = 0
    baseline = baseline_of(families_of(left, right), "disagree")
    again = rng.normal(0.0, 0.02, SHAPE) + right.mean(0)
    assert held_against(baseline, families_of(left, again))["outcome"] == "unchanged"
    found = held_against(baseline, families_of(left, again + rows))
    assert found["outcome"] == "changed" and "pixels of the right: view 0, row " in found["verdict"]
    without = Baseline(baseline.path, baseline.record, None)
    found = held_against(without, families_of(left, again))
    assert found["verdict"].endswith("; without pixels, since no pixels.npz is beside the baseline")


def test_two_that_agreed_and_cease_to_are_a_change() -> None:
    rng = np.random.default_rng(6)
    left, right = (rng.normal(1.0, 0.1, SHAPE) for _ in "lr")
    baseline = Baseline(*vars(baseline_of(families_of(left, right), "agree")).values())
    # Neither has moved by more than the noise of the earlier run, which had few paths; together they have.
    wide = Baseline(baseline.path, json.loads(json.dumps(baseline.record, default=float)), None)
    for test in wide.record["tests"]:
        test["left_error"], test["right_error"] = 1.0, 1.0
    found = held_against(wide, families_of(left, right + 0.05))
    assert found == {"outcome": "changed", "verdict": "CHANGED: the sides agreed, and disagree in means, tiles"}


def test_baselines_of_other_settings_are_refused(run: Run, tmp_path: Path) -> None:
    slab = scene_file("known/slab.xml")
    flags = ("--left", "volpath@scalar_rgb", "--right", "answer", "--spp", 256)
    compared(run, slab, tmp_path / "a", *flags)
    baseline = tmp_path / "a" / "report.json"
    again = ["compare", slab, "--out", tmp_path / "b", *flags, "--baseline", baseline]
    assert run(*again).code == 0
    refused(run, tmp_path, [*again, "--tolerance", 1, "--overwrite"], "its tolerance is 0.001, here it is 1.0; compare")
    refused(
        run, tmp_path, [*again, "--gradients", "extinction", "--overwrite"], r'gradients is \[\], here it is \["ext'
    )
    (tmp_path / "a" / "pixels.npz").write_bytes(b"other")
    refused(run, tmp_path, [*again, "--overwrite"], r"pixels\.npz: is not the file that the report beside it")


def test_a_quadrature_that_is_not_named_is_the_exact_one() -> None:
    assert spelled_out("emission_absorption") == spelled_out("emission_absorption:exact")
    assert spelled_out("float64@mono") == "float64:exact@mono"
    assert spelled_out("emission_absorption:paper") != spelled_out("emission_absorption")
    assert spelled_out("volpath") == "volpath"


# --------------------------------------------------------------------
# The sensor that moves
# --------------------------------------------------------------------

GROUND = '<shape type="rectangle"><transform name="to_world"><scale x="100" y="100"/></transform></shape>'


def test_the_sensor_moves_and_nothing_else_by_a_step_of_the_media(tmp_path: Path) -> None:
    """Whatever else has a place in the scene, and before the sensor in it."""
    activate()
    text = scene_file("known/slab.xml").read_text("utf-8")
    before, after = text.split("<sensor", 1)
    steps = []
    for name, first in (("bare", ""), ("ground", GROUND)):
        path = tmp_path / f"{name}.xml"
        path.write_text(f"{before}{first}<sensor{after}")
        scene = mi.load_file(str(path))
        parameters = SceneParameters(scene)
        places = [str(mi.traverse(shape)["to_world"]) for shape in scene.shapes() if "to_world" in mi.traverse(shape)]
        with parameters.displaced("sensor", 0.5):
            moved = mi.traverse(scene.sensors()[0])["to_world"].translation().numpy().ravel()
            np.testing.assert_allclose(moved, [0.5, 0, 3], atol=1e-6)
            now = [str(mi.traverse(shape)["to_world"]) for shape in scene.shapes() if "to_world" in mi.traverse(shape)]
            assert now == places
        back = mi.traverse(scene.sensors()[0])["to_world"].translation().numpy().ravel()
        np.testing.assert_array_equal(back, [0, 0, 3])
        steps.append(parameters.step("sensor"))
    assert steps == pytest.approx([0.005 * 3.0] * 2), "of the slab's diagonal: 2, 2 and 1"

"""Stylizations in regions: what lies outside keeps its bits, targets are what they are alone, masks fade and follow."""

from __future__ import annotations

import dataclasses
import itertools
import json
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from fields import blob
from moving_smoke import moving_smoke
from networks import random_googlenet
from PIL import Image

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.machine.backend import torch_device
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.gradient import problem_of
from tnst_mi.optimisation.parameterisation import Fields
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.optimisation.result import Progress
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.regions.regions import regions_of
from tnst_mi.run.announcement import announcement
from tnst_mi.run.api import Result
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare
from tnst_mi.run.progress import ProgressBar
from tnst_mi.run.record import run_identity

SHAPE = (16, 22, 18)
SPHERE = {"shape": "sphere", "centre": [6.5, 10.5, 7.5], "radius": 6.0, "edge": 2.0}
GOAL = {"semantic": ["inception_3a/3x3:2"]}


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A narrow GoogLeNet with random weights."""
    return str(random_googlenet(tmp_path_factory.mktemp("weights") / "random.safetensors", narrow=8))


def stylized(frames: Any, weights: str, out: Path | None = None, **keys: Any) -> Result:
    few = {"octaves": 2, "iterations": 2, "views": 2, "eta": 0.03, "gamma": 0.3, "weights": weights}
    goal = {} if "target" in keys else GOAL
    return tnst_mi.stylize(frames, few | goal | keys, out, progress=False)


def grown(mask: np.ndarray) -> np.ndarray:
    """The cells of a mask and those beside them along an axis."""
    cells = np.pad(mask, 1)
    beside = [np.roll(cells, by, axis) for axis in range(3) for by in (-1, 1)]
    return np.any([cells, *beside], axis=0)[1:-1, 1:-1, 1:-1]


def distance_from(centre: list[float]) -> np.ndarray:
    z, y, x = np.indices(SHAPE)
    return np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2)


# --- Outside --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "keys",
    [
        {"transport": "step"},
        {"transport": "flow"},
        {"transport": "step", "window": 3, "lam": 0.5, "coherence": 1.0},
        {"transport": "flow", "window": 3},
        {"window": 3, "window_average": "plain"},
        {"window": 3, "window_average": "plain", "step_order": "align_first"},
        {"parameterisation": "density", "eta": 0.1},
        {"steps": "auto", "sigma": "loss"},
        {"motif_size": 1.4},
        {"motif_size": 2.0, "transport": "step", "steps": "auto"},
        {"motif_size": 1.4, "window": 3, "coherence": 1.0},
        {"motif_size": 1.4, "window": 3, "window_average": "plain", "step_order": "align_first"},
        {"motif_size": 1.4, "parameterisation": "density", "eta": 0.1},
        {"motif_size": "cells"},
        {"motif_size": 0.6, "window": 3, "window_average": "plain"},
        {"reach": 1.0, "keep_silhouette": 0.5, "window": 3},
    ],
    ids=str,
)
def test_two_cells_outside_a_mask_nothing_changes(keys: dict[str, Any], weights: str) -> None:
    """Bit for bit, with a blend whose sums would round; from the third octave on."""
    frames = moving_smoke(3 if "window" in keys else 1, SHAPE)
    result = stylized(frames, weights, mask=SPHERE, octaves=3, blend=0.7, **keys)
    inside = grown(distance_from(SPHERE["centre"]) < SPHERE["radius"])
    for frame, density, velocity in zip(frames, result.densities, result.velocities, strict=True):
        assert density[~inside].tobytes() == frame.density[~inside].tobytes()
        assert (velocity[~inside] == 0).all()
        assert np.abs(density - frame.density)[inside].max() > 0.01
        assert frame.density[~inside].max() > 0.1, "there is smoke outside"


@pytest.mark.parametrize("motif_size", [2.0, 1.4, "cells", 0.6])
def test_with_conservative_transport_it_is_three_cells(motif_size: float | str, weights: str) -> None:
    (frame,) = moving_smoke(1, SHAPE)
    keys = {"conservative": True, "transport": "flow", "motif_size": motif_size, "blend": 0.7}
    result = stylized(frame, weights, mask=SPHERE, octaves=3, **keys)
    inside = grown(distance_from(SPHERE["centre"]) < SPHERE["radius"])
    density, changed = result.densities[0], grown(inside)
    assert density[~changed].tobytes() == frame.density[~changed].tobytes()
    assert (result.velocities[0][~inside] == 0).all()
    assert np.abs(density - frame.density)[inside].max() > 0.01


def lumpy_column(rows: int) -> Frame:
    """The same smoke on any grid, a quarter as wide as it is high."""
    shape = (rows // 4, rows, rows // 4)
    z, y, x = ((i - (n - 1) / 2) / rows for i, n in zip(np.indices(shape), shape, strict=True))
    lumps = 1 + 0.5 * np.sin(61 * x + 1) * np.sin(53 * y) * np.sin(67 * z + 2) + 0.3 * np.sin(97 * y + 40 * x)
    radius = np.sqrt(x**2 + (y / 3.2) ** 2 + z**2)
    return Frame((0.8 * np.clip((0.115 - radius) / 0.03, 0, 1) * lumps).astype(np.float32))


@pytest.mark.parametrize("edge", [0.0, 0.02])
def test_a_recipe_with_a_small_region_means_the_same_at_every_size(edge: float, weights: str) -> None:
    """From the same 96 rows of images: as much of the smoke in it changes, and as far, and no faster at its border."""
    shares, fastest = [], []
    for rows in (96, 128, 200):
        frame = lumpy_column(rows)
        centre = [(n - 1) / 2 for n in reversed(frame.density.shape)]
        mask = {"shape": "sphere", "centre": centre, "radius": 0.05 * rows, "edge": edge * rows}
        result = stylized(frame, weights, mask=mask, eta=0.01)
        z, y, x = np.indices(frame.density.shape)
        distance = np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2) / rows
        speed = np.linalg.norm(result.velocities[0], axis=-1) / rows
        change = np.abs(result.densities[0] - frame.density)
        shares.append(change.sum() / frame.density[distance < 0.05].sum())
        fastest.append(speed.max())
        # The outer two cells of the octave, and what lies beyond.
        assert speed[distance > 0.03].max() < 1.5 * speed[distance < 0.03].max()
        assert change[distance > 0.05 + 2 / rows].max() == 0
    assert min(shares) > 0.01
    np.testing.assert_allclose(shares, shares[0], rtol=0.3)
    np.testing.assert_allclose(fastest, fastest[0], rtol=0.4)


@pytest.mark.parametrize("radius", [3, 7])
def test_regions_of_a_few_cells_of_a_fine_grid_change(radius: int, weights: str) -> None:
    """Hard spheres at 200 rows, of which an octave sees 96."""
    frame = lumpy_column(200)
    mask = {"shape": "sphere", "centre": [24.5, 99.5, 24.5], "radius": radius}
    result = stylized(frame, weights, mask=mask, octaves=1, iterations=1)
    change = np.abs(result.densities[0] - frame.density)
    assert change.max() > 0.01 and (change > 0.001).sum() > 4 * radius**3 / 3
    assert result.run["frames"][0]["note"] is None


def test_without_regions_a_blend_rounds_as_before(weights: str) -> None:
    """A mask of 1 everywhere is a region too; none at all leaves every step of the computation as it was."""
    (frame,) = moving_smoke(1, SHAPE)
    none = stylized(frame, weights)
    assert "targets" not in none.run
    everywhere = stylized(frame, weights, target=[GOAL])
    assert everywhere.densities[0].tobytes() == none.densities[0].tobytes()
    assert everywhere.run["targets"] == [
        {"goals": GOAL, "mask": [], "weight": 1.0, "smoke_shares": [1.0], "mask_sha256": [None]},
    ]


# --- Several targets ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "keys", [{}, {"lam": 1.0}, {"transport": "flow", "lam": 0.5}, {"parameterisation": "density"}], ids=str
)
def test_the_gradients_of_targets_are_those_of_each_alone(keys: dict[str, Any], weights: str) -> None:
    """To the bit: the images are rendered once, and their graph is differentiated once for each."""
    (frame,), network = moving_smoke(1, SHAPE), GoogLeNet.load(weights).to(torch_device())
    goals = [{"semantic": "inception_3a/3x3:2", "mask": SPHERE}, {"tag": "volcano"}, {"style": "net", "mask": SPHERE}]
    rng = np.random.default_rng(0)

    def gradients(targets: list[dict[str, Any]]) -> list[Fields]:
        recipe = Recipe.from_dict({"target": targets, "views": 2, "gamma": 0.3, **keys})
        regions = regions_of(recipe, [frame], [5])
        plan = plan_of(recipe, ["f"], [5], [1.0], [0.2], SHAPE, regions=regions)
        problem = problem_of(plan, plan.full, network)
        (of_frame,) = plan.frames
        channels = of_frame.parameterisation.channels
        fields = Fields({name: mi.TensorXf(values[name]) for name in channels})
        masks = [None if m is None else mi.TensorXf(m) for m in regions.masks(0, frame)]
        return list(problem.gradient(of_frame, fields, mi.TensorXf(frame.density), (1,), masks).gradients)

    values = {
        "phi": rng.standard_normal(SHAPE).astype(np.float32),
        "psi": rng.standard_normal((*SHAPE, 3)).astype(np.float32),
        "offset": 0.1 * rng.standard_normal(SHAPE).astype(np.float32),
    }
    together = gradients(goals)
    for goal, found in zip(goals, together, strict=True):
        (alone,) = gradients([goal])
        for name in found:
            assert found[name].numpy().tobytes() == alone[name].numpy().tobytes()
            assert (alone[name].numpy() != 0).any()


def halves() -> tuple[Frame, list[dict[str, Any]]]:
    """Two clouds, and a box around each."""
    shape = (14, 18, 40)
    clouds = np.maximum(blob(shape, (9, 9, 7), 3.5), blob(shape, (30, 9, 7), 3.5))
    lumps = 1 + 0.4 * np.sin(np.indices(shape).sum(0) * 1.3)
    boxes = [{"shape": "box", "low": [x, 0, 0], "high": [x + 16, 17, 13], "edge": 3} for x in (1, 22)]
    return Frame((0.7 * clouds * lumps).astype(np.float32)), boxes


def test_disjoint_targets_come_as_far_as_each_alone(weights: str) -> None:
    """Of a layer whose positions see 13 pixels: those of deeper ones see into the other region, 5 cells away."""
    frame, boxes = halves()
    goals = [{"semantic": ["conv2/3x3:2"]}, {"semantic": ["conv2/3x3:5"]}]
    targets = [goal | {"mask": box} for goal, box in zip(goals, boxes, strict=True)]
    both = stylized(frame, weights, target=targets, iterations=4)
    (record,) = both.run["frames"]
    for number, (goal, box) in enumerate(zip(goals, boxes, strict=True), start=1):
        alone = stylized(frame, weights, mask=box, iterations=4, **goal)
        (own,) = alone.run["frames"]
        (name,) = own["terms_before"]
        before, after = own["terms_before"][name], own["terms_after"][name]
        assert record["terms_before"][f"target {number}: {name}"] == pytest.approx(before, rel=1e-5)
        assert after < before
        assert record["terms_after"][f"target {number}: {name}"] == pytest.approx(after, rel=0.05)


def test_the_weight_of_a_target_scales_its_steps(weights: str) -> None:
    """One iteration, so that the potentials are the step; a weight of 0 leaves its region alone."""
    frame, boxes = halves()
    goals = [GOAL | {"mask": boxes[0]}, {"tag": ["volcano"], "mask": boxes[1], "weight": 0.5}]
    one = {"octaves": 1, "iterations": 1, "eta": 0.002}
    half = stylized(frame, weights, target=goals, **one)
    goals[1]["weight"] = 1.0
    whole = stylized(frame, weights, target=goals, **one)
    goals[1]["weight"] = 0.0
    none = stylized(frame, weights, target=goals, **one)
    v, right = whole.velocities[0], np.arange(40) > 20
    np.testing.assert_allclose(half.velocities[0][:, :, right], v[:, :, right] / 2, atol=1e-6)
    assert half.velocities[0][:, :, ~right].tobytes() == v[:, :, ~right].tobytes()
    assert np.abs(v[:, :, right]).max() > 1e-3
    assert none.densities[0][:, :, right].tobytes() == frame.density[:, :, right].tobytes()


def test_overlapping_targets_add_their_steps(weights: str) -> None:
    """One iteration: the steps of both, each as if alone, everywhere."""
    (frame,) = moving_smoke(1, SHAPE)
    ramp = {"height": [6, 14]}
    targets = [GOAL | {"mask": ramp}, {"tag": ["volcano"], "mask": ramp | {"invert": True}}]
    one = {"octaves": 1, "iterations": 1, "eta": 0.002}
    both = stylized(frame, weights, target=targets, **one)
    parts = [stylized(frame, weights, target=[target], **one).velocities[0] for target in targets]
    largest = np.abs(both.velocities[0]).max()
    np.testing.assert_allclose(both.velocities[0], parts[0] + parts[1], atol=2e-3 * largest)


# --- Masks over time ------------------------------------------------------------------------------------


@pytest.mark.parametrize("window", [1, 3])
def test_a_target_fades_in_over_six_frames(window: int, weights: str) -> None:
    frames = moving_smoke(7, SHAPE)
    mask = SPHERE | {"strength": {6: 0.0, 11: 1.0}}
    result = stylized(frames, weights, mask=mask, window=window, octaves=1)
    changes = [np.linalg.norm(d - f.density) for f, d in zip(frames, result.densities, strict=True)]
    assert changes[0] == changes[1] == 0
    assert result.densities[1].tobytes() == frames[1].density.tobytes()
    assert all(0 < earlier < later for earlier, later in itertools.pairwise(changes[2:]))
    assert result.run["frames"][0]["note"] == "s_005: left unchanged, since it has no smoke in a mask"
    assert result.run["targets"][0]["smoke_shares"][0] == 0.0


def test_changes_follow_the_smoke_with_their_mask(weights: str) -> None:
    """A cloud that travels one cell per frame: what is changed in it stays in its part of it."""
    wind = np.zeros((*SHAPE, 3), np.float32)
    wind[..., 0] = 1
    cloud = blob(SHAPE, (6, 10, 7), 3.0)
    frames = [Frame(np.roll(cloud, i, axis=2), wind, name=f"c_{i}", number=i) for i in range(4)]
    mask = {"shape": "box", "low": [4, 8, 4], "high": [7, 13, 11], "follow": True}
    for densities, window in ((stylized(frames, weights, mask=mask, window=w).densities, w) for w in (1, 3)):
        for i, (frame, density) in enumerate(zip(frames, densities, strict=True)):
            inside = np.zeros(SHAPE, bool)
            inside[4:12, 8:14, 4 + i : 8 + i] = True
            outside = ~grown(inside)
            assert density[outside].tobytes() == frame.density[outside].tobytes(), (window, i)
            assert np.abs(density - frame.density).max() > 0.01, (window, i)


def test_a_painted_half_of_a_view_changes_only_that_half(tmp_path: Path, weights: str) -> None:
    """Painted over the picture of an earlier run, seen from the same view."""
    (frame,) = moving_smoke(1, SHAPE)
    view = {"azimuth": [30, 30], "elevation": [0, 0]}
    stylized(frame, weights, tmp_path / "first", octaves=1, iterations=1, **view)
    picture = np.asarray(Image.open(tmp_path / "first" / "images" / f"{frame.name}_before.png").convert("L"))
    painting = np.full_like(picture, 255)
    painting[:, picture.shape[1] // 2 :] = 0
    Image.fromarray(painting).save(tmp_path / "half.png")
    mask = {"image": str(tmp_path / "half.png"), "view": [30, 0]}
    after = stylized(frame, weights, mask=mask, **view).densities[0]
    images = [tnst_mi.render(d, view=(30, 0), gamma=0.3) for d in (frame.density, after)]
    change = np.abs(images[1] - images[0])
    half = picture.shape[1] // 2
    assert change[:, : half - 2].max() > 0.05 * images[0].max()
    # A cell is up to 1.4 pixels wide in this view, changes reach a cell beyond, and images interpolate by one more.
    assert change[:, half + 3 :].max() == 0


# --- Runs -----------------------------------------------------------------------------------------------


def targets() -> list[dict[str, Any]]:
    return [
        GOAL | {"mask": SPHERE | {"follow": True, "strength": {5: 0.5, 8: 1.0}}, "weight": {5: 1.0, 8: 0.5}},
        {"tag": ["volcano"], "mask": {"height": [8, 12]}},
    ]


@pytest.mark.parametrize("window", [1, 3])
def test_a_run_is_reproduced_and_resumed(
    window: int, weights: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the recipe.toml that it wrote, and after stops in both octaves and between results, with the same bits."""
    frames = moving_smoke(4, SHAPE)
    first = stylized(frames, weights, tmp_path / "first", target=targets(), window=window)
    recipe = Recipe.from_toml(tmp_path / "first" / "recipe.toml")
    again = tnst_mi.stylize(frames, tmp_path / "first" / "recipe.toml", progress=False)
    for last in (3, 11):
        calls = itertools.count()

        def stop(bar: ProgressBar, progress: Progress, calls: Any = calls, last: int = last) -> None:
            if next(calls) == last:
                raise KeyboardInterrupt

        monkeypatch.setattr(ProgressBar, "advance", stop)
        stopped = Run(prepare(frames, recipe, tmp_path / "stopped", resume=True), progress=False)
        assert len(list(stopped)) < 4 and stopped.record["status"] == "interrupted"
    monkeypatch.undo()
    closed = Run(prepare(frames, recipe, tmp_path / "stopped", resume=True), progress=False)
    next(closed)
    closed._frames.close()
    for _ in Run(prepare(frames, recipe, tmp_path / "stopped", resume=True), progress=False):
        pass
    for frame, density, other in zip(frames, first.densities, again.densities, strict=True):
        assert density.tobytes() == other.tobytes()
        with np.load(tmp_path / "stopped" / "density" / f"{frame.name}.npz") as file:
            assert file["density"].tobytes() == density.tobytes()
    record = json.loads((tmp_path / "first" / "run.json").read_text())
    assert [target["goals"] for target in record["targets"]] == [GOAL, {"tag": ["volcano"]}]
    assert record["targets"][0]["weight"] == {"5": 1.0, "8": 0.5}
    assert all(len(target["smoke_shares"]) == 4 for target in record["targets"])
    changed = dataclasses.replace(recipe, target=recipe.target[:1])
    with pytest.raises(InputError, match=r"its run had target = .*; resume with the same recipe"):
        prepare(frames, changed, tmp_path / "stopped", resume=True)


def test_a_changed_mask_file_does_not_resume_a_run(weights: str, tmp_path: Path) -> None:
    frames, file = moving_smoke(2, SHAPE), tmp_path / "mask.npz"
    np.savez(file, density=np.ones(SHAPE, np.float32))
    stylized(frames, weights, tmp_path / "out", mask=str(file), octaves=1, iterations=1)
    recipe = Recipe.from_toml(tmp_path / "out" / "recipe.toml")
    np.savez(file, density=np.full(SHAPE, 0.5, np.float32))
    with pytest.raises(InputError, match=r"its run had another .*mask\.npz than there is now"):
        prepare(frames, recipe, tmp_path / "out", resume=True)


def stopped_run(frames: Any, recipe: Recipe, out: Path) -> dict[str, Any]:
    """The record of a run that has ended, of which only the first frame is known to be complete."""
    for _ in Run(prepare(frames, recipe, out), progress=False):
        pass
    record = json.loads((out / "run.json").read_text())
    (out / "run.json").write_text(json.dumps(record | {"frames": record["frames"][:1], "status": "interrupted"}))
    return record


def test_a_changed_grid_of_the_input_does_not_resume_a_run(weights: str, tmp_path: Path) -> None:
    """Even if it is not carried, for then it is no part of what a run knows of its frames."""
    (frame,), smoke = moving_smoke(1, SHAPE), tmp_path / "s_0001.npz"
    keys = GOAL | {"mask": "heat", "carry": "none", "octaves": 1, "iterations": 1, "views": 1, "weights": weights}
    recipe = Recipe.from_dict(keys)
    for strength in (0.5, 0.25):
        np.savez(smoke, density=frame.density, heat=np.full(SHAPE, strength, np.float32))
        if strength == 0.5:
            for _ in Run(prepare(smoke, recipe, tmp_path / "out"), progress=False):
                pass
    with pytest.raises(InputError, match=r"out: its run had another mask in s_0001 than there is now; resume with"):
        prepare(smoke, recipe, tmp_path / "out", resume=True)


def test_a_mirrored_mask_in_a_folder_does_not_resume_a_run(weights: str, tmp_path: Path) -> None:
    """It holds as much of a symmetric smoke as before, and only one frame has another one."""
    y, x = np.indices(SHAPE)[1:]
    smoke = np.exp(-((x - 8.5) ** 2 + (y - 10.5) ** 2) / 20).astype(np.float32)
    frames, halves = [Frame(smoke, name=f"s_{n}", number=n) for n in (1, 2)], (x < 9).astype(np.float32)
    folder, out = tmp_path / "masks", tmp_path / "out"
    folder.mkdir()
    for number in (1, 2):
        np.savez(folder / f"m_{number}.npz", density=halves)
    targets = [GOAL, {"tag": ["volcano"], "mask": str(folder)}]
    few = {"octaves": 1, "iterations": 1, "views": 1, "weights": weights}
    recipe = Recipe.from_dict({"target": targets} | few)
    before = stopped_run(frames, recipe, out)
    prepare(frames, recipe, out, resume=True)
    np.savez(folder / "m_2.npz", density=halves[..., ::-1])
    said = r"out: its run had another mask of target 2 in s_2 than there is now; resume with the same masks, or use --o"
    with pytest.raises(InputError, match=said):
        prepare(frames, recipe, out, resume=True)
    now = prepare(frames, recipe).record
    (first, then), (_, after) = (record["targets"][1]["mask_sha256"] for record in (before, now))
    assert first == then != after
    assert before["targets"][1]["smoke_shares"] == pytest.approx(now["targets"][1]["smoke_shares"], abs=1e-6)
    assert run_identity(recipe, before) != run_identity(recipe, now), "what it had begun is not continued either"


def test_a_run_says_how_much_of_the_smoke_its_masks_hold(weights: str) -> None:
    """Of frames with smoke; one number where it is the same in all of them."""
    smoke = np.ones(SHAPE, np.float32)
    frames = [Frame(d, name=f"s_{n}", number=n) for n, d in enumerate((smoke, smoke, 0 * smoke))]
    half, growing = {"height": [10.5, 10.6]}, {"height": [10.5, 10.6], "strength": {0: 0.004, 1: 0.5}}

    def said(**keys: Any) -> list[str]:
        lines = announcement(prepare(frames, Recipe.from_dict(keys | {"weights": weights, "octaves": 1})))
        return [line for line in lines if line.endswith("of the smoke")]

    targets = [GOAL | {"mask": half}, {"tag": ["volcano"]}, GOAL | {"mask": growing}]
    assert said(target=targets) == ["target 1: 50% of the smoke", "target 3: 0.2% to 25% of the smoke"]
    assert said(mask=half, **GOAL) == ["mask: 50% of the smoke"]
    assert said(target=[GOAL]) == said(**GOAL) == []


@pytest.mark.parametrize("damage", [None, [], [{}], [{"mask_sha256": ["", ""]}]], ids=str)
def test_a_record_without_its_masks_does_not_resume_a_run(damage: Any, weights: str, tmp_path: Path) -> None:
    frames = moving_smoke(1, SHAPE)
    recipe = Recipe.from_dict(GOAL | {"mask": SPHERE, "octaves": 1, "iterations": 1, "views": 1, "weights": weights})
    record = stopped_run(frames, recipe, tmp_path)
    (tmp_path / "run.json").write_text(json.dumps(record | {"targets": damage}))
    with pytest.raises(InputError, match=r"run\.json: does not say which masks its run had; give another folder"):
        prepare(frames, recipe, tmp_path, resume=True)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"target": [GOAL], "style": ["net"]}, r"style = .* stands beside \[\[target\]\]"),
        ({"target": [GOAL], "mask": SPHERE}, r"mask stands beside \[\[target\]\]"),
        ({"mask": SPHERE | {"radius": 0.1}, **GOAL}, "mask: is 0 everywhere in all frames"),
        ({"mask": {"height": [21.5, 22.5]}, **GOAL}, "mask: (is 0 everywhere|has no smoke)"),
        ({"mask": "heat", **GOAL}, "mask: s_005: has no grid 'heat'; those beside its density are none"),
        (
            {
                "target": [GOAL, {"tag": ["volcano"]}],
                "window": 3,
                "step_order": "align_first",
                "window_average": "plain",
            },
            "averages the gradients of one target, and there are 2",
        ),
    ],
    ids=str,
)
def test_what_cannot_be_meant_is_refused_before_the_work(keys: dict[str, Any], said: str, weights: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        prepare(moving_smoke(2, SHAPE), Recipe.from_dict(keys | {"weights": weights}))
    assert "\n" not in str(caught.value)

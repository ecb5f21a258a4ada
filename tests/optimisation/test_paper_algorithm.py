"""The paper's own Algorithm 1 and Eq. 9 by recipe keys, against loops written out here."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from moving_smoke import SHAPE, moving_smoke

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.fields.pyramid import gaussian, merge, root_mean_square, split
from tnst_mi.frame import Frame
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.gradient import problem_of
from tnst_mi.optimisation.items.store import FolderStore, MemoryStore, Store
from tnst_mi.optimisation.parameterisation import Fields
from tnst_mi.optimisation.plan import Plan, plan_of
from tnst_mi.optimisation.result import Stylized
from tnst_mi.optimisation.runner import SequenceOptimisation
from tnst_mi.optimisation.temporal.window import window_of
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.prepare import prepare

GOAL = {"semantic": ("inception_3a/3x3:2",), "lam": 1.0, "octaves": 1, "iterations": 2, "views": 2}
ALGORITHM_1 = GOAL | {"window": 3, "window_average": "plain", "step_order": "align_first"}
COUNT, EXPOSURE = 4, 0.2


def plan(frames: list[Frame], recipe: Recipe, scales: list[float] | None = None) -> Plan:
    names, numbers = [frame.name for frame in frames], [frame.number for frame in frames]
    exposures = [EXPOSURE] * len(frames)
    return plan_of(recipe, names, numbers, scales or [1.0] * len(frames), exposures, SHAPE)


def stylized(
    recipe: Recipe, network: GoogLeNet, store: Store | None = None, frames: list[Frame] | None = None, **others: object
) -> list[Stylized]:
    frames = moving_smoke(COUNT) if frames is None else frames
    run = SequenceOptimisation(plan(frames, recipe, **others), frames, network, store or MemoryStore())
    return [result for _, result in run.run()]


def bits(results: list[Stylized]) -> list[bytes]:
    return [result.density.tobytes() + result.velocity.tobytes() for result in results]


def plain_average(frame: int, fields: list[np.ndarray], velocities: list[np.ndarray], window: int) -> np.ndarray:
    """Eq. 8 and 9 term by term: equal weights over the frames that the window has."""
    frames = window_of(frame, len(fields), window)
    total = np.zeros_like(fields[frame])
    for i in frames:
        field = fields[i]
        for j in range(i, frame):
            field = tnst_mi.advect(field, velocities[j], "maccormack_unlimited")
        for j in range(i, frame, -1):
            field = tnst_mi.advect(field, -velocities[j - 1], "maccormack_unlimited")
        total = total + field / len(frames)
    return total


def stored_velocities(frames: list[Frame]) -> list[np.ndarray]:
    return [np.float16(frame.velocity).astype(np.float32) for frame in frames]


@pytest.mark.parametrize("lam", [1.0, 0.4])
@pytest.mark.parametrize("window", [3, 5])
def test_plain_average_is_the_weighted_sum_of_eq_9(lam: float, window: int, network: GoogLeNet) -> None:
    """Of the frames' own steps, without their masks; in the shorter windows at both ends the weights sum to 1 too."""
    frames, store = moving_smoke(COUNT), MemoryStore()
    recipe = Recipe(**GOAL | {"iterations": 1, "window": window, "window_average": "plain", "lam": lam})
    stylized(recipe, network, store)
    steps = [store.read("step.0", index) for index in range(COUNT)]
    assert store.generation("gain.0", 0) == -1, "nothing is renormalised"
    for frame in range(COUNT):
        for name, field in store.read("fields.0", frame).items():
            own = [np.float32(step[name]) for step in steps]
            expected = -plain_average(frame, own, stored_velocities(frames), window)
            np.testing.assert_allclose(field, expected, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("lam", [1.0, 0.4])
def test_align_first_is_algorithm_1(lam: float, network: GoogLeNet) -> None:
    """Two iterations: ∇Φ, ∇Ψ of every frame, aligned, averaged, then blurred, normalised, masked, times η."""
    frames, store, eta = moving_smoke(COUNT), MemoryStore(), 0.02
    recipe = Recipe(**ALGORITHM_1 | {"lam": lam, "eta": eta})
    stylized(recipe, network, store)
    planned = plan(frames, recipe)
    octave = planned.octaves[0]
    problem = problem_of(planned, octave, network).scaled(store.numbers("scales.0"))
    fields = [frame.parameterisation.zeros(octave) for frame in planned.frames]
    for k in range(recipe.iterations):
        found = [
            problem.gradient(frame, fields[i], mi.TensorXf(frames[i].density), frame.seed(0, k)).gradients[0]
            for i, frame in enumerate(planned.frames)
        ]
        gradients = [{name: gradient.numpy() for name, gradient in fields_of.items()} for fields_of in found]
        for t in range(COUNT):
            mask = np.float32(store.read("inputs.0", t)["mask"])
            for name in fields[t]:
                mean = plain_average(t, [g[name] for g in gradients], stored_velocities(frames), 3)
                bands = split(gaussian(mi.TensorXf(mean), 1.2), recipe.pyramid_levels)
                normal = merge([mi.TensorXf(b.array / root_mean_square(b), b.shape) for b in bands]).numpy()
                step = eta * SHAPE[1] / 2 * normal * (mask if normal.ndim == 3 else mask[..., None])
                fields[t] = Fields(fields[t] | {name: mi.TensorXf(fields[t][name].numpy() - step)})
    for t in range(COUNT):
        for name, field in store.read("fields.0", t).items():
            expected = fields[t][name].numpy()
            assert np.linalg.norm(field - expected) < 2e-3 * np.linalg.norm(expected)


def test_the_orders_differ_with_a_window_and_not_without(network: GoogLeNet) -> None:
    one = {"window": 1}
    first = bits(stylized(Recipe(**GOAL | one), network))
    assert bits(stylized(Recipe(**ALGORITHM_1 | one), network)) == first
    assert bits(stylized(Recipe(**GOAL | one | {"step_order": "align_first"}), network)) == first
    steps = stylized(Recipe(**GOAL | {"window": 3, "window_average": "plain"}), network)
    gradients = stylized(Recipe(**ALGORITHM_1), network)
    for a, b in zip(steps, gradients, strict=True):
        assert np.linalg.norm(a.velocity - b.velocity) > 0.05 * np.linalg.norm(a.velocity)


@pytest.mark.parametrize("weight", [2.0**-20, 2.0**20])
def test_gradients_of_any_magnitude_are_kept(weight: float, network: GoogLeNet) -> None:
    """Normalised after the average, they give the same step; half precision would lose both."""
    store = MemoryStore()
    recipe = Recipe(**ALGORITHM_1 | {"loss_scaling": "none", "iterations": 1})
    expected = stylized(recipe, network)
    scaled = stylized(dataclasses.replace(recipe, semantic_weight=weight), network, store)
    gradient = store.read("step.0", 1)["phi"]
    assert gradient.dtype == np.float32
    largest = np.abs(gradient).max()
    assert largest < np.finfo(np.float16).smallest_normal or largest > np.finfo(np.float16).max
    for a, b in zip(scaled, expected, strict=True):
        np.testing.assert_allclose(a.velocity, b.velocity, atol=2e-3 * np.abs(b.velocity).max())


def test_changes_are_still_averaged_after_gradients(network: GoogLeNet, tmp_path: Path) -> None:
    """Coherence beside Algorithm 1: its item holds a gradient in single and a change in half precision."""
    recipe = Recipe(**ALGORITHM_1 | {"coherence": 1.0})
    store = FolderStore(tmp_path)
    results = stylized(recipe, network, store)
    assert {name: array.dtype for name, array in store.read("step.0", 1).items()} == {
        "phi": np.float32,
        "change": np.float16,
    }
    assert bits(results) == bits(stylized(recipe, network))
    assert bits(results) != bits(stylized(Recipe(**ALGORITHM_1), network))


def test_frames_without_smoke_count_as_frames_without_a_step(network: GoogLeNet) -> None:
    frames = moving_smoke(3)
    empty = dataclasses.replace(frames[0], density=np.zeros(SHAPE, np.float32), name="empty", number=4)
    frames, store = [empty, *frames], MemoryStore()
    recipe = Recipe(**GOAL | {"iterations": 1, "window": 3, "window_average": "plain"})
    stylized(recipe, network, store, frames, scales=[0.0, 1.0, 1.0, 1.0])
    steps = [np.zeros(SHAPE, np.float32), *(np.float32(store.read("step.0", index)["phi"]) for index in (1, 2, 3))]
    expected = -plain_average(1, steps, stored_velocities(frames), 3)
    np.testing.assert_allclose(store.read("fields.0", 1)["phi"], expected, atol=1e-4 * np.abs(expected).max())


def test_gradients_are_not_averaged_over_smoke(weights: Path) -> None:
    recipe = Recipe(**GOAL | {"window": 3, "step_order": "align_first", "weights": str(weights)})
    message = "^step_order = 'align_first' averages gradients before the mask, .* expected window_average = 'plain'$"
    for refuse in (lambda: prepare(moving_smoke(3), recipe), lambda: plan(moving_smoke(3), recipe)):
        with pytest.raises(InputError, match=message):
            refuse()


def test_a_sequence_by_the_preset_from_start_to_end(weights: Path, tmp_path: Path) -> None:
    """With a map and a content picture at two layers; recipe.toml as run gives the same bits again."""
    np.savez(tmp_path / "map.npz", map=np.linspace(0, 1, 24).reshape(24, 1, 1))
    keys = {
        "preset": "paper",
        "content": ["net"],
        "content_layers": {"conv2/3x3": 1.0, "inception_3a/3x3": 0.5},
        "match": ["conv2/3x3:map.npz"],
        "octaves": 2,
        "iterations": 2,
        "views": 2,
        "window": 3,
        "weights": str(weights),
    }
    recipe = Recipe.from_dict(keys, folder=tmp_path)
    first = tnst_mi.stylize(moving_smoke(3), recipe, tmp_path / "first", progress=False)
    again = Recipe.from_toml(tmp_path / "first" / "recipe.toml")
    assert again.preset == "paper" and again.step_order == "align_first"
    second = tnst_mi.stylize(moving_smoke(3), again, progress=False)
    for a, b, frame in zip(first.densities, second.densities, moving_smoke(3), strict=True):
        np.testing.assert_array_equal(a, b)
        assert np.abs(a - frame.density).max() > 1e-3
    assert [frame["step_scale"] for frame in first.run["frames"]] == [1.0, 1.0, 1.0]
    assert str(tmp_path / "map.npz") in first.run["files"]
    assert [name.split()[0] for name in first.run["frames"][0]["terms_after"]] == ["content", "content", "match"]


# --------------------------------------------------------------------
# σ and plain weights
# --------------------------------------------------------------------


def test_sigma_is_a_factor_of_the_step_or_of_the_loss(network: GoogLeNet) -> None:
    """Of the loss: steps are as long for every frame, but for one that is left unchanged; terms are times σ."""
    frames, scales = moving_smoke(3), [1.0, 0.25, 0.0]
    by_step, by_loss = (plan(frames, Recipe(**GOAL | {"sigma": sigma}), scales) for sigma in ("step", "loss"))
    assert [frame.step_scale for frame in by_step.frames] == scales
    assert [frame.step_scale for frame in by_loss.frames] == [1.0, 1.0, 0.0]
    assert [frame.still for frame in by_loss.frames] == [False, False, True]

    views = tnst_mi.sample_views(2, seed=by_loss.frames[0].seed(0, 0))
    images = tnst_mi.render(frames[0].density, [tuple(view) for view in views]) * EXPOSURE
    terms = {}
    for sigma in ("step", "loss"):
        (result,) = stylized(Recipe(**GOAL | {"sigma": sigma, "views": 1}), network, None, frames[:1])
        (terms[sigma],) = result.history[0]["terms"].values()
    assert terms["loss"] == pytest.approx(images[0].sum() * terms["step"], rel=1e-4)


def test_without_loss_scaling_weights_are_plain_factors(network: GoogLeNet) -> None:
    store = MemoryStore()
    keys = {"style": ("spirals",), "style_layers": {"conv2/3x3": 1.0}, "semantic_weight": 3.0, "style_weight": 0.5}
    (result,) = stylized(Recipe(**GOAL | keys | {"loss_scaling": "none"}), network, store, moving_smoke(1))
    assert set(store.numbers("scales.0").values()) == {1.0}
    for entry in result.history:
        semantic, style = entry["terms"].values()
        assert entry["loss"] == pytest.approx(3.0 * semantic + 0.5 * style, rel=1e-6)
    semantic, style = result.terms_after.values()
    assert result.loss_after == pytest.approx(3.0 * semantic + 0.5 * style, rel=1e-6)

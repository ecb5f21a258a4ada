"""Sequences: Algorithm 1 step by step, its windows, what may change over the frames, and going on after a stop."""

from __future__ import annotations

import dataclasses
import os
import signal
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from moving_smoke import SHAPE, moving_smoke

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Octave
from tnst_mi.frame import Frame
from tnst_mi.losses.objective import Objective
from tnst_mi.machine.backend import on_gpu
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.goals import objective_of
from tnst_mi.optimisation.gradient import OctaveProblem
from tnst_mi.optimisation.items.store import FolderStore, MemoryStore, Store
from tnst_mi.optimisation.parameterisation import Fields, Transport
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.optimisation.result import Progress, Stylized
from tnst_mi.optimisation.runner import SequenceOptimisation
from tnst_mi.optimisation.single_frame import optimise
from tnst_mi.optimisation.temporal.window import window_of
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.driving import main_view
from tnst_mi.run.flicker import FlickerMeter
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare

GOAL = {
    "semantic": ("inception_3a/3x3:2",),
    "lam": 1.0,
    "octaves": 2,
    "iterations": 2,
    "views": 2,
    "density_scale": 1.0,
}
EXPOSURE = 0.2


def optimisation(
    frames: list[Frame],
    recipe: Recipe,
    network: GoogLeNet,
    store: Store | None = None,
    scales: list[float] | None = None,
) -> SequenceOptimisation:
    names, numbers = [frame.name for frame in frames], [frame.number for frame in frames]
    scales = [1.0] * len(frames) if scales is None else scales
    plan = plan_of(recipe, names, numbers, scales, [EXPOSURE] * len(frames), frames[0].density.shape)
    return SequenceOptimisation(plan, frames, network, MemoryStore() if store is None else store)


def stylized(*arguments: object, **others: object) -> list[Stylized]:
    return [result for _, result in optimisation(*arguments, **others).run()]


def bits(results: list[Stylized]) -> list[bytes]:
    return [result.density.tobytes() + result.velocity.tobytes() for result in results]


# --------------------------------------------------------------------
# Algorithm 1
# --------------------------------------------------------------------


@pytest.mark.parametrize("lam", [1.0, 0.4])
def test_one_iteration_is_the_windowed_average_of_the_frames_own_steps(lam: float, network: GoogLeNet) -> None:
    """Fields after it, from the steps in the store, by the double sum of Eq. 8 and 9 over smoke."""
    frames = moving_smoke(4)
    recipe = Recipe(**GOAL | {"octaves": 1, "iterations": 1, "window": 3, "lam": lam})
    store = MemoryStore()
    stylized(frames, recipe, network, store=store)
    steps = [store.read("step.0", index) for index in range(4)]
    masks = [store.read("inputs.0", index)["mask"] for index in range(4)]
    velocities = [np.float16(frame.velocity).astype(np.float32) for frame in frames]

    def average(frame: int, fields: list[np.ndarray]) -> np.ndarray:
        total = fields[frame] / 3
        for i in window_of(frame, 4, 3):
            if i != frame:
                velocity = velocities[i] if i < frame else -velocities[frame]
                total = total + tnst_mi.advect(fields[i], velocity, "maccormack_unlimited") / 3
        return total

    for frame in range(4):
        gain = masks[frame] / np.maximum(np.maximum(average(frame, masks), masks[frame] / 3), 1e-6)
        assert gain.max() > 1.01, "smoke that arrives and leaves must matter"
        for name, field in store.read("fields.0", frame).items():
            change = average(frame, [step[name] for step in steps])
            expected = -(gain if change.ndim == 3 else gain[..., None]) * change
            np.testing.assert_allclose(field, expected, atol=2e-3 * np.abs(expected).max())


def test_step_of_a_frame_is_that_of_the_frame_alone(network: GoogLeNet) -> None:
    frames = moving_smoke(3)
    recipe = Recipe(**GOAL | {"octaves": 1, "iterations": 1})
    store = MemoryStore()
    stylized(frames, dataclasses.replace(recipe, window=3), network, store=store, scales=[1.0, 0.5, 0.25])
    for index, (frame, scale) in enumerate(zip(frames, (1.0, 0.5, 0.25), strict=True)):
        alone = optimise(frame, recipe, network, EXPOSURE, step_scale=scale)
        step = store.read("step.0", index)["phi"]
        np.testing.assert_allclose(step, -alone.potential[0], rtol=1e-3, atol=1e-3 * np.abs(step).max())


def test_without_a_window_frames_are_stylized_as_if_alone(network: GoogLeNet) -> None:
    """But for the scale of the only term, which the normalisation of the gradient takes out again."""
    frames, recipe = moving_smoke(3), Recipe(**GOAL)
    for frame, result in zip(frames, stylized(frames, recipe, network), strict=True):
        alone = optimise(frame, recipe, network, EXPOSURE)
        np.testing.assert_allclose(result.velocity, alone.velocity, atol=2e-3 * np.abs(alone.velocity).max())


def test_scales_are_pooled_over_the_frames(network: GoogLeNet) -> None:
    """RMS over all pixels of all frames that are not still: the root of the mean of the single frames' squares."""
    frames, recipe = moving_smoke(3), Recipe(**GOAL | {"octaves": 1})
    singles = []
    for frame in frames[:2]:
        store = MemoryStore()
        stylized([frame], recipe, network, store=store)
        singles.append(next(iter(store.numbers("scales.0").values())))
    store = MemoryStore()
    stylized(frames, recipe, network, store=store, scales=[1.0, 1.0, 0.0])
    pooled = next(iter(store.numbers("scales.0").values()))
    assert pooled == pytest.approx(np.sqrt(np.mean(np.square(singles))), rel=1e-6)
    assert singles[0] != pytest.approx(singles[1], rel=1e-3)


def test_nothing_from_outside_the_window_reaches_a_frame_in_one_iteration(network: GoogLeNet) -> None:
    frames = moving_smoke(6)
    recipe = Recipe(**GOAL | {"octaves": 1, "iterations": 1, "window": 3})

    def run(frames: list[Frame]) -> list[bytes]:
        store = MemoryStore()
        store.write_numbers("scales.0", {"semantic inception_3a/3x3:2": 1.0})
        return bits(stylized(frames, recipe, network, store=store))

    before = run(frames)
    changed = list(frames)
    changed[2] = dataclasses.replace(frames[2], density=frames[2].density * 0.5 + 0.1)
    after = run(changed)
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False, False, False, True, True]


def test_windows_and_coherence_make_a_sequence_steadier(network: GoogLeNet) -> None:
    frames = moving_smoke(5)
    means = {}
    for window, coherence in ((1, 0.0), (5, 0.0), (5, 2.0)):
        recipe = Recipe(**GOAL | {"iterations": 4, "window": window, "coherence": coherence, "eta": 0.01})
        meter = FlickerMeter()
        for frame, result in zip(frames, stylized(frames, recipe, network), strict=True):
            meter.add(frame.name, frame.density, result.density, frame.velocity)
        means[window, coherence] = meter.mean
    assert means[5, 0.0] < 0.8 * means[1, 0.0]
    assert means[5, 2.0] < 0.9 * means[5, 0.0]


@pytest.mark.parametrize("coherence", [0.0, 1.0])
def test_frames_without_smoke_are_left_alone_and_do_not_count(coherence: float, network: GoogLeNet) -> None:
    frames = moving_smoke(3)
    empty = dataclasses.replace(frames[0], density=np.zeros(SHAPE, np.float32), name="empty", number=4)
    recipe = Recipe(**GOAL | {"window": 3, "coherence": coherence})
    results = stylized([empty, *frames], recipe, network, scales=[0.0, 1.0, 1.0, 1.0])
    assert "empty is empty: nothing to stylize" in results[0].note
    assert not results[0].density.any() and results[0].loss_before is None
    alone = stylized(frames, recipe, network)
    for with_it, without in zip(results[1:], alone, strict=True):
        np.testing.assert_allclose(with_it.velocity, without.velocity, atol=1e-4 * np.abs(without.velocity).max())


def test_losses_before_and_after_are_those_of_the_objective(network: GoogLeNet) -> None:
    (frame,) = moving_smoke(1)
    recipe = Recipe(**GOAL | {"blend": 0.5})
    store = MemoryStore()
    (result,) = stylized([frame], recipe, network, store=store)
    bound = objective_of(recipe).bind(network, *SHAPE[1:]).scaled(store.numbers("scales.1"))
    judged = ((result.loss_before, result.terms_before), (result.loss_after, result.terms_after))
    for density, (loss, terms) in zip((frame.density, result.density), judged, strict=True):
        images = tnst_mi.render(mi.TensorXf(density), [(-8, 0), (0, 0), (8, 0)], recipe.gamma, recipe.quadrature)
        value, raw = bound.evaluate((images * EXPOSURE).torch())
        assert float(value) / 3 == pytest.approx(loss, rel=1e-4)
        assert {name: float(term) / 3 for name, term in raw.items()} == pytest.approx(terms, rel=1e-4)


def test_blend_mixes_the_stylized_density_with_the_frame(network: GoogLeNet) -> None:
    (frame,) = moving_smoke(1)
    whole, part, none = (stylized([frame], Recipe(**GOAL | {"blend": b}), network)[0].density for b in (1, 0.25, 0))
    np.testing.assert_array_equal(none, frame.density)
    np.testing.assert_allclose(part, 0.75 * frame.density + 0.25 * whole, atol=1e-6)
    assert np.abs(whole - frame.density).max() > 1e-3


def test_no_kernel_is_compiled_after_the_second_iteration_of_an_octave(network: GoogLeNet) -> None:
    """Neither another frame nor another weight, velocity or view makes one."""
    compiled: list[int] = []

    def count(progress: Progress) -> None:
        compiled.append(sum(not kernel["cache_hit"] for kernel in dr.kernel_history([dr.KernelType.JIT])))
        dr.kernel_history_clear()

    recipe = Recipe(**GOAL | {"octaves": 1, "iterations": 4, "window": 3, "window_weights": "gaussian"})
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        list(optimisation(moving_smoke(4), recipe, network).run(count))
    assert len(compiled) == 16 and not any(compiled[5:])


# --------------------------------------------------------------------
# What changes over the frames
# --------------------------------------------------------------------


def test_lambda_may_change_over_the_frames(network: GoogLeNet) -> None:
    """From a curl to a gradient: at the keys the velocity is what the fixed λ gives."""
    frames = moving_smoke(3)
    goal = GOAL | {"transport": "step"}
    keyed = Recipe.from_dict(goal | {"lam": {"5": 0.0, "7": 1.0}})
    results = stylized(frames, keyed, network)
    for index, lam in ((0, 0.0), (2, 1.0)):
        fixed = stylized(frames, Recipe(**goal | {"lam": lam}), network)[index].velocity
        np.testing.assert_allclose(results[index].velocity, fixed, atol=2e-3 * np.abs(fixed).max())
    phi, psi = results[1].potential
    np.testing.assert_allclose(results[1].velocity, tnst_mi.velocity(phi, psi, 0.5), atol=1e-5)


def test_styles_fade_into_each_other(network: GoogLeNet) -> None:
    frames = moving_smoke(3)
    goal = {"style_layers": ["conv2/3x3"], "octaves": 1, "iterations": 2, "views": 2}
    results = stylized(frames, Recipe.from_dict(goal | {"style": {"5": "net", "7": "spirals"}}), network)
    for index, style in ((0, "net"), (2, "spirals")):
        fixed = stylized(frames, Recipe.from_dict(goal | {"style": [style]}), network)[index]
        np.testing.assert_allclose(results[index].velocity, fixed.velocity, atol=5e-3 * np.abs(fixed.velocity).max())
        other = stylized(frames, Recipe.from_dict(goal | {"style": [style]}), network)[1]
        assert np.abs(results[1].velocity - other.velocity).max() > 0.02 * np.abs(other.velocity).max()


def test_exposure_and_steps_follow_a_gamma_that_changes(weights: Path) -> None:
    """Each frame is exposed for its own γ, and its step compares it with the other frames at that γ."""
    frames, azimuths = moving_smoke(3), (0, 20, 40)
    keys = {"gamma": {"5": 0.05, "7": 1.0}, "azimuth": {"5": [-10, 10], "7": [30, 50]}, "weights": str(weights)}
    recipe = Recipe.from_dict(GOAL | keys | {"iterations": 1})
    result = tnst_mi.stylize(frames, recipe, progress=False)
    assert result.run["exposure"] is None
    exposures = [frame["exposure"] for frame in result.run["frames"]]
    for index, (azimuth, gamma) in enumerate(zip(azimuths, (0.05, 0.525, 1.0), strict=True)):
        fixed = dataclasses.replace(recipe, gamma=gamma, azimuth=(azimuth - 10.0, azimuth + 10.0), keyframes={})
        # Each frame has its own camera: of all of them, the largest column counts.
        alone = tnst_mi.stylize(frames, fixed, progress=False).run["exposure"]
        assert exposures[index] == pytest.approx(alone, rel=0.02)
        sums = [
            tnst_mi.render(frame.density, (of_frame, 0), gamma).sum()
            for frame, of_frame in zip(frames, azimuths, strict=True)
        ]
        assert result.run["frames"][index]["step_scale"] == pytest.approx(sums[index] / max(sums), rel=1e-4)
    image = tnst_mi.render(frames[1].density, (20, 0), 0.525)
    np.testing.assert_allclose(main_view(frames[1].density, recipe.at(6)), image, atol=1e-5)


# --------------------------------------------------------------------
# Stopping and going on
# --------------------------------------------------------------------


@pytest.mark.parametrize("window", [1, 3])
def test_state_on_disk_gives_the_bits_of_state_in_memory(window: int, network: GoogLeNet, tmp_path: Path) -> None:
    frames, recipe = moving_smoke(3), Recipe(**GOAL | {"window": window, "lam": 0.5, "coherence": 1.0})
    in_memory = bits(stylized(frames, recipe, network))
    assert bits(stylized(frames, recipe, network, store=FolderStore(tmp_path))) == in_memory


@pytest.mark.parametrize("window", [1, 3])
@pytest.mark.parametrize("stop", [1, 4, 7, 11])
def test_interrupted_run_goes_on_to_the_same_bits(window: int, stop: int, network: GoogLeNet, tmp_path: Path) -> None:
    frames, recipe = moving_smoke(3), Recipe(**GOAL | {"window": window})
    expected = stylized(frames, recipe, network)

    def interrupt(progress: Progress) -> None:
        if progress.done == stop:
            raise KeyboardInterrupt

    run = optimisation(frames, recipe, network, store=FolderStore(tmp_path))
    finished = [index for index, _ in run.run(interrupt)]
    assert run.interrupted
    done = []
    again = optimisation(frames, recipe, network, store=FolderStore(tmp_path))
    results = [result for _, result in again.run(lambda progress: done.append(progress.done), finished)]
    assert bits(results) == bits(expected[len(finished) :])
    # At most one iteration of one frame is done again; and the history is as if nothing had happened.
    # On a GPU, an iteration is reported when the next one has been launched.
    later = on_gpu()
    assert done == list(range(13 - len(done), 13)) and 13 - len(done) in range(stop, stop + 2 + later)
    losses = [[entry["loss"] for entry in result.history] for result in results]
    assert losses == [[entry["loss"] for entry in result.history] for result in expected[len(finished) :]]


def test_second_ctrl_c_leaves_what_was_written(
    network: GoogLeNet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the middle of a step: fields that have been changed already must not pass for those of an iteration before."""
    frames, recipe = moving_smoke(1), Recipe(**GOAL)
    (expected,) = stylized(frames, recipe, network)
    after = Fields.__sub__

    def interrupted(fields: Fields, step: Fields) -> Fields:
        after(fields, step)
        raise KeyboardInterrupt

    monkeypatch.setattr(Fields, "__sub__", interrupted)
    assert stylized(frames, recipe, network, store=FolderStore(tmp_path))[0].interrupted
    monkeypatch.undo()
    assert bits(stylized(frames, recipe, network, store=FolderStore(tmp_path))) == bits([expected])


def pressed_once(monkeypatch: pytest.MonkeyPatch, owner: type, name: str, call: int) -> None:
    """Ctrl-C during the given call of a method, from 1."""
    method, calls = getattr(owner, name), []

    def pressed(*arguments: object, **others: object) -> object:
        calls.append(arguments)
        if len(calls) == call:
            os.kill(os.getpid(), signal.SIGINT)
        return method(*arguments, **others)

    monkeypatch.setattr(owner, name, pressed)


@pytest.mark.parametrize("window", [1, 3])
def test_ctrl_c_between_two_octaves_loses_nothing(
    window: int, network: GoogLeNet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the loss of the second octave gets its targets, those of the first are forgotten already."""
    frames, recipe = moving_smoke(3 if window > 1 else 1), Recipe(**GOAL | {"window": window})
    expected = stylized(frames, recipe, network)
    with monkeypatch.context() as patch:
        pressed_once(patch, Objective, "bind", 2)
        run = optimisation(frames, recipe, network, store=FolderStore(tmp_path))
        reached = [result for _, result in run.run()]
    assert run.interrupted
    if window == 1:
        ((result,), iterations) = reached, GOAL["iterations"]
        assert result.interrupted and len(result.history) == iterations and result.velocity.any()
    assert bits(stylized(frames, recipe, network, store=FolderStore(tmp_path))) == bits(expected)


def test_ctrl_c_in_the_last_iteration_is_not_lost(network: GoogLeNet, monkeypatch: pytest.MonkeyPatch) -> None:
    """The result is whole; that the run was interrupted is said, and the losses are judged."""
    (frame,), recipe = moving_smoke(1), Recipe(**GOAL)
    (expected,) = stylized([frame], recipe, network)
    pressed_once(monkeypatch, OctaveProblem, "gradient", 4)
    run = optimisation([frame], recipe, network)
    ((_, result),) = run.run()
    assert run.interrupted and result.interrupted
    assert bits([result]) == bits([expected]) and result.loss_after == expected.loss_after is not None


def test_one_visible_frame_in_a_window_can_be_resumed(
    network: GoogLeNet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames, recipe = moving_smoke(3), Recipe(**GOAL | {"window": 3})
    scales = [0.0, 1.0, 0.0]
    expected = stylized(frames, recipe, network, scales=scales)
    with monkeypatch.context() as patch:
        pressed_once(patch, OctaveProblem, "gradient", 1)
        list(optimisation(frames, recipe, network, FolderStore(tmp_path), scales).run())
    done = []
    run = optimisation(frames, recipe, network, FolderStore(tmp_path), scales)
    results = [result for _, result in run.run(lambda progress: done.append(progress.done))]
    assert bits(results) == bits(expected) and done == [2, 3, 4]


def test_frames_that_are_finished_are_not_iterated_again(
    network: GoogLeNet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results were written of three of four frames when the run was killed in the last octave."""
    frames, recipe, store = moving_smoke(4), Recipe(**GOAL), FolderStore(tmp_path)
    run = optimisation(frames, recipe, network, store).run()
    for _ in range(3):
        next(run)
    run.close()
    found = []
    gradient = OctaveProblem.gradient
    monkeypatch.setattr(OctaveProblem, "gradient", lambda *a: (found.append(a[1].index), gradient(*a))[1])
    for index in range(3):  # what a run that was killed early has of them
        store.write("fields.1", index, 0, store.read("fields.1", index))
    ((index, _),) = optimisation(frames, recipe, network, FolderStore(tmp_path)).run(finished=[0, 1, 2])
    assert index == 3 and set(found) <= {3}


def test_changes_too_large_for_half_precision_are_refused(network: GoogLeNet) -> None:
    frames = [dataclasses.replace(frame, density=1e8 * frame.density) for frame in moving_smoke(2)]
    recipe = Recipe(**GOAL | {"window": 3, "coherence": 1.0, "gamma": 1e-9, "iterations": 3})
    with pytest.raises(InputError, match=r"s_005: steps or changes of the density exceed 65504; take density_scale"):
        stylized(frames, recipe, network)


def test_interrupted_single_frame_is_given_as_far_as_it_got(network: GoogLeNet, tmp_path: Path) -> None:
    """In the coarse octave, after one of two iterations: its field, brought to full resolution."""
    frames, recipe, store = moving_smoke(1), Recipe(**GOAL), FolderStore(tmp_path)

    def interrupt(progress: Progress) -> None:
        raise KeyboardInterrupt

    ((_, reached),) = optimisation(frames, recipe, network, store=store).run(interrupt)
    assert reached.interrupted and len(reached.history) in range(1, 2 + on_gpu())
    fields = Fields({name: mi.TensorXf(array) for name, array in store.read("fields.0", 0).items()})
    transport = Transport(1.0)
    fine = transport.carried(fields, Octave((4, 6, 5), 2.0), Octave(SHAPE, 1.0))
    assert reached.velocity.any()
    np.testing.assert_array_equal(reached.velocity, transport.velocity(fine, 1.0).numpy())


def test_what_a_window_needs_is_checked_first(weights: Path, tmp_path: Path) -> None:
    recipe = Recipe(**GOAL | {"window": 3, "weights": str(weights)})
    frames = moving_smoke(3)
    lacking = [frames[0], dataclasses.replace(frames[1], velocity=None), frames[2]]
    for given, message in (
        (lacking, "s_006: has no velocity, which window = 3 needs; add it to the frames, or set window to 1"),
        (frames[:1], "s_005: is a single frame, expected a sequence"),
        ([frames[0], frames[2], dataclasses.replace(frames[1], number=8)], "7 comes after 5, expected 6 there"),
    ):
        with pytest.raises(InputError, match=message):
            tnst_mi.stylize(given, recipe, tmp_path / "out", progress=False)
    assert not (tmp_path / "out").exists()
    # The last frame needs none.
    result = tnst_mi.stylize(
        [*frames[:2], dataclasses.replace(frames[2], velocity=None)], recipe, tmp_path / "out", progress=False
    )
    assert len(result.run["sequence"]["flicker_pairs"]) == 2


@pytest.mark.parametrize("damage", ["truncated", "missing"])
def test_a_bad_frame_in_the_middle_is_found_before_the_work_begins(
    damage: str, weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tnst_mi.save_frames(tmp_path / "smoke", moving_smoke(4))
    path = tmp_path / "smoke" / "s_007.npz"
    path.write_bytes(path.read_bytes()[:-3000])
    if damage == "missing":
        path.unlink()
    recipe = Recipe(**GOAL | {"window": 3, "weights": str(weights)})
    monkeypatch.setattr(SequenceOptimisation, "run", lambda *_: pytest.fail("the work has begun"))
    expected = {
        "truncated": r"s_007\.npz: .* truncated, or damaged",
        "missing": "frames are missing between 5 and 8: 7",
    }
    with pytest.raises(InputError, match=expected[damage]):
        tnst_mi.stylize(tmp_path / "smoke", recipe, tmp_path / "out", progress=False)
    assert not (tmp_path / "out").exists()


def test_a_frame_that_is_damaged_while_the_run_goes_on_stops_it_and_can_be_repaired(
    weights: Path, tmp_path: Path
) -> None:
    frames, out = moving_smoke(3), tmp_path / "out"
    tnst_mi.save_frames(tmp_path / "smoke", frames)
    recipe = Recipe(**GOAL | {"window": 3, "weights": str(weights)})
    path = tmp_path / "smoke" / "s_006.npz"
    whole = path.read_bytes()
    job = Run(prepare(tmp_path / "smoke", recipe, out), progress=False)
    path.write_bytes(whole[:-3000])
    with pytest.raises(InputError, match=r"s_006\.npz: .* truncated, or damaged"):
        list(job)
    path.write_bytes(whole)
    resumed = list(Run(prepare(tmp_path / "smoke", recipe, out, resume=True), progress=False))
    alone = tnst_mi.stylize(frames, recipe, progress=False)
    for frame, density in zip(resumed, alone.densities, strict=True):
        np.testing.assert_array_equal(frame.stylized.density, density)

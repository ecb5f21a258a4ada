"""Losses of a style in whole runs: in regions, with a window and several views, to the same bits every time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import torch
from fields import blob
from moving_smoke import moving_smoke

import tnst_mi
from tnst_mi.choices import STYLE_LOSSES
from tnst_mi.losses.evaluation import BoundObjective
from tnst_mi.losses.guided import Guide, Guides
from tnst_mi.machine.backend import torch_device
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.gradient import OctaveProblem, problem_of
from tnst_mi.optimisation.plan import FramePlan, plan_of
from tnst_mi.recipe.recipe import Recipe

SHAPE = (16, 22, 18)
LAYERS = {"conv2/3x3": 1.0, "inception_3a/output": 1.0}
SPHERE = {"shape": "sphere", "centre": [6.5, 10.5, 7.5], "radius": 6.0, "edge": 2.0}


def problem(network: GoogLeNet, **keys: Any) -> tuple[OctaveProblem, FramePlan]:
    """An octave at full resolution, and the plan of its only frame."""
    goals = {} if "target" in keys else {"style": ["net"], "style_layers": LAYERS}
    recipe = Recipe.from_dict({"views": 2, "gamma": 0.3, "lam": 1.0} | goals | keys)
    plan = plan_of(recipe, ["f"], [5], [1.0], [0.2], SHAPE)
    return problem_of(plan, plan.full, network.to(torch_device())), plan.frames[0]


@pytest.mark.parametrize("distance", STYLE_LOSSES)
def test_runs_come_nearer_to_the_picture_and_are_repeated(distance: str, weights: Path) -> None:
    """Two regions, of which one looks at the smoke alone, over a window of three frames."""
    style = {"style": ["net"], "style_layers": LAYERS, "style_loss": distance}
    targets = [style | {"mask": SPHERE}, style | {"mask": SPHERE | {"invert": True}, "style_statistics": "smoke"}]
    recipe = {"octaves": 2, "iterations": 4, "views": 2, "eta": 0.01, "gamma": 0.3, "window": 3}
    frames = moving_smoke(3, SHAPE)
    keys = recipe | {"target": targets, "weights": str(weights)}
    runs = [tnst_mi.stylize(frames, keys, progress=False) for _ in range(2)]
    for one, other in zip(*(run.densities for run in runs), strict=True):
        assert one.tobytes() == other.tobytes()
    for record in runs[0].run["frames"]:
        assert record["loss_after"] < record["loss_before"]


def test_directions_differ_from_iteration_to_iteration(network: GoogLeNet) -> None:
    density = mi.TensorXf(moving_smoke(1, SHAPE)[0].density)
    swd, frame = problem(network, style_loss="swd", azimuth=[0, 0], elevation=[0, 0])
    gram, _ = problem(network, azimuth=[0, 0], elevation=[0, 0])

    def losses(of: OctaveProblem) -> list[float]:
        fields = frame.parameterisation.zeros(of.octave)
        seeds = [frame.seed(0, 0), frame.seed(0, 1), frame.seed(1, 0), frame.seed(0, 0)]
        return [float(of.gradient(frame, fields, density, seed).loss) for seed in seeds]

    first, *others, again = losses(swd)
    assert first == again and len({first, *others}) == 3
    assert len(set(losses(gram))) == 1, "the views are the same"


def test_a_run_is_judged_by_the_same_directions_before_and_after(network: GoogLeNet) -> None:
    density = moving_smoke(1, SHAPE)[0].density
    swd, frame = problem(network, style_loss="swd")
    assert swd.judge(frame, density) == swd.judge(frame, density)


class Seen:
    """Records the guides with which losses are evaluated."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.guides: list[Guides] = []
        plain = BoundObjective.evaluate

        def evaluate(bound: BoundObjective, images: torch.Tensor, guides: Guides) -> Any:
            self.guides.append(guides)
            return plain(bound, images, guides)

        monkeypatch.setattr(BoundObjective, "evaluate", evaluate)


def shares(guide: Guide | None) -> np.ndarray:
    assert guide is not None
    return guide._shares.cpu().numpy()


def test_the_smoke_is_where_images_are_opaque(network: GoogLeNet, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the transmittance of the extinction at hand, whatever quadrature makes the images; shared among regions."""
    density, mask = moving_smoke(1, SHAPE)[0].density, blob(SHAPE, (6, 10, 7), 5.0)
    style = {"style": ["net"], "style_layers": LAYERS, "style_statistics": "smoke"}
    goals = [style, style, {"tag": ["volcano"]}, style | {"style_statistics": "image"}]
    views = {"views": 1, "azimuth": [25, 25], "elevation": [10, 10]}
    for quadrature in ("paper", "integrated_transmittance"):
        of_targets, frame = problem(network, target=goals, quadrature=quadrature, **views)
        seen = Seen(monkeypatch)
        of_targets.gradient(
            frame,
            frame.parameterisation.zeros(of_targets.octave),
            mi.TensorXf(density),
            (1,),
            [None, mi.TensorXf(mask), mi.TensorXf(mask), None],
        )
        opacity = tnst_mi.render(density, [(25.0, 10.0)], 0.3, "transmittance")
        whole, part, tag, plain = seen.guides
        assert whole.region is None and tag.smoke is None and plain == Guides()
        np.testing.assert_allclose(shares(whole.smoke), opacity, atol=1e-6)
        np.testing.assert_allclose(shares(part.smoke), opacity * shares(part.region), atol=1e-6)
        assert 0.1 < shares(part.region).max() <= 1 and opacity.max() > 0.3
        assert (shares(tag.region) == shares(part.region)).all()


def test_the_image_is_what_counts_by_default(network: GoogLeNet, monkeypatch: pytest.MonkeyPatch) -> None:
    density = moving_smoke(1, SHAPE)[0].density
    of_image, frame = problem(network)
    seen = Seen(monkeypatch)
    of_image.judge(frame, density)
    assert seen.guides == [Guides()]


@pytest.mark.parametrize("distance", STYLE_LOSSES)
def test_terms_are_scaled_in_the_smoke_too(distance: str, network: GoogLeNet) -> None:
    """Scales are those with which the first images have a gradient of RMS 1."""
    density = mi.TensorXf(moving_smoke(1, SHAPE)[0].density)
    of_smoke, frame = problem(network, style_loss=distance, style_statistics="smoke")
    of_image, _ = problem(network, style_loss=distance)
    fields, seed = frame.parameterisation.zeros(of_smoke.octave), frame.seed(0, 0)

    def rms(of: OctaveProblem) -> float:
        ((square, count),) = of.gradient_square_sum(frame, fields, density, seed).values()
        return float(np.sqrt(square / count))

    first = rms(of_smoke)
    assert first > 0 and first != rms(of_image)
    scaled = of_smoke.scaled({name: first for name in of_smoke.scales})
    found, plain = (float(of.gradient(frame, fields, density, seed).loss) for of in (scaled, of_smoke))
    assert found == pytest.approx(plain / first, rel=1e-5)

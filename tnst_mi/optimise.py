"""Stylizing one frame: coarse to fine, all views of an iteration at once (paper Eq. 4 and section 4)."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi import losses
from tnst_mi.backend import torch_device
from tnst_mi.driving import driving_scene, main_view
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.googlenet import GoogLeNet
from tnst_mi.grid import Octave, octaves, opaque
from tnst_mi.interrupt import Interrupt, deferred_interrupt
from tnst_mi.mask import soft_mask
from tnst_mi.objective import Objective
from tnst_mi.parameterisation import DensityOffset, Parameterisation, Transport
from tnst_mi.recipe import Recipe
from tnst_mi.resample import resample_density
from tnst_mi.views import sample_views

#: Layer whose features a content picture is matched in: deep enough for shapes rather than strokes.
CONTENT_LAYER = "inception_4d/output"


@dataclass(frozen=True)
class Progress:
    """Where an optimisation stands, reported after every iteration."""

    octave: int
    octaves: int
    iteration: int
    iterations: int
    loss: float
    terms: dict[str, float]


@dataclass
class Stylized:
    """Result of stylizing one frame.

    Attributes:
        density: d*, (D, H, W) float32, full resolution.
        velocity: v*, (D, H, W, 3) float32, full-resolution cells per frame; 0 for the density parameterisation.
        potential: (Φ, Ψ) at full resolution, None for an absent one.
        history: one dictionary per iteration: octave, iteration, loss, terms, seconds.
        interrupted: Ctrl-C ended the optimisation early; the result is what was reached.
        note: a remark for the user, such as for an empty frame.
        timings: seconds of each octave ("octave 0", ...) and in total.
    """

    density: np.ndarray
    velocity: np.ndarray
    potential: tuple[np.ndarray | None, np.ndarray | None] = (None, None)
    history: list[dict] = field(default_factory=list)
    interrupted: bool = False
    note: str | None = None
    timings: dict[str, float] = field(default_factory=dict)


def objective_of(recipe: Recipe) -> Objective:
    """The sum of the recipe's terms (paper Eq. 2): semantic, tag and content terms, and style terms."""
    recipe = recipe.updated({"style": recipe.style, "content": recipe.content}, "recipe: ", Path.cwd())
    semantic = [
        *(losses.Semantic(layer, channels, recipe.damping) for layer, channels in recipe.semantic_channels),
        *(losses.ClassTag(tag) for tag in recipe.tag),
        *(losses.Content(path, CONTENT_LAYER) for path in recipe.content),
    ]
    style = [losses.Style(path, recipe.style_layers) for path in recipe.style]
    weighted = [recipe.semantic_weight * term for term in semantic] + [recipe.style_weight * term for term in style]
    return Objective(pair for term in weighted for pair in term.weighted_terms)


def optimise(
    frame: Frame,
    recipe: Recipe,
    network: GoogLeNet,
    exposure: float | None = None,
    on_iteration: Callable[[Progress], None] | None = None,
    step_scale: float = 1.0,
    objective: Objective | None = None,
) -> Stylized:
    """Stylize one frame.

    Ctrl-C ends the optimisation after the current iteration; a second one at once.

    Args:
        frame: the frame; one that is empty or renders black comes back unchanged, with a note.
        recipe: what to stylize towards, and how.
        network: the GoogLeNet that judges the images; it is moved to the device of the active variant.
        exposure: factor from rendered images to the network's [0, 1]; None takes 1 / max of this frame's main view.
        on_iteration: called after every iteration.
        step_scale: factor of η for this frame, S_t / max_t S_t (the σ of paper Eq. 2; 1 for a single frame).
        objective: what to minimise, in place of the recipe's terms; for terms that no recipe can name, such as
            `losses.Match`.

    Raises:
        InputError: the network lacks a layer, channel or class, a picture cannot be used, or the loss is not finite.
    """
    start = time.perf_counter()
    brightest = float(main_view(frame.density, recipe).max())
    if not brightest > 0:
        state = f"renders black at gamma {recipe.gamma:g}" if frame.density.any() else "is empty"
        still = np.zeros((*frame.density.shape, 3), np.float32)
        return Stylized(frame.density.copy(), still, note=f"{frame.name} {state}: nothing to stylize, left unchanged")
    if exposure is None:
        exposure = 1 / brightest
    if recipe.parameterisation == "density":
        parameters = DensityOffset()
    else:
        parameters = Transport(recipe.lam, recipe.steps)
    network = network.to(torch_device())
    run = _Run(frame, recipe, network, objective or objective_of(recipe), exposure, step_scale, parameters)
    levels = octaves(frame.density.shape, recipe.octaves, recipe.scale_factor)
    result = Stylized(frame.density, frame.density)
    with deferred_interrupt() as interrupt:
        try:
            for index, octave in enumerate(levels):
                if not interrupt.requested:
                    begin = time.perf_counter()
                    run.enter(index, octave)
                    _iterate(run, index, len(levels), interrupt, result, on_iteration)
                    result.timings[f"octave {index}"] = time.perf_counter() - begin
        except KeyboardInterrupt:
            interrupt.requested = True
        result.interrupted = interrupt.requested
    run.finish(levels[-1], result)
    result.timings["total"] = time.perf_counter() - start
    return result


def _iterate(
    run: _Run,
    octave: int,
    octave_count: int,
    interrupt: Interrupt,
    result: Stylized,
    on_iteration: Callable[[Progress], None] | None,
) -> None:
    """The iterations of one octave, recorded in the history of the result."""
    count = run.recipe.iterations
    for iteration in range(count):
        if interrupt.requested:
            return
        since = time.perf_counter()
        loss, terms = run.iterate(octave, iteration)
        seconds = time.perf_counter() - since
        entry = {"octave": octave, "iteration": iteration, "loss": loss, "terms": terms, "seconds": seconds}
        result.history.append(entry)
        if on_iteration is not None:
            on_iteration(Progress(octave, octave_count, iteration, count, loss, terms))


class _Run:
    """State of the optimisation of one frame: its parameters, and what belongs to the current octave."""

    def __init__(
        self,
        frame: Frame,
        recipe: Recipe,
        network: GoogLeNet,
        objective: Objective,
        exposure: float,
        step_scale: float,
        parameters: Parameterisation,
    ) -> None:
        self.frame, self.recipe, self.network = frame, recipe, network
        self.exposure, self.eta = exposure, recipe.eta * step_scale
        self.parameters, self.objective = parameters, objective
        self.mask_full = soft_mask(frame.density, frame.obstacle)

    def enter(self, index: int, octave: Octave) -> None:
        """Set up an octave: grids, scene and style targets of its size."""
        recipe = self.recipe
        shape, h = octave.shape, octave.cell_size
        self.parameters.enter(octave)
        self.density = mi.TensorXf(resample_density(self.frame.density, 1.0, shape, h))
        self.mask = mi.TensorXf(resample_density(self.mask_full, 1.0, shape, h))
        self.scene = driving_scene(recipe, shape, h, recipe.views)
        self.loss = self.objective.bind(self.network, shape[1], shape[2])
        self.calibrated = False

    def iterate(self, octave: int, iteration: int) -> tuple[float, dict[str, float]]:
        """One step; returns the loss before it and the value of each term."""
        recipe = self.recipe
        seed = (recipe.seed, self.frame.number or 0, octave, iteration)
        views = sample_views(recipe.views, recipe.azimuth, recipe.elevation, seed)
        self.scene.reseed(seed)

        self.parameters.attach()
        density = self.parameters.density(self.density)

        # Two phases: the views accumulate their gradient on a copy of the density, which then goes back through the
        # transport once instead of once per view.
        seen = dr.detach(density)
        dr.enable_grad(seen)
        images = self.scene.render(seen, views) * opaque(self.exposure)
        loss = self._enter_torch(images)
        dr.backward(loss)

        dr.set_grad(density, dr.grad(seen))
        dr.enqueue(dr.ADMode.Backward, density)
        dr.traverse(dr.ADMode.Backward)
        self.parameters.descend(self.mask, self.eta, self.frame.density.shape[1], recipe.pyramid_levels)

        terms = {name: float(value) for name, value in self.loss.last_terms.items()}
        value = float(loss.array[0])
        if not math.isfinite(value):
            raise InputError(
                f"{self.frame.name}: the loss is {value} in iteration {iteration + 1} of octave {octave + 1}, "
                f"expected a finite number; try a smaller eta ({recipe.eta:g}) or gamma ({recipe.gamma:g})"
            )
        # `dr.wrap` ties the torch graph into reference cycles. Arrays outside Python's heap do not make the collector
        # run, so it is asked to look at the young objects, which costs little.
        del loss, images, seen, density
        gc.collect(1)
        return value, terms

    def _enter_torch(self, images: mi.TensorXf) -> mi.TensorXf:
        """The loss of a batch of images, differentiable through torch."""
        if not self.calibrated:
            self.loss.calibrate(dr.detach(images).torch().clone())
            self.calibrated = True

        @dr.wrap(source="drjit", target="torch")
        def loss(batch):  # noqa: ANN202
            return self.loss(batch)

        return loss(images)

    def finish(self, full: Octave, result: Stylized) -> None:
        """Apply the fields at full resolution to the unstylized frame."""
        self.parameters.enter(full)
        with dr.suspend_grad():
            density = self.parameters.density(mi.TensorXf(self.frame.density))
            result.density = np.maximum(density.numpy(), 0)
            if isinstance(self.parameters, Transport):
                result.velocity = self.parameters.velocity().numpy()
                fields = self.parameters.fields
                result.potential = tuple(fields[n].numpy() if n in fields else None for n in ("phi", "psi"))
            else:
                result.velocity = np.zeros((*self.frame.density.shape, 3), np.float32)

"""Stand-ins that make whole runs fast: an optimiser that doubles the density, and a network that is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from tnst_mi.frame import Frame
from tnst_mi.optimise import Progress, Stylized
from tnst_mi.recipe import Recipe
from tnst_mi.weights import ChosenWeights

SHAPE = (4, 6, 5)

#: Stands for the objective of any recipe.
OBJECTIVE = SimpleNamespace(bind=lambda network, height, width: None)


@dataclass
class FakeOptimiser:
    """Takes the place of `tnst_mi.optimise.optimise`: d* = 2 d, v* = (3, 4, 0); keeps how it was called."""

    POTENTIAL: ClassVar = (np.zeros(SHAPE, np.float32), None)

    calls: list[dict[str, Any]] = field(default_factory=list)
    interrupt_at: str = ""
    failure: BaseException | None = None

    def __call__(
        self,
        frame: Frame,
        recipe: Recipe,
        network: object,
        exposure: float | None,
        on_iteration: Callable[[Progress], None] | None,
        step_scale: float = 1.0,
        objective: object = None,
    ) -> Stylized:
        assert objective is OBJECTIVE
        self.calls.append({"name": frame.name, "recipe": recipe, "exposure": exposure, "step_scale": step_scale})
        if self.failure is not None:
            raise self.failure
        history = []
        for octave in range(recipe.octaves):
            for iteration in range(recipe.iterations):
                loss = 10.0 * octave - iteration
                terms = {"style": loss}
                history.append({"octave": octave, "iteration": iteration, "loss": loss, "terms": terms, "seconds": 0.0})
                on_iteration(Progress(octave, recipe.octaves, iteration, recipe.iterations, loss, terms))
        velocity = np.broadcast_to(np.float32([3, 4, 0]), (*frame.density.shape, 3))
        return Stylized(
            2.0 * frame.density,
            velocity,
            self.POTENTIAL,
            history=history,
            interrupted=frame.name == self.interrupt_at,
            note=None if frame.density.any() else "empty: unchanged",
            timings={"total": 0.5},
        )

    @property
    def names(self) -> list[str]:
        """Names of the frames, in the order of the calls."""
        return [call["name"] for call in self.calls]


@pytest.fixture
def optimiser(monkeypatch: pytest.MonkeyPatch) -> FakeOptimiser:
    """Runs take the fake optimiser and no network."""
    fake = FakeOptimiser()
    monkeypatch.setattr("tnst_mi.optimise.optimise", fake)
    monkeypatch.setattr("tnst_mi.optimise.objective_of", lambda recipe: OBJECTIVE)
    network = SimpleNamespace(source="none", sha256="0" * 64, flavour="bvlc")
    monkeypatch.setattr("tnst_mi.weights.find_weights", lambda source: ChosenWeights(Path(network.source), "bvlc"))
    monkeypatch.setattr("tnst_mi.googlenet.GoogLeNet.from_file", lambda path: network)
    return fake


def frames(*densities: float) -> list[Frame]:
    """Uniform frames of the given densities, numbered from 7."""
    return [
        Frame(np.full(SHAPE, density), name=f"f_{number:02d}", number=number)
        for number, density in enumerate(densities, start=7)
    ]

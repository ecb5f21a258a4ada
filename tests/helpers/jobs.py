"""Stand-ins that make whole runs fast: an optimiser that doubles the density, and a network that is none."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from tnst_mi.frame import Frame
from tnst_mi.optimisation import plan
from tnst_mi.optimisation.items.store import Store
from tnst_mi.optimisation.plan import Plan
from tnst_mi.optimisation.result import Progress, Stylized
from tnst_mi.run import job, prepare

SHAPE = (4, 6, 5)

#: Stands for the objective of any recipe.
OBJECTIVE = SimpleNamespace(bind=lambda network, height, width: SimpleNamespace(saved_bytes=1))


@dataclass
class FakeOptimiser:
    """Takes the place of `SequenceOptimisation`: d* = 2 d, v* = (3, 4, 0); keeps how it was called."""

    POTENTIAL: ClassVar = (np.zeros(SHAPE, np.float32), None)

    calls: list[dict[str, Any]] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    interrupt_at: str = ""
    failure: BaseException | None = None
    interrupted: bool = False

    def __call__(
        self, plan: Plan, frames: Sequence[Frame], network: object, store: Store, cache_bytes: int = 0
    ) -> FakeOptimiser:
        assert [frame.name for frame in frames] == [frame.name for frame in plan.frames]
        self.frames, self.recipe, self.store, self.interrupted = frames, plan.recipe, store, False
        self.calls.append(
            {
                "recipe": plan.recipe,
                "density_scale": plan.density_scale,
                "exposures": [frame.exposure for frame in plan.frames],
                "step_scales": [frame.step_scale for frame in plan.frames],
                "cache_bytes": cache_bytes,
            }
        )
        return self

    def run(
        self,
        on_iteration: Callable[[Progress], None],
        finished: Collection[int],
        on_octave: Callable[[Any], None] | None = None,
    ) -> Iterator[tuple[int, Stylized]]:
        recipe = self.recipe
        self.store.write("fields.0", 0, 0, {"phi": np.zeros(SHAPE, np.float32)})
        for index, frame in enumerate(self.frames):
            if index in finished:
                continue
            if self.failure is not None:
                raise self.failure
            if frame.name == self.interrupt_at:
                self.interrupted = True
                return
            self.names.append(frame.name)
            history = []
            for octave in range(recipe.octaves):
                for iteration in range(recipe.iterations):
                    loss = 10.0 * octave - iteration
                    terms = {"style": loss}
                    history.append(
                        {"octave": octave, "iteration": iteration, "loss": loss, "terms": terms, "seconds": 0.0}
                    )
                    on_iteration(
                        Progress(frame.name, octave, recipe.octaves, iteration, recipe.iterations, loss, terms, 1, 1)
                    )
            yield (
                index,
                Stylized(
                    2.0 * frame.density,
                    np.broadcast_to(np.float32([3, 4, 0]), (*frame.density.shape, 3)),
                    self.POTENTIAL,
                    history=history,
                    note=None if frame.density.any() else "empty: unchanged",
                    timings={"total": 0.5},
                    loss_before=4.0,
                    loss_after=3.0,
                    terms_before={"style": 8.0},
                    terms_after={"style": 6.0},
                ),
            )


@pytest.fixture
def optimiser(monkeypatch: pytest.MonkeyPatch) -> FakeOptimiser:
    """Runs take the fake optimiser and no network."""
    fake = FakeOptimiser()
    monkeypatch.setattr(job, "SequenceOptimisation", fake)
    for module in (prepare, plan):
        monkeypatch.setattr(module, "objective_of", lambda recipe: OBJECTIVE)
    network = SimpleNamespace(source="none", sha256="0" * 64, flavour="bvlc")
    monkeypatch.setattr(prepare, "load_network", lambda recipe: prepare.Network(network))
    return fake


def frames(*densities: float) -> list[Frame]:
    """Uniform frames of the given densities, numbered from 7."""
    return [
        Frame(np.full(SHAPE, density), name=f"f_{number:02d}", number=number)
        for number, density in enumerate(densities, start=7)
    ]

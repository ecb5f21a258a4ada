"""Small sequences, optimised as on a CPU or by the launches of a GPU."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from moving_smoke import moving_smoke

from tnst_mi.machine.host_copy import HostCopy
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.items.store import Store
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.optimisation.result import Progress, Stylized
from tnst_mi.optimisation.runner import SequenceOptimisation
from tnst_mi.recipe.recipe import Recipe

GOAL = {"semantic": ("inception_3a/3x3:2",), "lam": 1.0, "octaves": 1, "iterations": 4, "views": 3}


def run(
    network: GoogLeNet, count: int, store: Store, report: Callable[[Progress], None] | None = None, **changes: object
) -> list[Stylized]:
    frames = moving_smoke(count)
    names, numbers = [frame.name for frame in frames], [frame.number for frame in frames]
    plan = plan_of(Recipe(**GOAL | changes), names, numbers, [1.0] * count, [0.2] * count, frames[0].density.shape)
    return [result for _, result in SequenceOptimisation(plan, frames, network, store).run(report)]


def as_on_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same launches as on a GPU, and nothing is known to have arrived before it is asked for."""
    for module in ("fields.flow_advection", "fields.maccormack", "fields.pyramid", "rendering.renderer"):
        monkeypatch.setattr(f"tnst_mi.{module}.on_gpu", lambda: True)
    monkeypatch.setattr(HostCopy, "ready", property(lambda _: False))

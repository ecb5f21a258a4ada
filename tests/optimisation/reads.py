"""What the host reads in an iteration. Run by test_host.py in a process of its own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import torch
from crossings import counted_reads
from networks import random_googlenet
from sequences import as_on_a_gpu, run

from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.items.store import MemoryStore
from tnst_mi.optimisation.result import Progress


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> GoogLeNet:
    path = tmp_path_factory.mktemp("weights") / "random.safetensors"
    random_googlenet(path, narrow=8)
    return GoogLeNet.load(path)


@pytest.mark.parametrize(
    ("count", "window", "coherence", "keys"),
    [
        (1, 1, 0.0, {}),
        (3, 3, 0.0, {}),
        (3, 3, 0.5, {}),
        (1, 1, 0.0, {"transport": "flow"}),
        (3, 3, 0.5, {"transport": "flow", "conservative": True}),
    ],
)
def test_an_iteration_reads_nothing_but_its_loss_and_waits_for_nothing_but_torch(
    count: int, window: int, coherence: float, keys: dict, network: GoogLeNet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the first report to the last: three iterations of each frame but for the first one's own step."""
    as_on_a_gpu(monkeypatch)
    reports, found = 4 * count, list[Counter[str]]()
    with ExitStack() as counting:

        def note(progress: Progress) -> None:
            nonlocal reports
            reports -= 1
            if reports == 4 * count - 1:
                # The loss has been scaled by now, which reads more.
                found.append(counting.enter_context(counted_reads(monkeypatch)))
            elif reports == 0:
                counting.close()

        run(network, count, MemoryStore(), note, window=window, coherence=coherence, **keys)
    assert reports == 0
    (reads,) = found
    exchanges = {name for name in reads if name.startswith("exchange")}
    assert {name: n for name, n in reads.items() if name not in exchanges} == {"Tensor.numpy": 4 * count - 1}
    # The images of three views, the loss, and what is stored; with a window also the number of values beyond its range.
    stored = {"exchange 8x12x10"} | ({"exchange 1"} if count > 1 else set())
    assert exchanges == {"exchange 3x12x10", "exchange "} | stored


@pytest.mark.parametrize(
    "read",
    [
        lambda tensor: tensor.numpy(),
        lambda tensor: mi.TensorXf16(tensor).numpy(),
        np.asarray,
        lambda tensor: tensor[0],
        lambda tensor: tensor.array[0],
        lambda tensor: float(dr.sum(tensor.array)[0]),
        lambda tensor: bool(dr.any(tensor.array > 3)),
        lambda tensor: dr.compress(tensor.array > 3),
        lambda tensor: mi.Vector3f(tensor.array, 1, 2).numpy(),
        lambda tensor: mi.Vector3f(tensor.array, 1, 2).x[0],
        lambda tensor: str(tensor.array),
        lambda tensor: list(dr.sum(tensor.array)),
        lambda _: torch.ones(2).cpu(),
        lambda _: torch.ones(2).to("cpu"),
        lambda _: torch.ones(2).numpy(),
        lambda _: torch.ones(2).tolist(),
        lambda _: float(torch.ones(1)),
        lambda _: torch.ones(2).sum().item(),
        lambda _: bool(torch.ones(1)),
        lambda _: torch.equal(torch.ones(2), torch.ones(2)),
        lambda _: torch.ones(3)[torch.ones(3) > 0],
    ],
)
def test_reads_are_counted_or_refused(read: Callable[[mi.TensorXf], object], monkeypatch: pytest.MonkeyPatch) -> None:
    """The instrument of the test above."""
    tensor = mi.TensorXf(dr.arange(mi.Float, 100) * 1.5 + dr.opaque(mi.Float, 1))
    dr.eval(tensor)
    # Refused or not, nothing is on its way then: now and then Dr.Jit crashed where it had to refuse before it was done.
    dr.sync_thread()
    with pytest.raises((AssertionError, RuntimeError)), counted_reads(monkeypatch) as reads:
        read(tensor)
        assert not reads

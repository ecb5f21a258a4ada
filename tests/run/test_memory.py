"""What a run needs of memory: the estimate against what runs take, and what is said where it does not fit."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import pytest
import torch
from small_network import HEIGHT, WIDTH, SmallNetwork
from small_network import views as random_views

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.losses import evaluation
from tnst_mi.losses.terms import Semantic
from tnst_mi.run import memory
from tnst_mi.run.memory import Need, require_memory

RUN = """
import json, sys
import numpy as np
import tnst_mi
from tnst_mi.machine.environment import peak_memory
recipe = {"style": ["net"], "weights": "patterns", "octaves": 1, "iterations": 2, "views": 1, **json.loads(sys.argv[1])}
z, y, x = np.mgrid[:96, :144, :96]
density = np.float32(np.clip(30 - np.hypot(np.hypot(z - 48, y - 72), x - 48), 0, 1))
tnst_mi.stylize(density, recipe)
print(peak_memory())
"""


@pytest.mark.parametrize("keys", [{"transport": "step"}, {}, {"conservative": True}, {"colour": "style"}])
def test_a_run_takes_about_what_was_said(keys: dict) -> None:
    command = [sys.executable, "-c", RUN, json.dumps({"lam": 0.5} | keys)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    (said,) = [float(line.split()[2]) for line in done.stderr.splitlines() if line.startswith("memory: about")]
    assert int(done.stdout) == pytest.approx(1e9 * said, rel=0.2)


@pytest.mark.parametrize("rows", [150, 480])
def test_that_holds_where_octaves_are_coarser_than_the_frames(rows: int) -> None:
    """At two sizes, since what is taken per cell of a frame is another number than per cell of an octave."""
    done = subprocess.run(
        [sys.executable, "-c", RUN.replace("96, :144, :96", f"64, :{rows}, :64"), "{}"],
        capture_output=True,
        text=True,
        check=True,
    )
    (said,) = [float(line.split()[2]) for line in done.stderr.splitlines() if line.startswith("memory: about")]
    assert int(done.stdout) == pytest.approx(1e9 * said, rel=0.2)


@pytest.mark.parametrize("motif_size", ["cells", "auto", 0.4])
@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_what_would_fit_does_and_no_more(device: str, motif_size: str | float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "torch_device", lambda: torch.device(device))
    need = Need((100, 150, 120), tnst_mi.Recipe(style=("net",), motif_size=motif_size), 1, 2000.0, on_disk=True)
    process = memory.COSTS[device].process
    free = (process + need.total) // 2
    shape = need.largest_that_fits(free)

    def total(rows: int) -> int:
        return replace(need, shape=(100 * rows // 150, rows, 120 * rows // 150)).total

    assert total(shape[1]) <= free < total(shape[1] + 1)
    assert [n / m for n, m in zip(shape, need.shape, strict=True)] == pytest.approx([shape[1] / 150] * 3, abs=0.01)
    assert need.largest_that_fits(process) is None


def test_too_little_memory_is_said_before_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory.environment, "free_memory", lambda: 500_000_000)
    monkeypatch.setattr(memory.environment, "resident_memory", lambda: 100_000_000)
    with pytest.raises(
        InputError, match=r"160×240×160 cells need about 1\.\d GB and 0\.6 GB are free; \d+×\d+×\d+ cells"
    ):
        need = Need((160, 240, 160), tnst_mi.Recipe(style=("net",)), 1, 2000.0, on_disk=True)
        require_memory(need, memory.free_bytes())


def test_frames_that_are_kept_in_memory_count() -> None:
    recipe, shape = tnst_mi.Recipe(style=("net",), window=5), (64, 96, 64)
    kept = [Need(shape, recipe, count, 2000.0, on_disk=False).total for count in (1, 11)]
    assert kept[1] - kept[0] == pytest.approx(memory.working_bytes(shape, 10, recipe), rel=1e-6)
    assert len({Need(shape, recipe, count, 2000.0, on_disk=True).total for count in (1, 11)}) == 1


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_items_are_kept_in_a_share_of_what_is_left_and_no_more_than_there_are(
    device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "torch_device", lambda: torch.device(device))
    recipe, shape = tnst_mi.Recipe(style=("net",), window=5), (64, 96, 64)
    need = Need(shape, recipe, 11, 2000.0, on_disk=True)
    share = {"cpu": 4, "cuda": 2}[device]
    assert memory.cache_bytes(need, need.total + 8_000_000, 11, recipe) == 8_000_000 // share
    assert memory.cache_bytes(need, need.total + 10**12, 11, recipe) == memory.working_bytes(shape, 11, recipe)
    alone = replace(recipe, window=1)
    assert memory.cache_bytes(need, need.total + 10**12, 11, alone) == memory.working_bytes(shape, 1, alone)
    assert memory.cache_bytes(need, need.total - 1, 11, recipe) == 0


def test_saved_bytes_are_the_feature_maps_that_derivatives_need() -> None:
    net = SmallNetwork()
    bound = Semantic("shallow", (1,)).bind(net, HEIGHT, WIDTH)
    # By pixel: the grey input of the first convolution, the output of tanh (4 channels), the same with 0.2 added as the
    # input of the second convolution, and the output of the second tanh (6 channels, a quarter of the pixels).
    assert bound.saved_bytes == pytest.approx(8 * HEIGHT * WIDTH * (1 + 4 + 4 + 6 / 4), rel=1e-3)
    assert Semantic("shallow", (1,)).bind(net, 2 * HEIGHT, WIDTH).saved_bytes == pytest.approx(
        2 * bound.saved_bytes, rel=1e-3
    )


@pytest.mark.parametrize(("batch", "parts"), [(1, 5), (2.5, 3), (4, 2), (5, 1), (0.1, 5)])
def test_views_in_parts_have_the_value_and_gradient_of_all(
    batch: float, parts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    net = SmallNetwork()
    whole, count = Semantic("deep", (1,)).bind(net, HEIGHT, WIDTH), 5
    monkeypatch.setattr(evaluation, "LARGEST_BATCH", batch * whole.saved_bytes)
    at_once = evaluation.views_at_once(count, whole.saved_bytes)
    assert -(-count // at_once) == parts

    images = random_views(count).requires_grad_()
    (expected,) = torch.autograd.grad(whole(images), images)
    net.asked.clear()
    # As a device that is no CPU would have it.
    seen_at_once = list(whole._parts(images.detach().to("meta")))
    monkeypatch.setattr(whole, "_parts", lambda images: seen_at_once)
    (gradient,) = torch.autograd.grad(whole(images), images)
    assert len(net.asked) == parts
    torch.testing.assert_close(gradient, expected, rtol=1e-12, atol=1e-15)


def test_a_gpu_would_see_a_batch_of_bounded_size() -> None:
    for fitting, at_once in ((7.7, 5), (9.0, 9), (900.0, 9), (8.9, 5), (0.2, 1)):
        assert evaluation.views_at_once(9, evaluation.LARGEST_BATCH / fitting) == at_once

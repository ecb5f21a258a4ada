"""What an iteration costs the host: what it reads from the device and the store, and how many kernels it launches."""

from __future__ import annotations

import dataclasses
import errno
import subprocess
import sys
import threading
from collections import Counter
from pathlib import Path

import drjit as dr
import numpy as np
import pytest
from moving_smoke import moving_smoke
from sequences import GOAL, as_on_a_gpu, run
from torch import nan

from tnst_mi.errors import InputError
from tnst_mi.machine.backend import on_gpu
from tnst_mi.machine.host_copy import HostCopy
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.gradient import Evaluation, OctaveProblem
from tnst_mi.optimisation.items.store import FolderStore, MemoryStore
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.optimisation.result import Progress
from tnst_mi.optimisation.runner import SequenceOptimisation
from tnst_mi.recipe.recipe import Recipe


def test_an_iteration_reads_nothing_but_its_loss() -> None:
    """In a process of its own: types whose methods have been replaced for counting do not become what they were."""
    file = Path(__file__).with_name("reads.py")
    command = [sys.executable, "-m", "pytest", "-o", "addopts=", "-p", "no:cacheprovider", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "26 passed" in done.stdout


def launches(network: GoogLeNet, views: int, count: int) -> int:
    """Dr.Jit's launches of kernels in the second iteration of a sequence, with all frames in a window."""
    found: list[int] = []

    def note(_: Progress) -> None:
        found.append(len(dr.kernel_history([dr.KernelType.JIT])))
        dr.kernel_history_clear()

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        run(network, count, MemoryStore(), note, views=views, window=count)
    return sum(found[count : 2 * count])


@pytest.mark.parametrize(("count", "most"), [(1, 38), (3, 142)])
def test_kernels_of_an_iteration_are_few_and_do_not_depend_on_the_views(
    count: int, most: int, network: GoogLeNet, monkeypatch: pytest.MonkeyPatch
) -> None:
    as_on_a_gpu(monkeypatch)
    few, many = (launches(network, views, count) for views in (2, 9))
    assert few == many == most


# --------------------------------------------------------------------
# Reading the loss later
# --------------------------------------------------------------------


@pytest.mark.parametrize(("count", "window"), [(1, 1), (3, 1), (3, 3)])
def test_reading_the_loss_later_changes_nothing_but_when(
    count: int, window: int, network: GoogLeNet, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once: list[Progress] = []
    later: list[Progress] = []
    one = run(network, count, MemoryStore(), at_once.append, window=window, octaves=2)
    monkeypatch.setattr(HostCopy, "ready", property(lambda _: False))
    other = run(network, count, MemoryStore(), later.append, window=window, octaves=2)
    assert at_once == later
    for a, b in zip(one, other, strict=True):
        assert a.density.tobytes() == b.density.tobytes() and a.velocity.tobytes() == b.velocity.tobytes()
        losses = [[(entry["octave"], entry["iteration"], entry["loss"]) for entry in r.history] for r in (a, b)]
        assert losses[0] == losses[1] and len(losses[0]) == 8


@pytest.mark.parametrize(("count", "window"), [(1, 1), (3, 3)])
@pytest.mark.parametrize("ready", [True, False])
def test_nothing_is_stored_that_follows_from_a_loss_that_is_not_finite(
    ready: bool, count: int, window: int, network: GoogLeNet, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The third evaluation of a frame fails; the run goes on later, and ends as one in which it did not."""
    expected = run(network, count, MemoryStore(), window=window)
    monkeypatch.setattr(HostCopy, "ready", property(lambda _: ready))
    calls: list[object] = []
    gradient = OctaveProblem.gradient

    def broken(*arguments: object) -> Evaluation:
        calls.append(arguments)
        found = gradient(*arguments)
        return dataclasses.replace(found, loss=found.loss * nan) if len(calls) == 2 * count + 1 else found

    monkeypatch.setattr(OctaveProblem, "gradient", broken)
    # Every fields are due to be written.
    monkeypatch.setattr("tnst_mi.optimisation.items.state.CHECKPOINT_SECONDS", 0.0)
    with pytest.raises(InputError, match=r"iteration 3 of octave 1: the loss is nan, .* smaller eta \(0.002\)"):
        run(network, count, FolderStore(tmp_path), window=window)
    monkeypatch.setattr(OctaveProblem, "gradient", gradient)
    store = FolderStore(tmp_path)
    assert {store.generation("fields.0", frame) for frame in range(count)} == {2}
    resumed = run(network, count, store, window=window)
    for a, b in zip(expected, resumed, strict=True):
        assert a.density.tobytes() == b.density.tobytes()


@pytest.mark.parametrize("finite", [True, False])
@pytest.mark.parametrize(("count", "window"), [(1, 1), (3, 3)])
def test_ctrl_c_while_a_loss_is_waited_for_loses_nothing_and_stores_nothing_unchecked(
    count: int, window: int, finite: bool, network: GoogLeNet, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A second Ctrl-C, which is obeyed at once: on a GPU the host spends its time in that waiting."""
    as_on_a_gpu(monkeypatch)
    expected = run(network, count, MemoryStore(), window=window)
    waits: list[object] = []
    numpy, gradient = HostCopy.numpy, OctaveProblem.gradient
    calls: list[object] = []

    def interrupted(copy: HostCopy) -> np.ndarray:
        if threading.current_thread() is threading.main_thread():
            waits.append(copy)
            if len(waits) == count + 1:
                raise KeyboardInterrupt
        return numpy(copy)

    def broken(*arguments: object) -> Evaluation:
        calls.append(arguments)
        found = gradient(*arguments)
        return dataclasses.replace(found, loss=found.loss * nan) if len(calls) == count + 1 and not finite else found

    monkeypatch.setattr(HostCopy, "numpy", interrupted)
    monkeypatch.setattr(OctaveProblem, "gradient", broken)
    first: list[Progress] = []
    if finite:
        run(network, count, FolderStore(tmp_path), first.append, window=window)
        assert len(first) == count + 1
    else:
        with pytest.raises(InputError, match="iteration 2 of octave 1: the loss is nan"):
            run(network, count, FolderStore(tmp_path), first.append, window=window)
    monkeypatch.setattr(OctaveProblem, "gradient", gradient)
    store, again = FolderStore(tmp_path), list[Progress]()
    assert max(store.generation("fields.0", frame) for frame in range(count)) <= 1 + finite
    resumed = run(network, count, store, again.append, window=window)
    for a, b in zip(expected, resumed, strict=True):
        assert a.density.tobytes() == b.density.tobytes()
        assert [entry["iteration"] for entry in b.history] == [0, 1, 2, 3]
    if finite:
        reported = [(progress.frame, progress.iteration) for progress in (*first, *again)]
        assert len(reported) == len(set(reported)) == 4 * count


def test_an_optimisation_can_be_run_again(network: GoogLeNet, tmp_path: Path) -> None:
    """Interrupted, and once more: it goes on where it stopped."""
    frames = moving_smoke(1)
    plan = plan_of(Recipe(**GOAL), [frames[0].name], [5], [1.0], [0.2], frames[0].density.shape)
    optimisation = SequenceOptimisation(plan, frames, network, FolderStore(tmp_path))

    def interrupt(progress: Progress) -> None:
        if progress.iteration == 1:
            raise KeyboardInterrupt

    ((_, half),) = optimisation.run(interrupt)
    ((_, whole),) = optimisation.run()
    assert half.interrupted and len(half.history) in range(2, 3 + on_gpu())
    assert len(whole.history) == 4
    assert whole.density.tobytes() == run(network, 1, MemoryStore())[0].density.tobytes()


class Filling(FolderStore):
    """A disk that is full for one write, and has room again for smaller ones."""

    def __init__(self, folder: Path, room: int) -> None:
        super().__init__(folder)
        self.room = room

    def write(self, *arguments: object) -> None:
        self.room -= 1
        if self.room == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().write(*arguments)


@pytest.mark.parametrize("window", [1, 3])
def test_a_run_whose_disk_was_full_goes_on_to_the_same_bits(
    window: int, network: GoogLeNet, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Whatever item did not fit. Of what would have been written after it, nothing may be there."""
    monkeypatch.setattr("tnst_mi.optimisation.items.state.CHECKPOINT_SECONDS", 0.0)
    changes = {"window": window, "octaves": 2, "iterations": 2, "views": 1}
    expected = [result.density.tobytes() for result in run(network, 3, MemoryStore(), **changes)]
    for room in range(1, 100, 2):
        folder = tmp_path / str(room)
        store = Filling(folder, room)
        try:
            run(network, 3, store, **changes)
        except OSError:
            resumed = run(network, 3, FolderStore(folder), **changes)
            assert [result.density.tobytes() for result in resumed] == expected, room
        if store.room > 0:
            break
    assert room > 20


# --------------------------------------------------------------------
# Reading from the store
# --------------------------------------------------------------------


class Counting(FolderStore):
    """Counts how often each array is read."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.reads: Counter[tuple[str, int, str]] = Counter()

    def read(
        self, group: str, frame: int, names: object = None, generation: int | None = None
    ) -> dict[str, np.ndarray]:
        found = super().read(group, frame, names, generation)
        self.reads.update((group, frame, name) for name in found)
        return found


def reads_of_an_iteration(network: GoogLeNet, folder: Path, budget: int) -> Counter[tuple[str, int, str]]:
    """What a sequence of nine frames with a window of five reads from the store in its third iteration, by array."""
    frames, store = moving_smoke(9), Counting(folder)
    names, numbers = [frame.name for frame in frames], [frame.number for frame in frames]
    plan = plan_of(Recipe(**GOAL | {"window": 5}), names, numbers, [1.0] * 9, [0.2] * 9, frames[0].density.shape)
    seen: list[Counter[tuple[str, int, str]]] = []

    def note(progress: Progress) -> None:
        if progress.frame == names[0]:
            seen.append(store.reads.copy())

    for _ in SequenceOptimisation(plan, frames, network, store, budget).run(note):
        pass
    return seen[3] - seen[2]


def test_a_window_is_read_once_where_it_fits_on_the_device_and_nothing_where_all_does(
    network: GoogLeNet, tmp_path: Path
) -> None:
    cells = int(np.prod(moving_smoke(1)[0].density.shape))
    everything = reads_of_an_iteration(network, tmp_path / "all", 10**9)
    assert not everything
    # Steps (2 bytes a cell) and velocities (6) of a window, what else a frame needs, and what is read ahead.
    window = reads_of_an_iteration(network, tmp_path / "window", (5 + 1) * 8 * cells + 2 * 14 * cells)
    nothing = reads_of_an_iteration(network, tmp_path / "nothing", 0)
    transported = {key for key in nothing if key[0] == "step.0" or key[2] == "velocity"}
    assert {window[key] for key in transported} <= {0, 1}
    assert max(nothing[key] for key in transported) == 5

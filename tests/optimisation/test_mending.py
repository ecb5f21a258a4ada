"""Every item of the working state damaged in turn: what is lost is made anew, and the bits are the same.

The run of a window has two octaves of two iterations for three frames; it is stopped in each octave, where frames have
been through different numbers of iterations.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from moving_smoke import moving_smoke
from networks import random_googlenet

from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.items.store import DamagedItemError, FolderStore, MemoryStore, Store
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.optimisation.result import Progress
from tnst_mi.optimisation.runner import SequenceOptimisation
from tnst_mi.recipe.recipe import Recipe

GOAL = {"semantic": ("inception_3a/3x3:2",), "octaves": 2, "iterations": 2, "views": 1, "lam": 0.5, "coherence": 1.0}
COUNT = 3


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> GoogLeNet:
    return GoogLeNet.load(random_googlenet(tmp_path_factory.mktemp("weights") / "random.safetensors", narrow=8))


def optimise(
    network: GoogLeNet, store: Store, window: int, report: Callable[[Progress], None] | None = None, cache: int = 0
) -> dict[int, object]:
    """The bits and losses of each frame; nothing is kept on the device, so that every item is read."""
    frames = moving_smoke(COUNT)
    names, numbers = [frame.name for frame in frames], [frame.number for frame in frames]
    recipe = Recipe(**GOAL | {"window": window} | ({"coherence": 0.0} if window == 1 else {}))
    plan = plan_of(recipe, names, numbers, [1.0] * COUNT, [0.2] * COUNT, frames[0].density.shape)
    run = SequenceOptimisation(plan, frames, network, store, cache_bytes=cache)
    return {
        index: (result.density.tobytes(), result.velocity.tobytes(), [entry["loss"] for entry in result.history])
        for index, result in run.run(report)
    }


def stopped(network: GoogLeNet, folder: Path, window: int, after: int) -> None:
    """Leave the state of a run that was stopped after some of its twelve iterations of a frame."""

    def stop(progress: Progress) -> None:
        if progress.done == after:
            raise KeyboardInterrupt

    assert optimise(network, FolderStore(folder), window, stop) == {}


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-3])


def swapped(path: Path) -> None:
    """Another item of the same group takes its place; where there is none, one of another group."""
    others = [*sorted(path.parent.glob("*.safetensors")), *sorted(path.parent.parent.glob("*/*.safetensors"))]
    path.write_bytes(next(other.read_bytes() for other in others if other != path))


@pytest.fixture(scope="module")
def expected(network: GoogLeNet) -> dict[int, dict[int, object]]:
    return {window: optimise(network, MemoryStore(), window) for window in (1, 3)}


@pytest.mark.parametrize("damage", [truncated, swapped, Path.unlink])
@pytest.mark.parametrize(("window", "after"), [(1, 7), (3, 5), (3, 11)])
def test_whatever_item_is_damaged_the_bits_are_the_same(
    window: int,
    after: int,
    damage: Callable[[Path], object],
    network: GoogLeNet,
    expected: dict[int, dict[int, object]],
    tmp_path: Path,
) -> None:
    stopped(network, tmp_path / "left", window, after)
    items = sorted(path.relative_to(tmp_path / "left") for path in (tmp_path / "left").glob("*/*.safetensors"))
    assert {item.parts[0].split(".")[0] for item in items} >= (
        {"inputs", "fields"} if window == 1 else {"gain", "step"}
    )
    # Of every kind of item one, another one for each kind of damage.
    shift = [truncated, swapped, Path.unlink].index(damage)
    for group in sorted({item.parent for item in items}):
        of_group = [item for item in items if item.parent == group]
        item = of_group[shift % len(of_group)]
        folder, said = tmp_path / group.name, []
        shutil.copytree(tmp_path / "left", folder)
        damage(folder / item)
        assert optimise(network, FolderStore(folder, say=said.append), window) == expected[window], item
        # What no frame needs any more may be damaged unseen; what is not there is made without a word, if it can be.
        assert all("was damaged; " in remark for remark in said) and len(said) <= 1


def test_what_is_said_of_damage(network: GoogLeNet, expected: dict[int, dict[int, object]], tmp_path: Path) -> None:
    stopped(network, tmp_path / "left", 3, 11)
    for name, told in (
        ("inputs.1/000001.000000.safetensors", "inputs.1 of s_006 was damaged; it is made anew"),
        ("fields.1/000002.000001.safetensors", "fields.1 of s_007 was damaged; octave 2 begins again"),
        ("numbers.json", "numbers.json was damaged; the run begins anew"),
    ):
        folder, said = tmp_path / name[:6], []
        shutil.copytree(tmp_path / "left", folder)
        truncated(folder / name)
        assert optimise(network, FolderStore(folder, say=said.append), 3) == expected[3]
        assert said == [f"note: {folder}: {told}"]


@pytest.mark.parametrize("lost", ["fields.0", "fields.1", "inputs.1", "step.1", "gain.1", "numbers.json", ""])
def test_whatever_is_lost_the_bits_are_the_same(
    lost: str, network: GoogLeNet, expected: dict[int, dict[int, object]], tmp_path: Path
) -> None:
    stopped(network, tmp_path, 3, 11)
    path = tmp_path / lost
    path.unlink() if path.is_file() else shutil.rmtree(path)
    assert optimise(network, FolderStore(tmp_path), 3) == expected[3]


def test_the_state_of_another_run_is_not_taken_for_its_own(
    network: GoogLeNet, expected: dict[int, dict[int, object]], tmp_path: Path
) -> None:
    stopped(network, tmp_path, 3, 11)
    assert optimise(network, FolderStore(tmp_path, run="another"), 3) == expected[3]


def test_a_disk_that_does_not_keep_what_is_written_ends_the_run(network: GoogLeNet, tmp_path: Path) -> None:
    class Forgetful(FolderStore):
        def write(self, group: str, frame: int, generation: int, arrays: dict, durable: bool = False) -> None:
            super().write(group, frame, generation, arrays, durable)
            if (group, frame) == ("inputs.0", 1):
                truncated(self._path(group, frame, generation))

    with pytest.raises(
        DamagedItemError, match=r"inputs\.0/000001\.000000\.safetensors: damaged .*; --resume makes anew"
    ):
        optimise(network, Forgetful(tmp_path), 3)


@pytest.mark.parametrize("lost", ["all", "one line"])
def test_a_damaged_log_changes_no_bits_and_is_told(
    lost: str, network: GoogLeNet, expected: dict[int, dict[int, object]], tmp_path: Path
) -> None:
    stopped(network, tmp_path, 3, 11)
    log, said = tmp_path / "metrics.jsonl", []
    if lost == "all":
        log.unlink()
    else:
        log.write_text(log.read_text().replace('"loss": ', '"loss": 9', 1))
    results = optimise(network, FolderStore(tmp_path, say=said.append), 3)
    for index, (density, velocity, losses) in results.items():
        whole = expected[3][index]
        assert (density, velocity) == whole[:2] and set(losses) <= set(whole[2])
    told = f"note: {tmp_path}: metrics.jsonl was damaged; {{}} of 4 iterations of {{}} are left out of the losses"
    missing = {"all": 4, "one line": 1}[lost]
    assert said[0].startswith(told.format(missing, "s_005")) and len(said) == (3 if lost == "all" else 1)

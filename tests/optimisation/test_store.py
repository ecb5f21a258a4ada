"""The working state: what is written is read, generations replace each other, and killed runs leave no damage."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.optimisation.items.store import DamagedItemError, FolderStore, MemoryStore, Store


@pytest.fixture(params=["memory", "folder"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    return MemoryStore() if request.param == "memory" else FolderStore(tmp_path / "work")


def arrays(value: float) -> dict[str, np.ndarray]:
    return {"phi": np.full((2, 3), value, np.float32), "psi": np.full((2, 3, 3), value, np.float32)}


def test_items_are_kept_by_group_and_frame(store: Store) -> None:
    assert store.generation("fields.0", 3) == -1
    store.write("fields.0", 3, 0, arrays(1 / 3))
    store.write("fields.0", 4, 7, arrays(2))
    store.write("step.0", 3, 1, arrays(5))
    assert [store.generation("fields.0", frame) for frame in (3, 4, 5)] == [0, 7, -1]
    item = store.read("fields.0", 3)
    assert item["phi"].tobytes() == np.full((2, 3), 1 / 3, np.float32).tobytes() and item["psi"].shape == (2, 3, 3)
    store.write("fields.0", 3, 1, arrays(9))
    assert store.generation("fields.0", 3) == 1 and store.read("fields.0", 3)["phi"][0, 0] == 9
    store.remove("fields.0")
    store.remove("fields.0")
    assert store.generation("fields.0", 3) == -1 and store.generation("step.0", 3) == 1


def test_arrays_are_read_in_the_precision_in_which_they_were_written(store: Store) -> None:
    store.write("inputs.0", 0, 0, {"mask": np.float16([0, 0.1, 1]), "density": np.float32([0.1])})
    item = store.read("inputs.0", 0)
    assert (item["mask"].dtype, item["density"].dtype) == (np.float16, np.float32)
    np.testing.assert_array_equal(item["mask"], np.float16([0, 0.1, 1]))
    assert list(store.read("inputs.0", 0, ["density"])) == ["density"]


def test_numbers_and_log(store: Store) -> None:
    assert store.numbers("scales.0") is None and store.entries("a") == []
    store.write_numbers("scales.0", {"style": 1 / 3})
    store.write_numbers("scales.1", {"style": 1e-12})
    assert store.numbers("scales.0") == {"style": 1 / 3}
    store.log({"frame": "a", "loss": 0.1})
    store.log({"frame": "b", "loss": 0.2})
    store.log({"frame": "a", "loss": 0.3})
    assert store.entries("a") == [{"frame": "a", "loss": 0.1}, {"frame": "a", "loss": 0.3}]
    assert store.entries("b") == [{"frame": "b", "loss": 0.2}]


def test_another_process_finds_the_state(tmp_path: Path) -> None:
    store = FolderStore(tmp_path)
    store.write("fields.0", 1, 4, arrays(3))
    store.write_numbers("scales.0", {"style": 2.0})
    store.log({"frame": "a"})
    again = FolderStore(tmp_path)
    assert again.generation("fields.0", 1) == 4 and again.read("fields.0", 1)["phi"][0, 0] == 3
    assert (again.numbers("scales.0"), again.entries("a")) == ({"style": 2.0}, [{"frame": "a"}])


def test_the_log_is_parsed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many frames ask for theirs: parsed for each, it would take the square of their number."""
    store, parsed, loads = FolderStore(tmp_path), [], json.loads
    for frame in range(20):
        store.log({"frame": f"f_{frame}"})
    monkeypatch.setattr(json, "loads", lambda line: parsed.append(line) or loads(line))
    for frame in range(20):
        store.log({"frame": f"f_{frame}", "again": True})
        assert store.entries(f"f_{frame}") == [{"frame": f"f_{frame}"}, {"frame": f"f_{frame}", "again": True}]
    assert len([line for line in parsed if line]) == 21


def test_what_a_killed_run_leaves_does_no_harm(tmp_path: Path) -> None:
    """Two generations of an item, an unfinished file, a torn line of the log."""
    store = FolderStore(tmp_path)
    store.write("fields.0", 1, 4, arrays(3))
    earlier = (tmp_path / "fields.0" / "000001.000004.safetensors").read_bytes()
    store.write("fields.0", 1, 5, arrays(6))
    (tmp_path / "fields.0" / "000001.000004.safetensors").write_bytes(earlier)
    unfinished = tmp_path / "fields.0" / ".tnst_mi-000001.000006.99.safetensors"
    unfinished.write_bytes(earlier[:20])
    store.log({"frame": "a"})
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('\n{"frame": "b", "lo')
    again = FolderStore(tmp_path)
    assert again.generation("fields.0", 1) == 5 and again.read("fields.0", 1)["phi"][0, 0] == 6
    again.log({"frame": "c"})
    assert [again.entries(frame) for frame in "abc"] == [[{"frame": "a"}], [], [{"frame": "c"}]]
    assert not unfinished.exists()
    # Others may still need the earlier generation, until there is a later one.
    assert again.has("fields.0", 1, 4) and again.read("fields.0", 1, generation=4)["phi"][0, 0] == 3
    again.write("fields.0", 1, 6, arrays(7))
    assert [path.name for path in tmp_path.glob("*/*")] == ["000001.000006.safetensors"]


def an_item(folder: Path, group: str = "fields.0", frame: int = 1, generation: int = 4) -> Path:
    return folder / group / f"{frame:06d}.{generation:06d}.safetensors"


def flipped(path: Path) -> None:
    """One bit of the contents of the last array."""
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(b"\xff" * 100),
        lambda path: path.write_bytes(path.read_bytes()[:-5]),
        lambda path: path.write_bytes(bytes(path.stat().st_size)),
        lambda path: path.unlink(),
        flipped,
    ],
    ids=["empty", "other", "truncated", "zeros", "removed", "flipped"],
)
def test_damaged_items_are_found(damage: Callable[[Path], object], tmp_path: Path) -> None:
    store = FolderStore(tmp_path)
    store.write("fields.0", 1, 4, arrays(3))
    damage(an_item(tmp_path))
    with pytest.raises(DamagedItemError, match=r"000001\.000004\.safetensors: damaged .*; --resume makes anew") as told:
        store.read("fields.0", 1)
    assert (told.value.group, told.value.frame) == ("fields.0", 1)


def test_items_in_the_place_of_others_are_found(tmp_path: Path) -> None:
    """Of another frame, group, generation or run, each whole in itself."""
    store = FolderStore(tmp_path / "a", run="a")
    for group, frame, generation in (("fields.0", 1, 4), ("fields.0", 2, 4), ("fields.1", 1, 4), ("fields.0", 3, 5)):
        store.write(group, frame, generation, arrays(3))
    other = FolderStore(tmp_path / "b", run="b")
    other.write("fields.0", 1, 4, arrays(3))
    whole = an_item(tmp_path / "a").read_bytes()
    for path in (
        *(
            an_item(tmp_path / "a", frame=2),
            an_item(tmp_path / "a", "fields.1"),
            an_item(tmp_path / "a", "fields.0", 3, 5),
        ),
        an_item(tmp_path / "b"),
    ):
        an_item(tmp_path / "a").write_bytes(path.read_bytes())
        with pytest.raises(DamagedItemError, match=r"the checksum of .* is another"):
            store.read("fields.0", 1)
    an_item(tmp_path / "a").write_bytes(whole)
    assert store.read("fields.0", 1)["phi"][0, 0] == 3


def test_damaged_numbers_are_found(tmp_path: Path) -> None:
    store = FolderStore(tmp_path)
    store.write_numbers("scales.0", {"style": 2.0})
    text = (tmp_path / "numbers.json").read_text()
    for damaged in ("", "{", "[]", "7", "{}", text.replace("2.0", "2.5")):
        (tmp_path / "numbers.json").write_text(damaged)
        with pytest.raises(DamagedItemError, match=r"numbers\.json: damaged"):
            store.numbers("scales.0")
    (tmp_path / "numbers.json").write_text(text)
    assert store.numbers("scales.0") == {"style": 2.0} and store.numbers("scales.1") is None


def test_items_and_groups_are_removed(store: Store) -> None:
    for group in ("fields.0", "step.0"):
        for frame in (0, 1):
            store.write(group, frame, 1, arrays(frame))
    store.write_numbers("scales.0", {"style": 2.0})
    store.discard("step.0", 1)
    store.discard("step.0", 7)
    assert [store.generation("step.0", frame) for frame in (0, 1)] == [1, -1]
    store.clear()
    assert store.generation("fields.0", 0) == store.generation("step.0", 0) == -1 and store.numbers("scales.0") is None


def test_a_removal_that_was_killed_is_completed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No part of the group is left for those who come later."""
    store = FolderStore(tmp_path)
    for frame in (0, 1):
        store.write("fields.0", frame, 1, arrays(frame))
    with monkeypatch.context() as patch:
        patch.setattr("shutil.rmtree", lambda path: (_ for _ in ()).throw(OSError("killed")))
        with pytest.raises(OSError, match="killed"):
            store.remove("fields.0")
    again = FolderStore(tmp_path)
    assert again.generation("fields.0", 0) == again.generation("fields.0", 1) == -1
    assert list(tmp_path.iterdir()) == []


def test_damaged_lines_of_the_log_are_left_out(tmp_path: Path) -> None:
    store = FolderStore(tmp_path)
    store.log({"frame": "a"})
    with (tmp_path / "metrics.jsonl").open("ab") as file:
        file.write(b"\n\xff\xfe\n[1]\n3\n" + b"[" * 100_000)
    store.log({"frame": "c"})
    assert FolderStore(tmp_path).entries("a") == [{"frame": "a"}] and store.entries("c") == [{"frame": "c"}]


def test_whatever_a_decoder_raises_means_damage(tmp_path: Path) -> None:
    """Types that numpy does not have, unless another package adds them, and keys that cannot be sorted."""
    store = FolderStore(tmp_path)
    store.write("fields.0", 1, 4, arrays(3))
    whole = an_item(tmp_path).read_bytes()
    size = int.from_bytes(whole[:8], "little")
    for kind, bits in (("BF16", 16), ("F8_E4M3", 8), ("F8_E5M2", 8)):
        header = json.loads(whole[8 : 8 + size])
        header["phi"] |= {"dtype": kind, "shape": [6 * 32 // bits]}
        text = json.dumps(header).encode()
        an_item(tmp_path).write_bytes(len(text).to_bytes(8, "little") + text + whole[8 + size :])
        with pytest.raises(DamagedItemError):
            store.read("fields.0", 1)
    (tmp_path / "numbers.json").write_text('[["checksum", 1], [1, 2], ["a", 2]]')
    with pytest.raises(DamagedItemError, match=r"numbers\.json: damaged"):
        store.numbers("scales.0")


def test_folders_in_the_place_of_files_are_removed_and_files_in_that_of_folders(tmp_path: Path) -> None:
    store = FolderStore(tmp_path)
    store.write("fields.0", 1, 4, arrays(3))
    an_item(tmp_path).unlink()
    for path in (an_item(tmp_path), tmp_path / "numbers.json", tmp_path / "metrics.jsonl"):
        (path / "deep").mkdir(parents=True)
    (tmp_path / "step.0").touch()
    with pytest.raises(DamagedItemError):
        store.read("fields.0", 1)
    with pytest.raises(DamagedItemError):
        store.numbers("scales.0")
    store.discard("fields.0", 1)
    assert not an_item(tmp_path).exists()
    an_item(tmp_path).mkdir()
    again = FolderStore(tmp_path)
    assert again.generation("fields.0", 1) == -1 and again.numbers("scales.0") is None and again.entries("a") == []
    again.write("step.0", 1, 1, arrays(5))
    again.log({"frame": "a"})
    assert FolderStore(tmp_path).entries("a") == [{"frame": "a"}]


def test_too_many_open_files_are_no_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = FolderStore(tmp_path)
    store.write("fields.0", 1, 4, arrays(3))

    def exhausted(*_: object, **__: object) -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr("tnst_mi.optimisation.items.item.safe_open", exhausted)
    with pytest.raises(OSError, match="Too many open files"):
        store.read("fields.0", 1)


def test_lines_of_the_log_that_were_changed_or_are_of_another_run_are_left_out(tmp_path: Path) -> None:
    store = FolderStore(tmp_path, run="a")
    for loss in (0.1, 0.2):
        store.log({"frame": "a", "loss": loss})
    path = tmp_path / "metrics.jsonl"
    path.write_text(path.read_text().replace("0.1", "0.7"))
    assert FolderStore(tmp_path, run="a").entries("a") == [{"frame": "a", "loss": 0.2}]
    assert FolderStore(tmp_path, run="b").entries("a") == []

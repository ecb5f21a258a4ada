"""The working state: what is written is read, generations replace each other, and killed runs leave no damage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.optimisation.items.store import FolderStore, MemoryStore, Store


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
    assert store.numbers("scales.0") is None and store.entries() == []
    store.write_numbers("scales.0", {"style": 1 / 3})
    store.write_numbers("scales.1", {"style": 1e-12})
    assert store.numbers("scales.0") == {"style": 1 / 3}
    store.log({"frame": "a", "loss": 0.1})
    store.log({"frame": "b", "loss": 0.2})
    assert store.entries() == [{"frame": "a", "loss": 0.1}, {"frame": "b", "loss": 0.2}]


def test_another_process_finds_the_state(tmp_path: Path) -> None:
    store = FolderStore(tmp_path)
    store.write("fields.0", 1, 4, arrays(3))
    store.write_numbers("scales.0", {"style": 2.0})
    store.log({"frame": "a"})
    again = FolderStore(tmp_path)
    assert again.generation("fields.0", 1) == 4 and again.read("fields.0", 1)["phi"][0, 0] == 3
    assert (again.numbers("scales.0"), again.entries()) == ({"style": 2.0}, [{"frame": "a"}])


def test_what_a_killed_run_leaves_does_no_harm(tmp_path: Path) -> None:
    """Two generations of an item, an unfinished file, a torn line of the log."""
    store = FolderStore(tmp_path)
    store.write("fields.0", 1, 4, arrays(3))
    earlier = (tmp_path / "fields.0" / "000001.000004.safetensors").read_bytes()
    store.write("fields.0", 1, 5, arrays(6))
    (tmp_path / "fields.0" / "000001.000004.safetensors").write_bytes(earlier)
    unfinished = tmp_path / "fields.0" / ".000001.000006.99.safetensors"
    unfinished.write_bytes(earlier[:20])
    store.log({"frame": "a"})
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('\n{"frame": "b", "lo')
    again = FolderStore(tmp_path)
    assert again.generation("fields.0", 1) == 5 and again.read("fields.0", 1)["phi"][0, 0] == 6
    again.log({"frame": "c"})
    assert again.entries() == [{"frame": "a"}, {"frame": "c"}]
    assert not unfinished.exists() and len(list(tmp_path.glob("*/*"))) == 1


@pytest.mark.parametrize("damage", [b"", b"\xff" * 100, None])
def test_damaged_items_are_named(damage: bytes | None, tmp_path: Path) -> None:
    store = FolderStore(tmp_path)
    store.write("fields.0", 1, 4, arrays(3))
    path = tmp_path / "fields.0" / "000001.000004.safetensors"
    path.write_bytes(path.read_bytes()[:-5] if damage is None else damage)
    with pytest.raises(InputError, match=r"000001\.000004\.safetensors: damaged .* start anew with --overwrite"):
        store.read("fields.0", 1)
    for content in (b"{", b"[]", b"1", b'{"scales.0": 1}', b'{"scales.0": {"style": "1"}}', b"[" * 100_000, b"\xff"):
        (tmp_path / "numbers.json").write_bytes(content)
        with pytest.raises(InputError, match=r"numbers\.json: damaged"):
            store.numbers("scales.0")


def test_damaged_lines_of_the_log_are_left_out(tmp_path: Path) -> None:
    store = FolderStore(tmp_path)
    store.log({"frame": "a"})
    with (tmp_path / "metrics.jsonl").open("ab") as file:
        file.write(b"\n\xff\xfe\n[1]\n3\n" + b"[" * 100_000)
    store.log({"frame": "c"})
    assert store.entries() == [{"frame": "a"}, {"frame": "c"}]

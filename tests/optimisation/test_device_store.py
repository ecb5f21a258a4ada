"""Items on the device: what is written is read, within the budget nothing is read twice, and the store has it all."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tnst_mi.machine.host_copy import HostCopy
from tnst_mi.optimisation.items.device_store import DeviceStore, Request
from tnst_mi.optimisation.items.store import Arrays, DamagedItemError, FolderStore, MemoryStore


class Watched(MemoryStore):
    """Counts what is read; its writes can be held back, and fail."""

    def __init__(self) -> None:
        super().__init__()
        self.reads: Counter[tuple[str, int, str]] = Counter()
        self.reading: list[tuple[str, int]] = []
        self.writes: list[tuple[str, int, int]] = []
        self.open = threading.Event()
        self.open.set()
        self.full = False

    def read(self, group: str, frame: int, names: object = None, generation: int | None = None) -> Arrays:
        self.reading.append((group, frame))
        found = super().read(group, frame, names, generation)
        self.reads.update((group, frame, name) for name in found)
        return found

    def write(self, group: str, frame: int, generation: int, arrays: Arrays, durable: bool = False) -> None:
        assert self.open.wait(10)
        if self.full:
            raise OSError("no space left")
        super().write(group, frame, generation, arrays)
        self.writes.append((group, frame, generation))


@pytest.fixture
def store() -> Watched:
    return Watched()


@pytest.fixture
def items(store: Watched) -> Iterator[DeviceStore]:
    with closing(DeviceStore(store, 1280)) as items:
        yield items


def half(value: float, count: int = 64) -> dict[str, mi.TensorXf16]:
    """128 bytes, of which ten fit."""
    return {"step": mi.TensorXf16(mi.TensorXf(np.full((count, 1, 1), value, np.float32)))}


@pytest.mark.parametrize("budget", [0, 1000])
@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_what_is_written_is_read_in_single_precision(kind: type, budget: int, store: Watched) -> None:
    values = np.linspace(0, 1, 24).reshape(2, 3, 4).astype(kind)
    tensor = mi.TensorXf16(values) if kind is np.float16 else mi.TensorXf(values)
    with closing(DeviceStore(store, budget)) as items:
        items.write("inputs.0", 0, 0, {"density": tensor})
        found = items.read("inputs.0", 0, ["density"])["density"]
        assert items.generation("inputs.0", 0) == 0 and items.generation("inputs.0", 1) == -1
    assert isinstance(found, mi.TensorXf)
    np.testing.assert_array_equal(found.numpy(), values.astype(np.float32))
    assert store.read("inputs.0", 0)["density"].dtype == kind


def test_items_are_read_once_while_they_fit_and_the_oldest_make_room(store: Watched, items: DeviceStore) -> None:
    for frame in range(12):
        store.write("step.0", frame, 1, {"step": half(frame)["step"].numpy()})
    for frame in [*range(10), *range(10), 0]:
        assert items.read("step.0", frame, ["step"])["step"].numpy()[0] == frame
    assert set(store.reads.values()) == {1}
    # Frame 1 has not been used for longest, now that 0 has been again.
    items.read("step.0", 10, ["step"])
    for frame in (0, 10, 2):
        items.read("step.0", frame, ["step"])
    assert store.reads["step.0", 1, "step"] == store.reads["step.0", 2, "step"] == 1
    items.read("step.0", 1, ["step"])
    assert store.reads["step.0", 1, "step"] == 2


def test_an_item_larger_than_the_budget_is_not_kept(store: Watched, items: DeviceStore) -> None:
    items.write("step.0", 0, 1, half(1))
    # 1026 bytes, for which 2048 are allocated.
    items.write("step.0", 1, 1, half(2, 513))
    for frame in (0, 1, 0, 1):
        assert items.read("step.0", frame, ["step"])["step"].numpy()[0] == frame + 1
    assert store.reads["step.0", 1, "step"] == 2 and store.reads["step.0", 0, "step"] == 0


def test_a_new_generation_replaces_the_old_one_on_the_device(items: DeviceStore) -> None:
    for generation in range(30):
        items.write("step.0", 0, generation, half(generation))
        assert items.read("step.0", 0, ["step"])["step"].numpy()[0] == generation == items.generation("step.0", 0)


def test_what_has_not_been_written_yet_is_read_nevertheless(store: Watched) -> None:
    with closing(DeviceStore(store, 0)) as items:
        store.open.clear()
        items.write("step.0", 0, 3, half(7))
        assert items.generation("step.0", 0) == 3 and store.generation("step.0", 0) == -1
        threading.Timer(0.2, store.open.set).start()
        assert items.read("step.0", 0, ["step"])["step"].numpy()[0] == 7


def test_writes_arrive_in_order_and_few_of_them_wait(store: Watched, items: DeviceStore) -> None:
    store.open.clear()
    done = threading.Event()

    def write() -> None:
        for frame in range(20):
            items.write("step.0", frame, 1, half(0, 3))
        done.set()

    threading.Thread(target=write).start()
    assert not done.wait(0.2), "waiting items would fill the memory"
    store.open.set()
    assert done.wait(10)
    items.finish()
    assert store.writes == [("step.0", frame, 1) for frame in range(20)]


def test_removing_waits_for_what_is_being_written(store: Watched, items: DeviceStore) -> None:
    """An octave may be removed only when its successor is safe."""
    items.write("fields.0", 0, 5, half(1))
    store.open.clear()
    items.write("fields.1", 0, 0, half(2))
    threading.Timer(0.2, store.open.set).start()
    items.remove("fields.0")
    assert store.generation("fields.1", 0) == 0 and store.generation("fields.0", 0) == -1
    assert items.generation("fields.0", 0) == -1
    with pytest.raises(KeyError):
        items.read("fields.0", 0, ["step"])


@pytest.mark.parametrize("fails", ["disk", "copy"])
def test_nothing_is_written_after_what_could_not_be(
    fails: str, store: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fields that do not fit on the disk, followed by steps that do and belong to other fields."""

    def copy(self: HostCopy) -> np.ndarray:
        raise OSError("no space left, not even in memory")

    items = DeviceStore(store, 1280)
    items.write("step.0", 0, 1, half(1))
    items.finish()
    with monkeypatch.context() as patch:
        if fails == "copy":
            patch.setattr(HostCopy, "numpy", copy)
        store.full = fails == "disk"
        items.write("fields.0", 0, 2, half(2))
        with pytest.raises(OSError, match="no space left"):
            items.finish()
    store.full = False
    with pytest.raises(OSError, match="no space left"):
        for generation in range(2, 9):
            items.write("step.0", 0, generation, half(generation))
    with pytest.raises(OSError, match="no space left"):
        items.close()
    assert store.writes == [("step.0", 0, 1)]


@pytest.mark.parametrize("waiter", ["finish", "write"])
def test_an_item_is_waited_for_while_others_wait_for_it_too(store: Watched, waiter: str) -> None:
    """Read ahead, in a thread, while the main thread waits for that very write."""
    with closing(DeviceStore(store, 0)) as items:
        items.write("fields.0", 0, 1, half(1))
        items.finish()
        store.open.clear()
        items.write("fields.0", 0, 2, half(2))
        found: list[float] = []
        reading = threading.Thread(
            target=lambda: found.append(store_value(items, threading.Event().wait(0.2))), daemon=True
        )
        reading.start()
        threading.Timer(0.5, store.open.set).start()
        if waiter == "finish":
            items.finish()
        else:
            for frame in range(1, 8):
                items.write("fields.0", frame, 1, half(frame))
        reading.join(10)
    assert found == [2.0]


def store_value(items: DeviceStore, _: object) -> float:
    """What read-ahead loads of the item, once the main thread waits for its writing."""
    return float(items._load(Request("fields.0", 0, ["step"], items.generation("fields.0", 0)))["step"][0, 0, 0])


def test_damaged_items_are_found_when_they_are_read_ahead(tmp_path: Path) -> None:
    store = FolderStore(tmp_path)
    for frame in range(2):
        store.write("step.0", frame, 1, {"step": np.zeros(3, np.float16)})
    path = tmp_path / "step.0" / "000001.000001.safetensors"
    path.write_bytes(path.read_bytes()[:-2])
    with closing(DeviceStore(store, 1280)) as items:
        results = items.read_each([[Request("step.0", frame, ["step"])] for frame in range(2)])
        next(results)
        with pytest.raises(DamagedItemError, match=r"000001\.000001\.safetensors: damaged"):
            next(results)


def test_reading_is_one_group_ahead_and_no_more(store: Watched, items: DeviceStore) -> None:
    for frame in range(4):
        store.write("step.0", frame, 1, {"step": np.full((1, 1, 1), frame, np.float32)})
    results = items.read_each([[Request("step.0", frame, ["step"])] for frame in range(4)])
    for frame in range(3):
        assert next(results)[0]["step"].numpy()[0, 0, 0] == frame
        for _ in range(1000):
            if ("step.0", frame + 1) in store.reading:
                break
            threading.Event().wait(0.01)
        assert store.reading == [("step.0", i) for i in range(frame + 2)]
    assert [result[0]["step"].numpy().item() for result in results] == [3]
    assert list(items.read_each([])) == []


def two(value: float) -> dict[str, mi.TensorXf16 | mi.TensorXf]:
    """128 and 256 bytes."""
    return half(value) | {"density": mi.TensorXf(np.full((64, 1, 1), -value, np.float32))}


@given(
    st.integers(0, 1700),
    st.lists(
        st.tuples(st.sampled_from(["write", "read", "remove"]), st.integers(0, 1), st.integers(0, 3)), max_size=25
    ),
)
def test_it_reads_what_was_written_last_at_any_budget(budget: int, actions: list[tuple[str, int, int]]) -> None:
    """Against a dictionary. Keeping one array may make another go that is about to be taken."""
    expected: dict[tuple[int, int], float] = {}
    store = MemoryStore()
    with closing(DeviceStore(store, budget)) as items:
        for number, (action, group, frame) in enumerate(actions):
            if action == "write":
                items.write(f"{group}", frame, number, two(number))
                expected[group, frame] = number
            elif action == "remove":
                items.remove(f"{group}")
                expected = {key: value for key, value in expected.items() if key[0] != group}
            else:
                # Single arrays, both, and two items at once.
                single = [[Request(f"{g}", f, [name])] for (g, f) in expected for name in ("density", "step")]
                both = [[Request(f"{g}", f, ["step", "density"])] for g, f in expected]
                for wanted in (single, both, [[request for (request,) in both]]):
                    found = [result for results in items.read_each(wanted) for result in results]
                    values = [{name: tensor.numpy()[0, 0, 0] for name, tensor in result.items()} for result in found]
                    asked = [
                        (request, expected[int(request.group), request.frame]) for group in wanted for request in group
                    ]
                    assert values == [
                        {name: value if name == "step" else -value for name in names}
                        for (_, _, names, _), value in asked
                    ]
    assert {key: store.read(f"{key[0]}", key[1])["step"][0, 0, 0] for key in expected} == expected

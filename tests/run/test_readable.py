"""Frames that cannot be read: named all at once before any work, or left out where that is asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from jobs import SHAPE, FakeOptimiser, frames, optimiser

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame, Note
from tnst_mi.io import open_frames, save_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare
from tnst_mi.run.readable import Readable, require_readable

__all__ = ["optimiser"]

RECIPE = Recipe(style=("spirals",))


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    """Five frames, 7 to 11, of which 8 is empty, 9 cut short and 11 negative."""
    folder = tmp_path / "smoke"
    save_frames(folder, frames(0.2, 0.4, 0.3, 0.2, 0.1))
    (folder / "f_08.npz").write_bytes(b"")
    (folder / "f_09.npz").write_bytes((folder / "f_09.npz").read_bytes()[:200])
    np.savez(folder / "f_11.npz", density=np.full(SHAPE, -0.1))
    return folder


def test_all_are_named_at_once(damaged: Path, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    with pytest.raises(InputError) as error:
        prepare(damaged, RECIPE, tmp_path / "out")
    message = str(error.value)
    assert message.startswith("3 of 5 frames cannot be read: ") and message.endswith("; --skip-bad leaves them out")
    assert [f"f_{number:02d}.npz" in message for number in range(7, 12)] == [False, True, True, False, True]
    assert len(message) <= 300 and not (tmp_path / "out").exists()


def test_many_are_counted(tmp_path: Path) -> None:
    save_frames(tmp_path, frames(*(0.1,) * 9))
    for number in range(8, 16):
        (tmp_path / f"f_{number:02d}.npz").write_bytes(b"PK")
    message = r"8 of 9 frames cannot be read \(f_08\.npz, .* and 5 more\): not an npz .*; --skip-bad leaves them out$"
    with pytest.raises(InputError, match=message):
        list(Readable(open_frames(tmp_path)))


def test_a_reason_that_frames_share_is_said_once_with_its_remedy(tmp_path: Path) -> None:
    for number in range(4):
        np.savez(tmp_path / f"s_{number}.npz", temp=np.ones(SHAPE), wind=np.ones((*SHAPE, 3)))
    with pytest.raises(InputError) as error:
        list(Readable(open_frames(tmp_path)))
    assert str(error.value) == (
        "4 of 4 frames cannot be read (s_0.npz, s_1.npz, s_2.npz and 1 more): no array 'density' (or 'x'), "
        "the arrays found are: temp, wind; choose with --density NAME"
    )


@pytest.mark.parametrize("letters", [20, 60, 120])
def test_long_messages_keep_their_remedies(letters: int) -> None:
    """What goes first is the names of the files, then the middle of the reason."""
    reason = f"no array 'density', the arrays found are: {'abcdefghi ' * 16}; choose with --density NAME"
    bad = [f"/a folder/{'f' * letters}_{number}.npz: {reason}" for number in range(5)]
    for total, remedy in ((5, ""), (9, "; --skip-bad leaves them out")):
        with pytest.raises(InputError) as error:
            require_readable(bad, total, False)
        message = str(error.value)
        assert len(message) <= 300 and message.endswith(f"; choose with --density NAME{remedy}")
        assert message.startswith(f"5 of {total} frames cannot be read ({'f' * letters}_0.npz")
    with pytest.raises(InputError) as error:
        require_readable([bad[0] + " " * 200 + "; mend it"], 9, False)
    assert len(str(error.value)) <= 300 and str(error.value).endswith("; mend it; --skip-bad leaves it out")


def test_different_reasons_are_grouped() -> None:
    bad = [f"/folder/f_{number}.npz: {'is empty' if number < 4 else 'is cut short'}" for number in range(6)]
    with pytest.raises(InputError) as error:
        require_readable(bad, 8, False)
    assert str(error.value) == (
        "6 of 8 frames cannot be read: f_0.npz and 3 more: is empty; f_4.npz and 1 more: is cut short; "
        "--skip-bad leaves them out"
    )


def test_they_are_left_out_where_that_is_asked_for(damaged: Path, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    run = Run(prepare(damaged, Recipe(style=("spirals",), skip_bad=True), tmp_path / "out"), progress=False)
    assert [frame.source.name for frame in run] == ["f_07", "f_10"]
    said = [line for line in run.prepared.reading if line.startswith("note: left out, since they cannot be read: ")]
    assert len(said) == 1 and all(name in said[0] for name in ("f_08.npz", "f_09.npz", "f_11.npz"))
    assert Recipe.from_toml(tmp_path / "out" / "recipe.toml").skip_bad
    resumed = prepare(damaged, Recipe(style=("spirals",), skip_bad=True), tmp_path / "out", resume=True)
    assert [measure.name for measure in resumed.measures] == ["f_07", "f_10"]


def test_a_single_one_is_told_as_it_is(damaged: Path, tmp_path: Path) -> None:
    for name in ("f_09.npz", "f_11.npz"):
        (damaged / name).unlink()
    for selection, remedy in (((7, 8), "; --skip-bad leaves it out"), ((8, 8), "")):
        with pytest.raises(InputError) as error:
            list(Readable(open_frames(damaged, selection)))
        assert str(error.value) == f"{damaged}/f_08.npz: is empty (0 bytes), expected an npz file{remedy}"


def test_none_is_not_enough(damaged: Path) -> None:
    with pytest.raises(InputError, match=r"2 of 2 frames cannot be read: f_08\.npz: is empty [^;]*; f_09\.npz: [^;]*$"):
        list(Readable(open_frames(damaged, (8, 9)), skip_bad=True))


def test_what_is_said_of_all_frames_is_said_once() -> None:
    def frame(number: int, reading: str, *notes: Note) -> Frame:
        return Frame(np.ones(SHAPE), name=f"f_{number}", reading=reading, notes=notes)

    noise = [Note("noise", f"{number} cells") for number in range(5)]
    readable = Readable([frame(number, "y up", noise[number]) for number in range(5)])
    assert len(list(readable)) == len(readable) == 5
    assert readable.lines() == ["read as: y up", "note: noise: f_0 (0 cells), f_1 (1 cells), f_2 (2 cells) and 2 more"]
    readable = Readable([frame(0, "y up"), frame(1, "z up", Note("empty")), frame(2, "y up")])
    list(readable)
    assert readable.lines() == ["read as: y up (f_0, f_2)", "read as: z up (f_1)", "note: empty: f_1"]
    single = Readable([frame(0, "y up", Note("noise", "3 cells"))])
    list(single)
    assert single.lines() == ["read as: y up", "note: noise: f_0 (3 cells)"]


def test_arrays_are_not_read_from_files(tmp_path: Path, optimiser: FakeOptimiser) -> None:
    assert Readable(frames(0.2)).lines() == []
    for key, value in (("up", "z"), ("velocity", "none"), ("skip_bad", True), ("origin", (0, 0, 1))):
        with pytest.raises(InputError, match=f"{key} = .*: says how files are read, but the frames were given as"):
            prepare(frames(0.2), Recipe(style=("spirals",), **{key: value}))


@pytest.mark.parametrize("skip_bad", [False, True])
def test_frames_that_a_window_needs_are_not_left_out(skip_bad: bool, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    """Whether asked for or not; a damaged frame at an end leaves no gap."""
    still = [
        Frame(frame.density, np.zeros((*SHAPE, 3)), None, frame.name, frame.number) for frame in frames(*[0.2] * 5)
    ]
    save_frames(tmp_path / "smoke", still)
    recipe = Recipe(style=("spirals",), window=3, skip_bad=skip_bad)
    (tmp_path / "smoke" / "f_09.npz").write_bytes(b"")
    with pytest.raises(InputError) as error:
        prepare(tmp_path / "smoke", recipe, tmp_path / "out")
    message = str(error.value)
    remedy = "; window = 3 needs the frames between 8 and 10: mend them, select with --frames, or add --window 1"
    assert "f_09.npz: is empty" in message and message.endswith(remedy + ("" if skip_bad else " --skip-bad"))
    assert message.startswith("left out: ") == skip_bad and len(message) <= 300
    (tmp_path / "smoke" / "f_09.npz").write_bytes((tmp_path / "smoke" / "f_08.npz").read_bytes())
    (tmp_path / "smoke" / "f_11.npz").write_bytes(b"")
    if skip_bad:
        assert len(prepare(tmp_path / "smoke", recipe, tmp_path / "out").measures) == 4
    else:
        with pytest.raises(InputError, match=r"; --skip-bad leaves it out$"):
            prepare(tmp_path / "smoke", recipe, tmp_path / "out")

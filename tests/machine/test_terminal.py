"""Lines for a terminal: printable, and errors bounded whatever they name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from command_line import Run, run
from hypothesis import given
from hypothesis import strategies as st

from tnst_mi.machine.terminal import LONGEST, LONGEST_NAME, one_line, printable, quoted

__all__ = ["run"]


@given(st.text(st.characters(codec=None), max_size=900))
def test_any_text_is_printable_and_an_error_one_short_line(text: str) -> None:
    assert all(character.isprintable() for character in printable(text))
    line = one_line(text)
    assert line.isprintable() and len(line) <= LONGEST and line == " ".join(line.split())
    assert one_line(line) == line


@given(st.text(max_size=200), st.integers(8, 80))
def test_a_quoted_name_is_short_after_escaping(name: str, most: int) -> None:
    shown = quoted(name, most)
    assert shown.isprintable() and len(shown) <= most
    if len(repr(name)) <= most:
        assert shown == repr(name)
    else:
        # As little is cut as can be.
        assert shown[-2] == "…" and len(shown) > most - 10
    assert len(quoted("\U000e0001" * 500)) <= LONGEST_NAME


def test_the_name_and_the_remedy_outlast_the_folders() -> None:
    path = "/" + "quite_a_long_name/" * 30 + "smoke_0012.npz"
    assert one_line(f"{path}: is empty; see {path}") == "…/smoke_0012.npz: is empty; see …/smoke_0012.npz"
    short = "/a/b/smoke.npz: is empty"
    assert one_line(short) == short
    line = one_line(f"{'x' * 400}.npz: is empty; remove it")
    assert line.startswith("xxx") and line.endswith("x.npz: is empty; remove it")


def test_errors_and_notes_about_files_with_odd_names(run: Run, tmp_path: Path) -> None:
    folder = tmp_path.joinpath(*["d" * 60] * 6)
    folder.mkdir(parents=True)
    bad = folder / "smoke.npz"
    bad.write_bytes(b"")
    ran = run("render", bad, "--out", tmp_path / "out")
    assert ran.code == 2
    (error,) = ran.errors
    assert len(error) <= LONGEST + len("tnst-mi: ") and error.endswith(
        "smoke.npz: is empty (0 bytes), expected an npz file"
    )
    # A note is not said where there is an error, and does not control the terminal elsewhere.
    odd = tmp_path / "odd"
    odd.mkdir()
    density = np.ones((2, 3, 4))
    density[0, 0, 0] = -1e-9
    np.savez(odd / "smoke_1.npz", density=density, **{"\x1b[31mred\x07": density})
    np.savez(odd / "smoke_2.npz", density=density)
    np.savez(odd / "left\x07over.npz", density=density)
    for arguments in (["info", odd], ["convert", odd, tmp_path / "out"]):
        ran = run(*arguments)
        assert ran.code == 0
        lines = [*ran.errors, *ran.out.splitlines()]
        assert any("left alone in" in line and "left over.npz" in line for line in lines)
        assert not any("\x1b" in line or "\x07" in line for line in lines)
    (odd / "smoke_2.npz").write_bytes(b"")
    assert [line for line in run("convert", odd, tmp_path / "other").errors if "is empty" not in line] == []

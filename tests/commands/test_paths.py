"""Paths of every kind, as input and as output of the commands."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from command_line import Run, refused, run
from jobs import FakeOptimiser, frames, optimiser

from tnst_mi.errors import InputError
from tnst_mi.io import save_frames
from tnst_mi.machine.disk import require_names

__all__ = ["optimiser", "run"]

#: The arguments of each command for an input and an output; `compare` writes one report, and is only asked to refuse.
COMMANDS: dict[str, Callable[[Path, Path], list[object]]] = {
    "stylize": lambda source, out: ["stylize", source, "--semantic", "inception_3a/3x3:2", "--out", out],
    "render": lambda source, out: ["render", source, "--out", out],
    "convert": lambda source, out: ["convert", source, out],
}
ALL = COMMANDS | {"compare": lambda source, out: ["compare", source, "--quick", "--out", out]}


@pytest.fixture(params=COMMANDS)
def command(request: pytest.FixtureRequest, optimiser: FakeOptimiser) -> Callable[[Path, Path], list[object]]:
    return COMMANDS[request.param]


@pytest.fixture
def smoke(tmp_path: Path) -> Path:
    """A folder with one frame."""
    save_frames(tmp_path / "smoke", frames(0.2))
    return tmp_path / "smoke"


def kept(folder: Path) -> Iterator[tuple[str, bytes]]:
    return ((path.name, path.read_bytes()) for path in sorted(folder.iterdir()) if path.is_file())


def deep(folder: Path) -> Path:
    return folder.joinpath(*["seven_7"] * 200)


@pytest.mark.parametrize(
    "place",
    [
        lambda folder: folder / "with spaces  and" / "“quotes” 'x' $HOME *",
        lambda folder: folder / ("n" * 200),
        deep,
        lambda folder: folder / "c=1,2:[3]" / "-x",
    ],
    ids=["spaces", "200 characters", "200 folders", "punctuation"],
)
def test_any_folder_can_be_read_and_written(place: Callable, command: Callable, run: Run, tmp_path: Path) -> None:
    source, out = place(tmp_path / "in"), place(tmp_path / "out")
    save_frames(source, frames(0.2))
    ran = run(*command(source, out))
    assert ran.code == 0, ran.errors
    assert any(path.is_file() for path in out.rglob("*"))
    # pytest's own clean-up does not go so deep.
    shutil.rmtree(tmp_path / "in")
    shutil.rmtree(tmp_path / "out")


def test_names_of_200_characters(command: Callable, run: Run, tmp_path: Path) -> None:
    save_frames(tmp_path / "in" / f"{'n' * 192}_0001.npz", frames(0.2)[0])
    ran = run(*command(tmp_path / "in", tmp_path / "out"))
    assert ran.code == 0, ran.errors


def test_names_that_leave_no_room_for_results_are_refused(command: Callable, run: Run, tmp_path: Path) -> None:
    save_frames(tmp_path / "in" / "smoke.npz", frames(0.2)[0])
    (tmp_path / "in" / "smoke.npz").rename(tmp_path / "in" / f"{'n' * 215}.npz")
    remedy = "the name has 215 bytes, expected at most 203, .*; rename the file"
    refused(run, tmp_path, command(tmp_path / "in", tmp_path / "out"), remedy)


def test_paths_longer_than_the_system_allows_are_refused(
    command: Callable, run: Run, smoke: Path, tmp_path: Path
) -> None:
    long = tmp_path.joinpath(*["p" * 250] * 17)
    refused(run, tmp_path, command(long, tmp_path / "out"), "cannot be read .File name too long")
    refused(run, tmp_path, command(smoke, long), "cannot be written to .File name too long")


def test_there_has_to_be_room_for_results_in_a_path(tmp_path: Path) -> None:
    out = Path("/" + "/".join(["p" * 250] * 16))
    require_names(out.parent, ["smoke_0001"])
    with pytest.raises(InputError, match=r"the path has 4016 bytes, expected at most 4000, .* a shorter path"):
        require_names(out, ["n" * 31])


def test_bytes_that_are_not_utf8(command: Callable, run: Run, smoke: Path, tmp_path: Path) -> None:
    """Read, with a replacement in the names of the results; refused as the folder of results."""
    source = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9"))
    source.mkdir()
    for file in smoke.iterdir():
        shutil.copy(file, os.fsencode(source) + b"/f\xe9_" + os.fsencode(file.name[-6:]))
    ran = run(*command(source, tmp_path / "out"))
    assert ran.code == 0, ran.errors
    out = Path(os.fsdecode(os.fsencode(tmp_path) + b"/out\xe9"))
    refused(run, tmp_path, command(smoke, out), "the path is not UTF-8")


# --------------------------------------------------------------------
# Links
# --------------------------------------------------------------------


def test_links_are_followed(command: Callable, run: Run, smoke: Path, tmp_path: Path) -> None:
    """To a folder, to files; those that lead to themselves or nowhere are not frames."""
    (tmp_path / "folder").symlink_to(smoke)
    linked, real = tmp_path / "files", tmp_path / "real"
    linked.mkdir()
    real.mkdir()
    for file in smoke.iterdir():
        (linked / file.name).symlink_to(file)
    (linked / "itself").symlink_to(linked)
    (linked / "x_0001.npz").symlink_to("x_0001.npz")
    (tmp_path / "out").symlink_to(real)
    assert run(*command(tmp_path / "folder", tmp_path / "out")).code == 0
    assert run(*command(linked, tmp_path / "other")).code == 0
    names = [sorted(path.relative_to(out) for path in out.rglob("*")) for out in (real, tmp_path / "other")]
    assert names[0] == names[1] != []


@pytest.mark.parametrize("name", ALL)
def test_links_that_lead_nowhere_are_refused(name: str, run: Run, smoke: Path, tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "dangling").symlink_to(tmp_path / "nothing")
    for link in (tmp_path / "loop", tmp_path / "dangling"):
        refused(run, tmp_path, ALL[name](link, tmp_path / "out"), "no such file or folder")
        for out in (link, link / "inside"):
            refused(run, tmp_path, ALL[name](smoke, out), rf"{link}: is a link to what is not there")


# --------------------------------------------------------------------
# Input and output in each other
# --------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL)
def test_results_do_not_go_where_the_input_is(name: str, run: Run, smoke: Path, tmp_path: Path) -> None:
    """Under any of its names, and not around it."""
    (tmp_path / "link").symlink_to(smoke)
    (tmp_path / "above").symlink_to(tmp_path)
    before = list(kept(smoke))
    for out in (smoke, tmp_path / "link", smoke / ".." / smoke.name, smoke.parent, tmp_path / "above"):
        refused(run, tmp_path, ALL[name](smoke, out), "contains the input|is not empty; give another folder")
        refused(run, tmp_path, ALL[name](smoke / "f_07.npz", out), "contains the input|is not empty; give another")
    for file in (smoke / "f_07.npz", tmp_path / "link" / "f_07.npz"):
        refused(run, tmp_path, ALL[name](smoke / "f_07.npz", file), "is a file|is the input")
    assert list(kept(smoke)) == before


def test_results_inside_the_input_are_not_taken_for_frames(
    command: Callable, run: Run, smoke: Path, tmp_path: Path
) -> None:
    before = list(kept(smoke))
    assert run(*command(smoke, smoke / "out")).code == 0
    assert run(*command(smoke, tmp_path / "again")).code == 0
    assert list(kept(smoke)) == before
    names = [{str(path.relative_to(out)) for path in out.rglob("*")} for out in (smoke / "out", tmp_path / "again")]
    assert names[0] == names[1]

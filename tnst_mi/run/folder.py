"""The folder of a run: its layout, how a finished frame is recognised, and what may be overwritten.

    density/NAME.npz     stylized density, obstacle,    velocity/NAME.npz    the velocity v* that transports
                         the grids carried with it
                         (.vol, .uni or .vdb instead of .npz if the results have that format)
    images/NAME_*        main view before and after (PNG, EXR), side by side, and the loss over the iterations
    recipe.toml          the recipe as run              run.json             the record of the run
    metrics.jsonl        one line per iteration         state/NAME.*         from which another run can go on
    octaves/N/           state and picture at the end of octave N, if they are kept

Every file is written atomically and durably, but for metrics.jsonl, which grows with each frame and is on the disk
before run.json, which is written last, lists the frame as complete: then it counts as finished, as long as its files
have the sizes and hashes that are in run.json.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io.atomic import UNFINISHED, append, remove_folder, remove_unfinished, sync, written_whole
from tnst_mi.io.files.companions import OBSTACLE, VELOCITY, companion
from tnst_mi.io.formats import FORMATS, GRID_FORMATS, write_frame
from tnst_mi.io.pictures.exr import read_exr, write_exr
from tnst_mi.io.pictures.png import write_png
from tnst_mi.io.pictures.video import can_encode
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.machine.lock import LOCK
from tnst_mi.machine.terminal import one_line
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.before_after import side_by_side
from tnst_mi.run.states import state_file, write_state
from tnst_mi.run.written import Written, lines_by_frame, lines_written, written

if TYPE_CHECKING:
    from tnst_mi.optimisation.start import State
    from tnst_mi.run import report
    from tnst_mi.run.carry import Carried
else:
    # It draws with matplotlib, which takes long to import; what a folder holds is asked before that is needed.
    report = LazyModule("tnst_mi.run.report")

#: Files that a run writes for each frame, and for all frames together; overwriting removes these and no others.
_FRAME_FILES = (
    *(f"{kind}/{{}}{suffix}" for kind in ("density", "velocity") for suffix in FORMATS),
    *(f"images/{{}}_{state}.{format}" for state in ("before", "after") for format in ("png", "exr")),
    "images/{}_comparison.png",
    "images/{}_loss.png",
)
PICTURES = tuple(f"images/{name}" for name in ("preview.mp4", "contact_sheet.png", "sequence.png"))
_RUN_FILES = (*PICTURES, "metrics.jsonl")

#: Files that mark a folder as that of a run: removed last, in this order, so that an interrupted removal can be redone.
_MARKS = ("run.json", "recipe.toml")

_FOLDERS = ("density", "velocity", "images", "state")

#: Folder of the working state, and of the states at the end of each octave.
WORK, OCTAVES = ".work", "octaves"

#: What a damaged run.json makes those raise who read it.
DAMAGE = (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError)
ELSEWHERE = "give another folder"


def holds_run(out: Path) -> bool:
    """Whether a folder has the two files that every run writes."""
    return all(os.path.isfile(out / name) for name in _MARKS)  # also of a path that is too long


def frame_names(out: Path) -> list[str]:
    """The names of the frames of the run in a folder; none if the folder is empty or new.

    Raises:
        InputError: the folder holds something other than a run, or its run.json is damaged.
    """
    if not occupied(out) or just_begun(out):
        return []
    if not holds_run(out):
        raise InputError(f"{out}: is not empty and holds no run that could be overwritten; give another folder")
    try:
        run = json.loads((out / "run.json").read_text("utf-8"))
        # A frame may have been written but not recorded yet.
        names = list(dict.fromkeys([*(frame["name"] for frame in run["frames"]), *run.get("inputs", ())]))
    except DAMAGE:
        raise InputError(f"{out / 'run.json'}: damaged, so it does not tell what to overwrite; {ELSEWHERE}") from None
    for name in names:
        # The file is untrusted: it must not make us remove anything outside the folder.
        if not isinstance(name, str) or not is_file_name(name):
            named = f"{out / 'run.json'}: names a frame {name!r}, expected a plain file name; {ELSEWHERE}"
            raise InputError(one_line(named))
    return names


def input_of_run(out: Path) -> Path:
    """The input of the run in a folder.

    Raises:
        InputError: its run.json is damaged, or does not name one, as for frames that were given as arrays.
    """
    try:
        source = json.loads((out / "run.json").read_text("utf-8")).get("input")
    except DAMAGE:
        raise InputError(f"{out / 'run.json'}: damaged, so it does not tell the input of its run; give it") from None
    if not isinstance(source, str):
        raise InputError(f"{out / 'run.json'}: does not tell the input of its run; give it")
    return Path(source)


def is_file_name(name: str) -> bool:
    """Whether a frame's name stays inside the folders of the results."""
    return bool(name) and not any(character in name for character in "/\\\0")


class RunFolder:
    """Writes the results of a run.

    finished: names of the frames that an earlier run has finished, whose iterations metrics.jsonl keeps.
    may_write: called before anything is written; raises if that must not happen any more.
    joining: another process has begun the folder, and this one writes results of frames into it.
    """

    def __init__(
        self,
        out: Path,
        recipe: Recipe,
        overwrite: bool = False,
        suffix: str = FORMATS[0],
        finished: Collection[str] = (),
        may_write: Callable[[], None] = lambda: None,
        joining: bool = False,
    ) -> None:
        self.out, self.work, self._suffix, self._may_write = out, out / WORK, suffix, may_write
        self._metrics = out / "metrics.jsonl"
        if joining:
            return
        if overwrite:
            _remove_results(out, frame_names(out))
        # The folder itself may be a link that the user made; those in it are not followed.
        for folder in (out.resolve(), *(out / name for name in _FOLDERS)):
            remove_unfinished(folder)
        with written_whole(out / "recipe.toml") as temporary:
            temporary.write_text(recipe.to_toml(), "utf-8")
        if self._metrics.exists():
            self._keep_metrics(finished)

    def write_arrays(self, source: Frame, density: np.ndarray, velocity: np.ndarray, carried: Carried) -> None:
        """Write a frame's stylized density with its obstacle and what moved with it, and the velocity that made it."""
        self._may_write()
        file, place = f"{source.name}{self._suffix}", source.placement
        smoke = self.out / "density" / file
        write_frame(smoke, density, carried.velocity, source.obstacle, place, carried.grids)
        write_frame(self.out / "velocity" / file, None, velocity, placement=place)

    def write_images(self, name: str, before: np.ndarray, after: np.ndarray, attributes: dict[str, Any]) -> None:
        """Write the main view before and after, (H, W) or (H, W, 3), with equal exposure and EXR `attributes`."""
        self.write_glimpse(name, before, after)
        for suffix, image in (("before", before), ("after", after)):
            write_exr(self.out / "images" / f"{name}_{suffix}.exr", image, attributes)

    def write_state(self, name: str, state: State) -> dict[str, Any]:
        """Write the state of a frame; returns what run.json holds of it."""
        self._may_write()
        return write_state(self.out, name, state)

    def write_glimpse(self, name: str, before: np.ndarray, after: np.ndarray) -> None:
        """Write the main view of a frame that may not be finished, before and as it stands, as PNG alone."""
        self._may_write()
        for suffix, image in (("before", before), ("after", after), ("comparison", side_by_side(before, after))):
            write_png(self.out / "images" / f"{name}_{suffix}.png", image)

    def write_contact_sheet(self, entries: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> None:
        """Write the main views of some frames, before and after, on one sheet."""
        self._may_write()
        report.write_contact_sheet(self.out / "images" / "contact_sheet.png", entries, len(entries))

    def recorded(self, name: str, carried: Iterable[str], history: list[dict[str, Any]]) -> dict[str, Any]:
        """What run.json holds of the files of a frame, with which some grids moved, and of its iterations.

        All of them have been written.
        """
        return {
            "results": written(self.out, frame_files(self.out, name, carried)),
            "log": lines_written(_lines_of(name, history)),
        }

    def recorded_pictures(self) -> Written:
        """What run.json holds of the pictures of all frames together."""
        return written(self.out, (self.out / name for name in PICTURES))

    def write_history(self, name: str, history: list[dict[str, Any]]) -> None:
        """Add a frame's iterations to metrics.jsonl.

        They are appended, so that a frame costs the same however many there were before it. What a killed run leaves of
        them is removed when the run goes on, since run.json does not list their frame yet.
        """
        self._may_write()
        append(self._metrics, "".join(f"{line}\n" for line in _lines_of(name, history)))
        sync(self._metrics)

    def plot_history(self, name: str, history: list[dict[str, Any]]) -> None:
        """Plot the loss of a frame over its iterations, if it has any."""
        self._may_write()
        if history:
            report.plot_loss(self.out / "images" / f"{name}_loss.png", name, history)

    def _keep_metrics(self, finished: Collection[str]) -> None:
        """Remove the iterations of other frames from metrics.jsonl, and a last line that is incomplete."""
        found = lines_by_frame(self._metrics)
        kept = [line for name, lines in found.items() if name in finished for line in lines]
        with written_whole(self._metrics) as temporary:
            temporary.write_text("".join(line + "\n" for line in kept), "utf-8")

    def main_views(self, names: Iterable[str]) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """The names and the main views before and after of frames that have been written."""
        for stem in (self.out / "images" / name for name in names):
            yield stem.name, read_exr(Path(f"{stem}_before.exr")), read_exr(Path(f"{stem}_after.exr"))

    def write_sequence(self, run: dict[str, Any], frames_per_second: float) -> None:
        """Write the preview, contact sheet and plots of all frames, whose pictures have been written already."""
        self._may_write()
        images, records, sequence = self.out / "images", run["frames"], run["sequence"]
        names = [record["name"] for record in records]
        if can_encode():
            pairs = ((before, after) for _, before, after in self.main_views(names))
            report.write_preview(images / "preview.mp4", pairs, frames_per_second)
        else:
            print("note: preview.mp4 is not written: pip install imageio-ffmpeg", file=sys.stderr)
        report.write_contact_sheet(images / "contact_sheet.png", self.main_views(names), len(names))
        before, after = ([record[key] for record in records] for key in ("loss_before", "loss_after"))
        flickers, changes = sequence["flicker_pairs"], sequence["relative_changes"]
        report.plot_sequence(images / "sequence.png", names, before, after, flickers, changes, sequence["mass_changes"])

    def remove_work(self) -> None:
        """Remove the working state of a finished run, and what processes that were killed have left of results."""
        self._may_write()
        for name in _FOLDERS:
            remove_unfinished(self.out / name)
        remove_folder(self.work)

    def write_run(self, run: dict[str, Any]) -> None:
        """Write run.json."""
        self._may_write()
        with written_whole(self.out / "run.json") as temporary:
            temporary.write_text(json.dumps(run, indent=1) + "\n", "utf-8")


def occupied(out: Path) -> bool:
    """Whether a folder is there and not empty."""
    return out.exists() and any(out.iterdir())


def just_begun(out: Path) -> bool:
    """Whether a run was killed here before it wrote its first run.json, or after it removed an earlier one."""
    return all(
        path.name in ("recipe.toml", LOCK)
        or path.name.startswith((f"{UNFINISHED}recipe.", f"{UNFINISHED}run."))
        or (path.name in _FOLDERS and path.is_dir() and not any(path.iterdir()))
        for path in out.iterdir()
    )


def _lines_of(name: str, history: Iterable[dict[str, Any]]) -> list[str]:
    """The lines of metrics.jsonl about a frame."""
    return [json.dumps({"frame": name, **entry}) for entry in history]


def _remove_results(out: Path, names: Iterable[str]) -> None:
    """Remove the files of the named frames and of their run, then the folders left empty by this."""
    for path in _result_files(out, names, _carried_by_run(out)):
        # A symlinked folder is not ours, whatever its files are called.
        if (path.parent == out or not path.parent.is_symlink()) and (path.is_file() or path.is_symlink()):
            path.unlink()
    for folder in (out / WORK, out / OCTAVES):
        if folder.is_dir() and not folder.is_symlink():
            # An error here must end the run: the state left behind would be that of another run.
            remove_folder(folder)
    for name in _MARKS:
        (out / name).unlink(missing_ok=True)
    for folder in _FOLDERS:
        with contextlib.suppress(OSError):  # not empty, or not there
            (out / folder).rmdir()


def _carried_by_run(out: Path) -> list[str]:
    """The names of the grids that the run in a folder carried."""
    try:
        run = json.loads((out / "run.json").read_text("utf-8"))
        return [name for name in run.get("carried", ()) if isinstance(name, str)]
    except DAMAGE:
        return []


def _result_files(out: Path, names: Iterable[str], carried: Iterable[str]) -> Iterator[Path]:
    for name in names:
        yield from frame_files(out, name, carried)
        yield state_file(out, name)
    yield from (out / name for name in _RUN_FILES)


def frame_files(out: Path, name: str, carried: Iterable[str]) -> Iterator[Path]:
    """The files that a run may write for a frame, with which some grids move."""
    yield from (out / pattern.format(name) for pattern in _FRAME_FILES)
    # For formats with one grid per file.
    grids = [grid for grid in (VELOCITY[0], OBSTACLE[0], *carried) if is_file_name(grid)]
    for suffix in GRID_FORMATS:
        yield from (companion(out / "density" / f"{name}{suffix}", grid) for grid in grids)

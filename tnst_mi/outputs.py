"""The folder of a run: what is written where, how a finished frame is recognised, what may be overwritten.

    density/NAME.npz     stylized density               velocity/NAME.npz    the velocity v* that transports
    images/NAME_*        main view before and after (PNG, EXR), side by side, and the loss over the iterations
    recipe.toml          the recipe as run              run.json             what was done, with which numbers
    metrics.jsonl        one line per iteration

Every file appears whole or not at all; a frame counts as finished once run.json, written last, says so.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.images import resized
from tnst_mi.io.atomic import written_whole
from tnst_mi.io.exr import write_exr
from tnst_mi.io.npz import write_arrays
from tnst_mi.io.png import write_png
from tnst_mi.recipe import KINDS, Recipe

#: Everything that a run writes into its folder, and all that overwriting removes from it.
RESULTS = ("density", "velocity", "images", "recipe.toml", "run.json", "metrics.jsonl")

#: White columns between the two pictures of a comparison.
_GAP = 2

#: Comparisons of small grids are enlarged to at least this many rows.
_COMPARISON_HEIGHT = 400


def require_writable(out: Path, source: Path | None = None, occupied_ok: bool = False) -> None:
    """Check, before any work is done, that results can go to a folder.

    Args:
        out: the folder; it need not exist.
        source: where the input is; it must not lie inside `out`.
        occupied_ok: the folder may have files in it.

    Raises:
        InputError: `out` is a file, cannot be written to, is not empty, or contains the input.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file, expected a folder for the results")
    if source is not None and source.resolve().is_relative_to(out.resolve()):
        raise InputError(f"{out}: contains the input {source}; give another folder for the results")
    existing = next(folder for folder in (out.absolute(), *out.absolute().parents) if folder.exists())
    try:
        with tempfile.TemporaryDirectory(prefix=".tnst_mi-", dir=existing):
            pass
        occupied = out.exists() and any(out.iterdir())
    except OSError as error:
        raise InputError(f"{out}: cannot be written to ({error.strerror}); give another folder") from None
    if occupied and not occupied_ok:
        raise InputError(f"{out}: is not empty; continue its run with --resume, or replace it with --overwrite")


def finished_frames(out: Path, recipe: Recipe, weights: dict[str, Any]) -> list[dict[str, Any]]:
    """The records of the frames that a run to be resumed has finished; empty where it has not begun.

    Raises:
        InputError: the folder holds something else, or a run with another recipe or other weights.
    """
    if not out.exists() or not any(out.iterdir()):
        return []
    if not (out / "run.json").is_file() or not (out / "recipe.toml").is_file():
        raise InputError(f"{out}: holds no run that could be resumed (run.json and recipe.toml are not both there)")
    try:
        run = json.loads((out / "run.json").read_text("utf-8"))
        frames = [frame for frame in run["frames"] if frame["complete"]]
        earlier_weights = run["weights"]["sha256"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{out / 'run.json'}: damaged, so the run cannot be resumed; use --overwrite") from None
    earlier = Recipe.from_toml(out / "recipe.toml")
    for key in KINDS:
        before, now = getattr(earlier, key), getattr(recipe, key)
        if before != now:
            raise InputError(
                f"{out}: its run had {key} = {before!r} and the recipe now has {now!r}; "
                "resume with the same recipe, or use --overwrite"
            )
    if earlier_weights != weights["sha256"]:
        raise InputError(f"{out}: its run used other weights (sha256 {earlier_weights}); resume with the same ones")
    return frames


class RunFolder:
    """Writes the results of a run."""

    def __init__(self, out: Path, recipe: Recipe, overwrite: bool = False) -> None:
        """Make the folder ready, removing the results of an earlier run if they are to be overwritten."""
        self.out = out
        if overwrite:
            _remove_results(out)
        with written_whole(out / "recipe.toml") as temporary:
            temporary.write_text(recipe.to_toml(), "utf-8")

    def write_arrays(self, name: str, density: np.ndarray, velocity: np.ndarray) -> None:
        """Write the stylized density and the velocity that made it."""
        write_arrays(self.out / "density" / f"{name}.npz", {"density": density})
        write_arrays(self.out / "velocity" / f"{name}.npz", {"velocity": velocity})

    def write_images(self, name: str, before: np.ndarray, after: np.ndarray, attributes: dict[str, Any]) -> None:
        """Write the main view before and after, exposed alike; `attributes` go into the EXR headers."""
        images = self.out / "images"
        for suffix, image in (("before", before), ("after", after)):
            write_png(images / f"{name}_{suffix}.png", image)
            write_exr(images / f"{name}_{suffix}.exr", image, attributes)
        gap = np.ones((before.shape[0], _GAP), before.dtype)
        both = np.concatenate([before, gap, after], axis=1)
        scale = -(-_COMPARISON_HEIGHT // both.shape[0])
        both = resized(both, scale * both.shape[0], scale * both.shape[1])
        write_png(images / f"{name}_comparison.png", both)

    def write_history(self, name: str, history: list[dict[str, Any]]) -> None:
        """Add a frame's iterations to metrics.jsonl, in place of its earlier lines, and plot its loss."""
        path = self.out / "metrics.jsonl"
        lines = path.read_text("utf-8").splitlines() if path.exists() else []
        lines = [line for line in lines if json.loads(line)["frame"] != name]
        lines += [json.dumps({"frame": name, **entry}) for entry in history]
        with written_whole(path) as temporary:
            temporary.write_text("".join(line + "\n" for line in lines), "utf-8")
        if history:
            plot_loss(self.out / "images" / f"{name}_loss.png", name, history)

    def write_run(self, run: dict[str, Any]) -> None:
        """Write run.json."""
        with written_whole(self.out / "run.json") as temporary:
            temporary.write_text(json.dumps(run, indent=1) + "\n", "utf-8")


def plot_loss(path: Path, name: str, history: list[dict[str, Any]]) -> None:
    """Plot the loss over the iterations as PNG, a panel for each octave since each scales its terms anew."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    octaves = sorted({entry["octave"] for entry in history})
    figure = Figure(figsize=(4 * len(octaves), 3.5), layout="constrained")
    figure.suptitle(name)
    for axes, octave in zip(figure.subplots(1, len(octaves), squeeze=False)[0], octaves, strict=True):
        entries = [entry for entry in history if entry["octave"] == octave]
        axes.plot([entry["iteration"] for entry in entries], [entry["loss"] for entry in entries], marker=".")
        axes.set(title=f"octave {octave + 1} of {len(octaves)}", xlabel="iteration", ylabel="loss")
        axes.xaxis.get_major_locator().set_params(integer=True)
    with written_whole(path) as temporary:
        FigureCanvasAgg(figure).print_png(str(temporary))


def _remove_results(out: Path) -> None:
    for name in RESULTS:
        path = out / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)

"""The runs of a batch: every recipe on every input, each in a folder of its own, and what became of them."""

from __future__ import annotations

import itertools
import json
import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.machine.disk import require_writable
from tnst_mi.machine.gate import decoding
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.resources import expanded

#: What marks a folder as that of a batch.
RECORD = "batch.json"

#: What can become of a run: it has not begun, is under way, has ended, was ended early, or could not be done.
WAITING, RUNNING, DONE, INTERRUPTED, FAILED = "waiting", "running", "done", "interrupted", "failed"


@dataclass(frozen=True)
class Job:
    """A run of a batch.

    Attributes:
        recipe_name, input_name: by which people tell it from the others, and of its folders.
        recipe: of the run.
        source: file, folder or pattern of its frames.
        out: its folder.
    """

    recipe_name: str
    input_name: str
    recipe: Recipe
    source: Path
    out: Path


@dataclass(frozen=True)
class RunOutcome:
    """What has become of a run.

    Attributes:
        status: one of the words above.
        error: why it failed, in one line.
        frames: number of frames that are done.
        picture: the middle one's comparison of before and after, relative to the batch's folder.
        video: the preview of a sequence, likewise.
        loss_before, loss_after: means over the frames, of the fixed views.
        mass_change: relative change of the mass of all frames together.
        seconds: that it took.
    """

    status: str
    error: str | None = None
    frames: int = 0
    picture: str | None = None
    video: str | None = None
    loss_before: float | None = None
    loss_after: float | None = None
    mass_change: float | None = None
    seconds: float | None = None


def jobs_of(recipes: Mapping[Path, Recipe], inputs: Sequence[Path], out: Path) -> list[Job]:
    """Every recipe on every input, input after input.

    Args:
        recipes: by the files that they are from.
        inputs: files, folders or patterns.
        out: the folder of the batch; a run is in OUT/RECIPE/INPUT.

    Raises:
        InputError: there are no recipes or no inputs, or two runs would have the same folder.
    """
    if not recipes or not inputs:
        raise InputError(
            "batch: expected recipes (.toml) and inputs, one or more of each, such as thin.toml jet/ smoke.npz"
        )
    folders: dict[Path, tuple[Path, Path]] = {}
    jobs = []
    for source, (file, recipe) in itertools.product(inputs, recipes.items()):
        recipe_name, input_name = _name(file.stem), _name(source.name if expanded(source).is_dir() else source.stem)
        folder = out / recipe_name / input_name
        if folder in folders:
            others = [str(path) for path in folders[folder] if path not in (file, source)]
            ours = [str(path) for path in (file, source) if path not in folders[folder]]
            raise InputError(
                f"batch: {' and '.join(others or ours)} and {' and '.join(ours or others)} would share the "
                f"folder {recipe_name}/{input_name}; rename one, or give each once"
            )
        folders[folder] = file, source
        jobs.append(Job(recipe_name, input_name, recipe, source, folder))
    return jobs


def require_batch_folder(out: Path) -> None:
    """Check that a folder is new, empty, or that of a batch, and can be written to.

    Raises:
        InputError: it is not.
    """
    begun = (out / RECORD).is_file()
    require_writable(out, remedy=None if begun else "it holds no batch; give an empty or new folder")


def outcome_of(job: Job, batch: Path, error: str | None = None) -> RunOutcome:
    """What has become of a run by its run.json, or, if it could not be done, by the `error`.

    Raises:
        InputError: run.json is damaged.
    """
    file = job.out / "run.json"
    if error is not None or not file.is_file():
        return RunOutcome(WAITING if error is None else FAILED, error)
    with decoding(file, "the record of a run"):
        record = json.loads(file.read_text("utf-8"))
        frames = record["frames"]
        names = [frame["name"] for frame in frames]
        before, after = (sum(frame[f"mass_{when}"] for frame in frames) for when in ("before", "after"))
        return RunOutcome(
            record["status"],
            frames=len(frames),
            picture=_relative(job.out / "images" / f"{names[len(names) // 2]}_comparison.png", batch)
            if names
            else None,
            video=_relative(job.out / "images" / "preview.mp4", batch),
            loss_before=_mean(frame["loss_before"] for frame in frames),
            loss_after=_mean(frame["loss_after"] for frame in frames),
            mass_change=after / before - 1 if before > 0 else None,
            seconds=record.get("seconds"),
        )


def write_record(batch: Path, jobs: Sequence[Job], outcomes: Sequence[RunOutcome]) -> None:
    """Write what has become of all runs as batch.json."""
    rows: list[dict[str, Any]] = [
        {"recipe": job.recipe_name, "input": job.input_name, "source": str(job.source)}
        | {"folder": job.out.relative_to(batch).as_posix(), **asdict(outcome)}
        for job, outcome in zip(jobs, outcomes, strict=True)
    ]
    with written_whole(batch / RECORD) as temporary:
        temporary.write_text(json.dumps({"runs": rows}, indent=1, ensure_ascii=False) + "\n", "utf-8")


def _name(stem: str) -> str:
    """A file's or a pattern's name as that of a folder."""
    return re.sub(r"[^\w.-]+", "_", stem).strip("._") or "input"


def _mean(values: Any) -> float | None:
    there = [value for value in values if value is not None]
    return statistics.fmean(there) if there else None


def _relative(file: Path, batch: Path) -> str | None:
    return file.relative_to(batch).as_posix() if file.is_file() else None

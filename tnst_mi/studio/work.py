"""The tries and renders of a studio: begun from its settings, watched, and kept as its history."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.io.atomic import make_folder, written_whole
from tnst_mi.machine.disk import require_writable
from tnst_mi.machine.terminal import duration, one_line
from tnst_mi.recipe.paths import shipped_name
from tnst_mi.recipe.quality import DRAFT, FINAL
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.folder import DAMAGE
from tnst_mi.studio.live import LiveRun
from tnst_mi.studio.processes import DONE, FAILED, PAUSED, RUNNING, RunProcess, WorkRecord
from tnst_mi.studio.settings import GOAL_KEYS, OTHER_GOALS

#: Folders of both kinds of work below that of the studio, and what one of them is called.
TRIES, RENDERS = "tries", "renders"
_KINDS = {TRIES: "try", RENDERS: "render"}

_ID = re.compile(r"(?:tries|renders)/\d{4,6}")

#: Seconds between two looks at what runs, and how long a try may take to pause when the studio ends.
_INTERVAL, _PATIENCE = 0.4, 15.0

#: Points of a curve that are sent, at most.
_POINTS = 400


class StudioWork:
    """A try or a render.

    Args:
        name: such as "tries/0003".
        process: what does it.
    """

    def __init__(self, name: str, process: RunProcess) -> None:
        self.name, self.process = name, process
        self.live = LiveRun(process.folder, process.recipe_file, process.record.shape)
        self.goals, self.asked_at = _goals(process.recipe_file), _written_at(process.recipe_file)
        self.status = process.status()
        self._picture: str | None = None
        self.live.update()

    def update(self) -> bool:
        """Look again; whether something has changed."""
        before = self.status, self._picture
        self.status = self.process.status()
        self._picture = self._newest_picture()
        return self.live.update() or (self.status, self._picture) != before

    @property
    def picture(self) -> Path | None:
        """The comparison of a frame before and after, as far as the run has got."""
        pictures = sorted((self.process.folder / "images").glob("*_comparison.png"))
        return pictures[len(pictures) // 2] if pictures else None

    def described(self) -> dict[str, Any]:
        """What the page shows."""
        kind, number = self.name.split("/")
        losses, octaves = self.live.losses, self.live.octaves
        every = -(-len(losses) // _POINTS) or 1
        error = one_line(self.process.complaint()) if self.status == FAILED else None
        return {
            "id": self.name,
            "title": f"{_KINDS[kind]} {int(number)}",
            "status": self.status,
            "goals": self.goals,
            "line": self._line(),
            "error": error,
            "losses": losses[::every],
            "octaves": octaves[::every],
            "done": self.live.done,
            "total": self.live.total,
            "left": self.live.left if self.status == RUNNING else None,
            "picture": self._newest_picture(),
            "actions": self._actions(kind),
        }

    def _actions(self, kind: str) -> list[str]:
        if self.status == RUNNING:
            return ["pause"]
        if self.status == DONE:
            return ["open", *(["finish"] if kind == TRIES else [])]
        return ["resume"]

    def _line(self) -> str:
        """How far it has got, or what has come out, in a few words."""
        parts = [self.goals]
        losses, octaves = self.live.losses, self.live.octaves
        if self.status == DONE:
            parts += _outcome(self.process.folder)
        elif losses:
            parts.append(f"octave {octaves[-1] + 1}")
            parts.append(f"{self.live.done} of {self.live.total or '?'} iterations")
            parts.append(f"loss {losses[-1]:.4g}")
            if self.status == RUNNING and self.live.left is not None:
                parts.append(f"about {duration(self.live.left)} left")
        elif self.status == RUNNING:
            parts.append("begins")
        return ", ".join(parts)

    def _newest_picture(self) -> str | None:
        """What identifies the picture, which changes with every octave."""
        picture = self.picture
        try:
            return None if picture is None else str(picture.stat().st_mtime_ns)
        except OSError:
            return None


class Workshop:
    """All work of a studio, in its folder.

    Args:
        out: the folder of the studio, which need not exist.
        changed: called when something has changed; from other threads too.

    Raises:
        InputError: nothing can be written there.
    """

    def __init__(self, out: Path, changed: Callable[[], None]) -> None:
        require_writable(out, remedy=None)
        self._out, self._changed = out.absolute(), changed
        self._lock, self._busy, self._ended = threading.RLock(), threading.Event(), threading.Event()
        self._works = {work.name: work for work in self._found()}
        if any(work.status == RUNNING for work in self._works.values()):
            self._busy.set()
        self._watching = threading.Thread(target=self._watch, daemon=True)
        self._watching.start()

    def begin(self, kind: str, source: Path, recipe: Recipe, shape: Shape, alone: int | float | None = None) -> str:
        """Begin a try (a draft) or a render (the whole recipe), and return its name.

        Args:
            kind: `TRIES` or `RENDERS`.
            source: the input.
            recipe: for all frames.
            shape: (D, H, W) of these.
            alone: the number of the only frame that is to be stylized; None for all.

        Raises:
            InputError: the recipe has no goals.
        """
        record = WorkRecord(str(source.absolute()), shape, alone=alone is not None, frames=recipe.frames)
        return self._begin(kind, record, recipe if alone is None else replace(recipe, frames=str(alone)))

    def finish(self, name: str) -> str:
        """Begin to render what a try has begun, from where it ended; returns the name.

        Raises:
            InputError: there is no such try, or it is not done.
        """
        work = self.work(name)
        if work.status != DONE:
            raise InputError(f"studio: {name} is {work.status}: what is done can be rendered")
        record = replace(work.process.record, start_from=str(work.process.folder), pid=0, began=0.0, code=None)
        return self._begin(RENDERS, record, Recipe.from_toml(work.process.recipe_file))

    def pause(self, name: str) -> None:
        """Ask a run to end after the iteration under way."""
        self.work(name).process.pause()
        self._busy.set()

    def resume(self, name: str) -> None:
        """Go on with a run that is not done.

        Raises:
            InputError: there is no such run, or it runs, or is done.
        """
        with self._lock:
            work = self.work(name)
            work.update()
            if work.status not in (PAUSED, FAILED):
                raise InputError(f"studio: {name} is {work.status}: nothing is to be resumed")
            work.process.start()
            work.update()
        self._busy.set()
        self._changed()

    def work(self, name: str) -> StudioWork:
        """The work of a name.

        Raises:
            InputError: there is none.
        """
        with self._lock:
            if name not in self._works:
                raise InputError(one_line(f"studio: {name!r}: no such try or render"))
            return self._works[name]

    def described(self) -> list[dict[str, Any]]:
        """What the page shows, the latest first."""
        with self._lock:
            works = sorted(self._works.values(), key=lambda work: -work.asked_at)
            return [work.described() for work in works]

    def end(self) -> list[str]:
        """Pause the tries that run, and stop watching; returns the names of those paused."""
        self._ended.set()
        self._busy.set()
        with self._lock:
            running = [work for work in self._works.values() if work.name.startswith(TRIES) and work.status == RUNNING]
            for work in running:
                work.process.pause()
            for work in running:
                work.process.wait(_PATIENCE)
        return [work.name for work in running]

    def _begin(self, kind: str, record: WorkRecord, recipe: Recipe) -> str:
        if not any(getattr(recipe, key) for key in (*GOAL_KEYS, *OTHER_GOALS)):
            raise InputError("studio: nothing to stylize towards; choose a motif on the left")
        with self._lock:
            make_folder(self._out / kind)
            numbers = [int(file.stem) for file in (self._out / kind).glob("*.toml") if file.stem.isdigit()]
            name = f"{kind}/{max(numbers, default=0) + 1:04d}"
            process = RunProcess(self._out / name, record)
            quality = DRAFT if kind == TRIES else FINAL
            with written_whole(process.recipe_file) as temporary:
                temporary.write_text(replace(recipe, quality=quality).to_toml(), "utf-8")
            process.start()
            self._works[name] = StudioWork(name, process)
        self._busy.set()
        self._changed()
        return name

    def _found(self) -> list[StudioWork]:
        """What earlier studios have begun in this folder."""
        found = []
        for file in sorted(self._out.glob("*/*.toml")):
            name = file.relative_to(self._out).with_suffix("").as_posix()
            record = WorkRecord.read(file.with_suffix(".json")) if _ID.fullmatch(name) else None
            if record is not None:
                found.append(StudioWork(name, RunProcess(file.with_suffix(""), record)))
        return found

    def _watch(self) -> None:
        """Look at what runs, as long as something does."""
        while not self._ended.is_set():
            self._busy.wait()
            with self._lock:
                works = [work for work in self._works.values() if work.status == RUNNING]
                news = [work.update() for work in works]
                if not any(work.status == RUNNING for work in works):
                    self._busy.clear()
            if any(news):
                self._changed()
            self._ended.wait(_INTERVAL)


def _goals(recipe_file: Path) -> str:
    """The goals of a recipe in a few words."""
    try:
        recipe = Recipe.from_toml(recipe_file)
    except InputError:
        return "a damaged recipe"
    names = [Path(shipped_name(name)).stem for name in recipe.style]
    return " + ".join([*names, *recipe.tag, *recipe.semantic]) or "a recipe of its own"


def _written_at(file: Path) -> float:
    """When a file was written; 0 if it is gone."""
    try:
        return file.stat().st_mtime
    except OSError:
        return 0.0


def _outcome(folder: Path) -> list[str]:
    """The loss and the mass before and after, and the time that it took."""
    try:
        run = json.loads((folder / "run.json").read_text("utf-8"))
        frames = run["frames"]
        before, after = (sum(float(frame[f"mass_{when}"]) for frame in frames) for when in ("before", "after"))
        parts = [f"mass {after / before - 1:+.1%}"] if before > 0 else []
        losses = [(frame["loss_before"], frame["loss_after"]) for frame in frames if frame["loss_before"] is not None]
        if losses:
            means = [sum(float(loss) for loss in side) / len(losses) for side in zip(*losses, strict=True)]
            parts.insert(0, f"loss {means[0]:.3g} → {means[1]:.3g}")
        return [*parts, duration(float(run["seconds"]))]
    except DAMAGE:
        return []

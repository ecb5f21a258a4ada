"""The tries and renders of a studio: begun from its settings, watched, removed, and kept as its history."""

from __future__ import annotations

import sys
import threading
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.io.atomic import make_folder, written_whole
from tnst_mi.machine.disk import require_writable
from tnst_mi.machine.terminal import one_line
from tnst_mi.recipe.quality import DRAFT, FINAL, quality_beyond
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.studio.choices.networks import UsedNetwork
from tnst_mi.studio.choices.settings import GOAL_KEYS, OTHER_GOALS
from tnst_mi.studio.jobs.processes import DONE, RUNNING, RunProcess, WorkRecord
from tnst_mi.studio.jobs.removal import claimed_number, finish_removals, remove
from tnst_mi.studio.jobs.work import ID, RENDERS, TRIES, StudioWork
from tnst_mi.studio.plain import is_plain, plain_recipe

#: Seconds between two looks at what runs, and how long a run may take to end by itself when it is asked to.
_INTERVAL, _PATIENCE = 0.4, 15.0


class Workshop:
    """All work of a studio, in its folder.

    Args:
        out: the folder of the studio, which need not exist.
        changed: called when something has changed; from other threads too.
        require_own: checks that the folder is still this studio's, before something is written there.

    Raises:
        InputError: nothing can be written there.
    """

    def __init__(self, out: Path, changed: Callable[[], None], require_own: Callable[[], None] = lambda: None) -> None:
        require_writable(out, remedy=None)
        self._out, self._changed, self._require_own = out.absolute(), changed, require_own
        #: How many deletions are under way of what has these names.
        self._going: Counter[str] = Counter()
        self._lock, self._busy, self._ended = threading.RLock(), threading.Event(), threading.Event()
        for kind in (TRIES, RENDERS):
            finish_removals(self._out / kind)
        self._works = {work.name: work for work in self._found()}
        if any(work.status == RUNNING for work in self._works.values()):
            self._busy.set()
        self._watching = threading.Thread(target=self._watch, daemon=True)
        self._watching.start()

    def begin(
        self,
        kind: str,
        source: Path,
        recipe: Recipe,
        shape: Shape,
        alone: int | float | None = None,
        cluster: str | None = None,
    ) -> str:
        """Begin a try (a draft) or a render (the whole recipe), and return its name.

        Args:
            kind: `TRIES` or `RENDERS`.
            source: the input.
            recipe: for all frames.
            shape: (D, H, W) of these.
            alone: the number of the only frame that is to be stylized; None for all.
            cluster: address of the one that does it; None for a process of this machine.

        Raises:
            InputError: the recipe has no goals, or its network cannot be used.
        """
        record = WorkRecord(
            str(source.absolute()),
            shape,
            alone=alone is not None,
            frames=recipe.frames,
            cluster=cluster,
            network=UsedNetwork.of(recipe.weights).name,
        )
        recipe = recipe if alone is None else replace(recipe, frames=str(alone))
        with self._lock:
            name = self._begun(kind, record, replace(recipe, quality=DRAFT if kind == TRIES else FINAL))
        self._announce()
        return name

    def go_on(
        self, kind: str, name: str, octave: int | None, recipe: Recipe | None = None, cluster: str | None = None
    ) -> str:
        """Begin a try or a render that goes on from a state which another one has kept; returns its name.

        A try goes as far as a draft, or as a preview or to the end, if the state is that far already.

        Args:
            kind: `TRIES` or `RENDERS`.
            name: of the other one.
            octave: at whose end the state was kept, see `StudioWork.kept`.
            recipe: for the same frames; what must not differ from the other one's is said by the run (its `--from`).
                None for the same recipe.
            cluster: address of the one that does it; None for a process of this machine.

        Raises:
            InputError: there is no such state, or it is being deleted, or the recipe is run with another network.
        """
        with self._lock:  # until it is noted what this goes on from, which is then not deleted
            work = self.staying(name)
            folder, reached = work.kept(octave)
            earlier = plain_recipe(work.process.recipe_file)
            recipe = earlier if recipe is None else replace(recipe, frames=earlier.frames)
            network = work.require_network(recipe)
            recipe = replace(recipe, quality=quality_beyond(recipe, *reached) if kind == TRIES else FINAL)
            record = work.process.record.following(folder, cluster, network)
            begun = self._begun(kind, record, recipe)
        self._announce()
        return begun

    def pause(self, name: str) -> None:
        """Ask a run to end after the iteration under way."""
        self.work(name).process.pause()
        self._busy.set()

    def resume(self, name: str, cluster: str | None = None) -> None:
        """Go on with a run that is not done.

        Args:
            name: of the run.
            cluster: address of the one that goes on with a render; None for where it was done until now.

        Raises:
            InputError: there is no such run, or it runs, is done, cannot be done as it is, or is being deleted; or it
                would go on with another network.
        """
        with self._lock:
            work = self.staying(name)
            self._require_own()
            work.update()
            if not work.resumable:
                raise InputError(f"studio: {name} is {work.status}: nothing is to be resumed")
            work.require_network(plain_recipe(work.process.recipe_file))
            if cluster is not None and name.startswith(RENDERS):
                work.process.record = replace(work.process.record, cluster=cluster)
            work.process.start()
            work.update()
        self._announce()

    def delete(self, names: Collection[str]) -> None:
        """Stop tries or renders if they run, and remove them; what is gone already is left alone.

        Raises:
            InputError: one is no name of a try or a render; another one goes on from it and is not done; it cannot be
                removed; or it has been resumed meanwhile. Then those before it are removed.
        """
        for name in names:
            if not ID.fullmatch(name):
                raise InputError(one_line(f"studio: {name!r}: no such try or render"))
        with self._lock:
            self._require_own()
            self._require_unneeded(names)
            works = [work for name, work in self._works.items() if name in names]
            # From now on nothing begins from them.
            going = [work.name for work in works]
            self._going.update(going)
            for work in works:
                work.process.pause()
        try:
            for work in works:
                # Others are served while it comes to its end.
                work.process.wait(_PATIENCE)
                work.process.kill()
                work.process.wait(_PATIENCE)
                self._remove(work, names)
        finally:
            with self._lock:
                self._going.subtract(going)
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

    def staying(self, name: str) -> StudioWork:
        """The work of a name, which is not being deleted.

        Raises:
            InputError: there is none, or it is.
        """
        with self._lock:
            if self._going[name] > 0:
                raise InputError(f"studio: {name} is being deleted; choose another one")
            return self.work(name)

    def in_folder(self, folder: Path) -> str | None:
        """The name of the work that has a folder; None if none has it."""
        with self._lock:
            return next((name for name, work in self._works.items() if _is_same(work.process.folder, folder)), None)

    def holds(self, name: str) -> bool:
        """Whether there is a work of a name."""
        with self._lock:
            return name in self._works

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

    def _begun(self, kind: str, record: WorkRecord, recipe: Recipe) -> str:
        """Begin a try or a render, while the lock is held; returns its name."""
        if not any(getattr(recipe, key) for key in (*GOAL_KEYS, *OTHER_GOALS)):
            raise InputError("studio: nothing to stylize towards; choose a motif on the left")
        self._require_own()
        make_folder(self._out / kind)
        name = f"{kind}/{claimed_number(self._out / kind):04d}"
        process = RunProcess(self._out / name, record, self._require_own)
        with written_whole(process.recipe_file) as temporary:
            temporary.write_text(replace(recipe, keep_octaves=True).to_toml(), "utf-8")
        process.start()
        self._works[name] = StudioWork(name, process)
        return name

    def _announce(self) -> None:
        """Look at what has begun, and tell others; never while the lock is held, which those may wait for."""
        self._busy.set()
        self._changed()

    def _remove(self, work: StudioWork, names: Collection[str]) -> None:
        """Remove one of some that have been stopped, unless another tab was faster."""
        with self._lock:
            if self._works.get(work.name) is not work:
                return
            if work.process.status() == RUNNING:
                raise InputError(f"studio: {work.name} has been resumed meanwhile; delete it again")
            self._require_own()
            self._require_unneeded(names)
            remove(work.process.folder)
            del self._works[work.name]

    def _require_unneeded(self, names: Collection[str]) -> None:
        """Check that nothing that is left, and not done, goes on from what is to be removed."""
        for name, work in self._works.items():
            begun = work.process.record.start_from
            if name in names or work.status == DONE or begun is None:
                continue
            for other in names:
                if Path(begun).is_relative_to(self._out / other):
                    raise InputError(
                        f"studio: {name} goes on from {other} and is {work.status}; wait until it is done, or delete "
                        "it too"
                    )

    def _found(self) -> list[StudioWork]:
        """What earlier studios have begun in this folder; whatever else is there is left alone."""
        found = []
        for file in sorted(file for kind in (TRIES, RENDERS) for file in (self._out / kind).glob("*.toml")):
            try:
                name = file.relative_to(self._out).with_suffix("").as_posix()
                sound = ID.fullmatch(name) and file.is_file() and is_plain(file)
                record = WorkRecord.read(file.with_suffix(".json")) if sound else None
                if record is not None:
                    found.append(StudioWork(name, RunProcess(file.with_suffix(""), record, self._require_own)))
            except Exception as error:  # whatever is wrong with one, the studio shows the others
                _say(f"{file} is left alone ({type(error).__name__}: {error})")
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
            try:
                if any(news):
                    self._changed()
            except Exception as error:  # whatever it is, the next change must be seen
                _say(f"{type(error).__name__}: {error}")
            self._ended.wait(_INTERVAL)


def _say(text: str) -> None:
    print(one_line(f"tnst-mi: studio: {text}"), file=sys.stderr)


def _is_same(folder: Path, other: Path) -> bool:
    try:
        return folder.samefile(other)
    except (OSError, ValueError):  # one of them is gone, or has no name that can be
        return False

"""What all tabs of the page share: what is opened, and what is set; each tab hears of every change."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.machine.lock import FolderLock
from tnst_mi.machine.terminal import one_line
from tnst_mi.recipe.quality import FINAL
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.going_on import FREE
from tnst_mi.studio.choices.masks import MaskEdit
from tnst_mi.studio.choices.networks import NetworksTold, network_of_run, require_network
from tnst_mi.studio.choices.paintings import Paintings
from tnst_mi.studio.choices.settings import StudioSettings
from tnst_mi.studio.jobs.clusters import checked_address
from tnst_mi.studio.jobs.processes import DONE, WorkRecord
from tnst_mi.studio.jobs.work import RENDERS, title_of
from tnst_mi.studio.jobs.workshop import Workshop
from tnst_mi.studio.latest import LatestRecipe
from tnst_mi.studio.places import Places
from tnst_mi.studio.plain import plain_recipe, require_own
from tnst_mi.studio.remarks import Remark, fixed, stays, taken_over
from tnst_mi.studio.shown import Shown
from tnst_mi.studio.source import Source
from tnst_mi.studio.telling import News
from tnst_mi.studio.told import opened_told, physics_told
from tnst_mi.studio.view.opened import opened


class Session:
    """The state of a studio.

    Args:
        places: what may be opened.
        out: the folder of the studio's tries and renders.
        cluster: address of the one that renders, which has been checked; None for this machine.
        lock: of that folder; None for one that nobody else can have.
        weights: the key of all recipes, whatever they say; None to leave it as it is.

    Attributes:
        workshop: tries and renders.
        paintings: what has been painted on the page.
        start: the name of the try or render, and the octave of its state, from which the next one goes on; None to
            begin anew.
        settings: what is set.
        notice: why what was to be shown, or to be begun with, cannot be; None if it is, or something else has been
            opened.
        remark: what has been kept when something else was opened, or gone on from; None if nothing is to be said.
        require_own: checks that the folder is still this studio's; see `require_own`.
        shown: what is opened; None as long as nothing is.
    """

    def __init__(
        self,
        places: Places,
        out: Path,
        cluster: str | None = None,
        lock: FolderLock | None = None,
        weights: str | None = None,
    ) -> None:
        self.places, self.cluster = places, cluster
        self._chosen = {} if weights is None else {"weights": weights}
        self._networks = NetworksTold()
        self.require_own = functools.partial(require_own, out, lock)
        self._latest = LatestRecipe(out, self.require_own)
        self.settings = StudioSettings(values=self._latest.values | self._chosen)
        self.start: tuple[str, int | None] | None = None
        self.shown: Shown | None = None
        self.notice: str | None = self._latest.trouble
        self.remark: Remark | None = None
        self._news = News()
        self.workshop = Workshop(out, self._changed, self.require_own)
        self.paintings = Paintings(out / "masks")

    def open(self, path: Path) -> None:
        """Show densities or a run at a path, whose recipe is taken over with its goals.

        A try of one frame is shown among all frames of its input, and its recipe is for as many as before; so is that
        of another input, since frames of one are not those of another.

        Raises:
            InputError: nothing is there that can be shown, or it is being deleted.
        """
        name = self.workshop.in_folder(path)
        record = None if name is None else self.workshop.staying(name).process.record
        alone = record is not None and record.alone
        found = opened(path, alone)
        shown = Shown.of(found)
        with self._news.lock:
            self.remark = None
            if found.recipe is None:
                self.remark = stays(self.settings, self.shown and self.shown.source, shown.source)
                self.settings.take_all_frames()
            else:
                self._take_over(found.recipe, record)
            self.shown, self.start, self.notice = shown, None, None
            self._changed()

    @property
    def source(self) -> Source:
        """The input that is stylized: what is opened, or what the opened run has stylized.

        Raises:
            InputError: nothing is opened, or the run had no file as its input.
        """
        source = self.opened().source
        if source is None:
            raise InputError("studio: the input of this run was no file; open one")
        return source

    def set(self, key: str, value: object) -> None:
        """Set a slider; see `StudioSettings.set`."""
        with self._news.lock:
            if key not in FREE:
                self.require_anew()
            self.settings.set(key, value)
            self._changed()

    def toggle(self, key: str, goal: str) -> None:
        """Add or remove a goal; see `StudioSettings.toggle`."""
        with self._news.lock:
            self.require_anew()
            self.settings.toggle(key, goal, self._networks.of(self.settings.recipe.weights)["flavour"])
            self._changed()

    def clear(self) -> None:
        """Remove all goals and masks."""
        with self._news.lock:
            self.require_anew()
            self.settings, self.remark = self.settings.cleared(), None
            self._changed()

    def edit_mask(self, edit: MaskEdit, frame: int = 0) -> None:
        """Edit a mask of the recipe.

        Args:
            edit: of the mask. What begins to follow the smoke does so from the shown frame.
            frame: index of that frame.

        Raises:
            InputError: nothing is opened, there is no such mask, or what becomes of it cannot be used in that frame.
        """
        with self._news.lock:
            self.require_anew()
            painter, settings = self.opened().painter, self.settings
        edit = edit.from_frame(painter.opened.results.numbers, painter.index(frame))
        if edit.action != "remove":  # which must be possible with what cannot be used
            painter.masks.mask(settings.edited(edit).recipe, edit.target, frame)
        with self._news.lock:
            self.settings = self.settings.edited(edit)
            self._changed()

    def paint_mask(self, body: bytes, target: int, view: tuple[float, float], frame: int) -> None:
        """Add what has been painted over a view of a frame to the mask of a target; see `Paintings.added`."""
        self.require_anew()
        self.paintings.added(body, target, view, lambda edit: self.edit_mask(edit, frame))

    def opened(self) -> Shown:
        """What is opened.

        Raises:
            InputError: nothing is.
        """
        shown = self.shown
        if shown is None:
            raise InputError("studio: nothing is opened; choose something on the left")
        return shown

    def recipe(self) -> Recipe:
        """The recipe as it is set."""
        with self._news.lock:
            return self.settings.recipe

    def open_work(self, name: str) -> None:
        """Show what a try or a render has made, with its recipe, for as many frames as before.

        Raises:
            InputError: there is no such work, or it has not finished a frame.
        """
        self.open(self.workshop.work(name).process.folder)

    def take_all_frames(self) -> None:
        """Let the recipe be of all frames of an input."""
        with self._news.lock:
            self.settings.take_all_frames()
            self._changed()

    def begin(self, kind: str, alone: int | None) -> None:
        """Begin a try or a render of what is opened, with the recipe as it is set; see `Workshop.begin`.

        Args:
            kind: which of them.
            alone: index among the shown frames of the only one that is to be stylized; None for all.

        Raises:
            InputError: there is nothing to stylize, or nothing to stylize towards, or no such frame, or a file is gone
                that the recipe names, or what is shown was made by another network.
        """
        with self._news.lock:
            source, shown, recipe, start = self.source, self.opened(), self.settings.recipe, self.start
            self.settings.require_files()
        cluster = self.cluster if kind == RENDERS else None
        if start is not None:
            self.workshop.go_on(kind, *start, recipe, cluster)
            return
        require_network(shown.results.title, network_of_run(shown.results.record), recipe.weights, "open its input")
        number = None if alone is None else source.only(shown.results.numbers[shown.painter.index(alone)], recipe)
        self.workshop.begin(kind, source.path, recipe, shown.painter.opened.shape, number, cluster)

    def go_on_from(self, name: str, octave: int | None) -> None:
        """Take over the recipe of a try or a render, and let the next one go on from a state that it has kept.

        What has been set of sliders that may differ stays as it is set.

        Args:
            name: of the try or the render.
            octave: at whose end the state was kept, from 0; None for the end of the run.

        Raises:
            InputError: there is no such state, or its input cannot be opened any more.
        """
        work = self.workshop.staying(name)
        work.kept(octave)
        free = self.settings.free()
        if work.status == DONE:
            self.open_work(name)
        else:
            recipe = plain_recipe(work.process.recipe_file)
            self.open(Path(work.process.record.source))
            with self._news.lock:
                self._take_over(recipe, work.process.record)
        with self._news.lock:
            kept = self.settings.set_again(free)
            self.start, self.remark = (name, octave), taken_over(title_of(name), kept)
            self._changed()

    def begin_anew(self) -> None:
        """Let the next try or render begin anew."""
        with self._news.lock:
            self.start = self.remark = None
            self._changed()

    def require_anew(self) -> None:
        """Check that nothing is gone on from, whose goals, masks and other settings are fixed."""
        if self.start is not None:
            raise fixed(title_of(self.start[0]))

    def delete(self, names: Collection[str]) -> None:
        """Remove tries or renders, see `Workshop.delete`; in place of one that is shown, its input is."""
        shown = self.shown
        name = None if shown is None else self.workshop.in_folder(shown.results.path)
        try:
            self.workshop.delete(names)
        finally:
            start = self.start
            if start is not None and not self.workshop.holds(start[0]):
                self.begin_anew()
            if name is not None and not self.workshop.holds(name) and self.shown is shown:
                self._show_input()

    def set_cluster(self, text: str) -> None:
        """Render on a cluster from now on, or on this machine if the address is empty; see `checked_address`."""
        address = checked_address(text, self.places)
        with self._news.lock:
            self.cluster = address
            self._changed()

    def state(self) -> dict[str, Any]:
        """All that a tab has to know, as values for JSON."""
        work = self.workshop.described()
        with self._news.lock:
            shown, recipe = self.shown, self.settings.recipe
            name = None if shown is None else self.workshop.in_folder(shown.results.path)
            return {
                "work": work,
                "version": self._news.version,
                "start": None if self.start is None else {"id": self.start[0], "octave": self.start[1]},
                "cluster": self.cluster or "",
                "opened": None if shown is None else opened_told(shown, self.places, recipe, name),
                "physics": physics_told(recipe),
                "notice": self.notice,
                "remark": None if self.remark is None else vars(self.remark),
                "network": self._networks.of(recipe.weights),
                **self.settings.described(),
            }

    def news(self) -> Iterator[str]:
        """The state as JSON, now and whenever it has changed; empty texts while nothing changes."""
        return self._news.told(self.state)

    def end(self) -> list[str]:
        """End all `news`, and pause the tries; returns the names of those that ran."""
        self._news.end()
        return self.workshop.end()

    def _take_over(self, recipe: Recipe, record: WorkRecord | None) -> None:
        """Take over the recipe of a run; of a try of one frame, for as many as before."""
        frames = record.frames if record is not None and record.alone else recipe.frames
        self.settings = StudioSettings(dataclasses.replace(recipe, quality=FINAL, frames=frames, **self._chosen))

    def _show_input(self) -> None:
        """Show the input of what was shown and is gone; nothing, and why, if it is gone too."""
        try:
            self.open(self.source.path)
        except InputError as error:
            with self._news.lock:
                self.shown, self.notice = None, one_line(str(error))
                self._changed()

    def _changed(self) -> None:
        with self._news.lock:
            recipe = self.settings.recipe
            self._latest.keep(dataclasses.replace(recipe, weights=None) if self._chosen else recipe)
            self._news.changed()

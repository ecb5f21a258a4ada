"""What all tabs of the page share: what is opened, and what is set; each tab hears of every change."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.files.frame_numbers import Number
from tnst_mi.recipe.quality import FINAL
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.studio.choices.masks import MaskEdit
from tnst_mi.studio.choices.paintings import Paintings
from tnst_mi.studio.choices.settings import StudioSettings
from tnst_mi.studio.jobs.clusters import checked_address
from tnst_mi.studio.jobs.processes import DONE
from tnst_mi.studio.jobs.work import RENDERS
from tnst_mi.studio.jobs.workshop import Workshop
from tnst_mi.studio.latest import LatestRecipe
from tnst_mi.studio.places import Places
from tnst_mi.studio.plain import plain_recipe
from tnst_mi.studio.source import Source
from tnst_mi.studio.telling import json_text
from tnst_mi.studio.told import opened_told, physics_told
from tnst_mi.studio.view.lit import LitPainter
from tnst_mi.studio.view.opened import opened
from tnst_mi.studio.view.painting import SightPainter
from tnst_mi.studio.view.sight import Sight

#: Seconds after which a connection without news is told that it is still one.
_STILL_HERE = 15.0

_NOTHING = "studio: nothing is opened; choose something on the left"


class Session:
    """The state of a studio.

    Args:
        places: what may be opened.
        out: the folder of the studio's tries and renders.
        cluster: address of the one that renders, which has been checked; None for this machine.

    Attributes:
        workshop: tries and renders.
        paintings: what has been painted on the page.
        start: the name of the try or render, and the octave of its state, from which the next one goes on; None to
            begin anew.
        settings: what is set.
        notice: why what the studio was started with cannot be shown; None if it is, or something else has been opened.
        painter, lit: paint what is opened; None as long as nothing is.
    """

    def __init__(self, places: Places, out: Path, cluster: str | None = None) -> None:
        self.places, self._latest, self.cluster = places, LatestRecipe(out), cluster
        self.settings = StudioSettings(self._latest.recipe)
        self.start: tuple[str, int | None] | None = None
        self.painter: SightPainter | None = None
        self.lit: LitPainter | None = None
        self._source: Source | None = None
        self.notice: str | None = None
        self._news, self._version, self._ended = threading.Condition(), 0, False
        self.workshop = Workshop(out, self._changed)
        self.paintings = Paintings(out / "masks")

    def open(self, path: Path, all_frames: bool = False) -> None:
        """Show densities or a run, whose recipe is taken over with its goals.

        Args:
            path: where they are.
            all_frames: whether to show a run among all frames of its input.

        Raises:
            InputError: nothing is there that can be shown.
        """
        found = opened(path, all_frames)
        source = Source.of(found.results)
        with self._news:
            self.painter, self.lit = SightPainter(found), LitPainter(found)
            if found.recipe is not None:
                self.settings = StudioSettings(dataclasses.replace(found.recipe, quality=FINAL))
            self._source = source
            self.start = self.notice = None
            self._changed()

    @property
    def source(self) -> Source:
        """The input that is stylized: what is opened, or what the opened run has stylized.

        Raises:
            InputError: nothing is opened, or the run had no file as its input.
        """
        self._opened()
        if self._source is None:
            raise InputError("studio: the input of this run was no file; open one")
        return self._source

    def set(self, key: str, value: object) -> None:
        """Set a slider; see `StudioSettings.set`."""
        with self._news:
            self.settings.set(key, value)
            self._changed()

    def toggle(self, key: str, goal: str) -> None:
        """Add or remove a goal; see `StudioSettings.toggle`."""
        with self._news:
            self.settings.toggle(key, goal)
            self._changed()

    def edit_mask(self, edit: MaskEdit, frame: int = 0) -> None:
        """Edit a mask of the recipe.

        Args:
            edit: of the mask. What begins to follow the smoke does so from the shown frame.
            frame: index of that frame.

        Raises:
            InputError: nothing is opened, there is no such mask, or what becomes of it cannot be used in that frame.
        """
        with self._news:
            painter, settings = self._opened(), self.settings
        number = painter.opened.results.numbers[painter.index(frame)]
        if edit.values.get("follow") is True and isinstance(number, int) and len(painter.opened.results.numbers) > 1:
            edit = dataclasses.replace(edit, values={**edit.values, "follow": number})
        if edit.action != "remove":  # which must be possible with what cannot be used
            painter.masks.mask(settings.edited(edit).recipe, edit.target, frame)
        with self._news:
            self.settings = self.settings.edited(edit)
            self._changed()

    def paint_mask(self, body: bytes, target: int, view: tuple[float, float], frame: int) -> None:
        """Add what has been painted over a view of a frame to the mask of a target.

        Args:
            body: the file of a picture with transparency, of the whole frame of the view; see `Paintings.keep`.
            target: index of the target.
            view: (azimuth, elevation) in degrees.
            frame: index of the frame.

        Raises:
            InputError: see `edit_mask` and `Paintings.keep`.
        """
        file = self.paintings.keep(body)
        try:
            self.edit_mask(MaskEdit("add", target, values={"image": str(file), "view": list(view)}), frame)
        except InputError:
            file.unlink()
            raise

    def place(self, frame: int) -> dict[str, Any]:
        """Where a frame, by its index, lies in the scene; see `MaskOverlay.place`."""
        with self._news:
            painter = self._opened()
        return painter.masks.place(painter.index(frame))

    def share(self, target: int, frame: int) -> float | None:
        """The part of the smoke of a frame, by its index, that is in the mask of a target; see `MaskOverlay.share`."""
        with self._news:
            painter, recipe = self._opened(), self.settings.recipe
        return painter.masks.share(recipe, target, painter.index(frame))

    def paint(self, query: Mapping[str, str]) -> tuple[Sight, np.ndarray]:
        """What a tab wants to see, by the query of `Sight.of_query`, and its picture with values in [0, 1].

        Raises:
            InputError: nothing is opened, or it cannot be seen so.
        """
        with self._news:
            painter, lit, recipe = self.painter, self.lit, self.settings.recipe
        if painter is None or lit is None:
            raise InputError(_NOTHING)
        sight = Sight.of_query(query, len(painter.opened.results.frames))
        return sight, lit.paint(sight) if sight.lit else painter.paint(sight, recipe)

    def arrows(self, query: Mapping[str, str]) -> dict[str, Any]:
        """v* as arrows in the picture of a query, as values for JSON; see `SightPainter.arrows`.

        Raises:
            InputError: nothing is opened, or it has no v*.
        """
        with self._news:
            painter = self._opened()
        return painter.arrows(Sight.of_query(query, len(painter.opened.results.frames))).described()

    def recipe(self) -> Recipe:
        """The recipe as it is set."""
        with self._news:
            return self.settings.recipe

    def open_work(self, name: str) -> None:
        """Show what a try or a render has made, with its recipe, for as many frames as before.

        Raises:
            InputError: there is no such work, or it has not finished a frame.
        """
        process = self.workshop.work(name).process
        self.open(process.folder, process.record.alone)
        if process.record.alone:
            with self._news:
                self.settings.base = dataclasses.replace(self.settings.base, frames=process.record.frames)
                self._changed()

    def begin(self, kind: str, alone: Number | None) -> None:
        """Begin a try or a render of what is opened, with the recipe as it is set; see `Workshop.begin`.

        Args:
            kind: which of them.
            alone: number of the only frame that is to be stylized; None for all.

        Raises:
            InputError: there is nothing to stylize, or nothing to stylize towards, or no such frame.
        """
        with self._news:
            source, recipe, painter, start = self.source, self.settings.recipe, self.painter, self.start
        cluster = self.cluster if kind == RENDERS else None
        if start is not None:
            self.workshop.go_on(kind, *start, recipe, cluster)
            return
        assert painter is not None  # there is a source
        number = source.only(alone, recipe)
        self.workshop.begin(kind, source.path, recipe, painter.opened.shape, number, cluster)

    def go_on_from(self, name: str, octave: int | None) -> None:
        """Take over the recipe of a try or a render, and let the next one go on from a state that it has kept.

        Args:
            name: of the try or the render.
            octave: at whose end the state was kept, from 0; None for the end of the run.

        Raises:
            InputError: there is no such state, or its input cannot be opened any more.
        """
        work = self.workshop.work(name)
        work.kept(octave)
        if work.status == DONE:
            self.open_work(name)
        else:
            recipe = plain_recipe(work.process.recipe_file)
            self.open(Path(work.process.record.source))
            with self._news:
                self.settings = StudioSettings(dataclasses.replace(recipe, quality=FINAL))
        with self._news:
            self.start = name, octave
            self._changed()

    def begin_anew(self) -> None:
        """Let the next try or render begin anew."""
        with self._news:
            self.start = None
            self._changed()

    def delete(self, names: Collection[str]) -> None:
        """Remove tries or renders, see `Workshop.delete`; in place of one that is shown, its input is."""
        try:
            self.workshop.delete(names)
        finally:
            with self._news:
                if self.start is not None and not self.workshop.holds(self.start[0]):
                    self.start = None
                shown = None if self.painter is None else self.painter.opened.results.path
                gone, source = shown is not None and not shown.exists(), self._source
            if gone and source is not None:
                self.open(source.path)

    def set_cluster(self, text: str) -> None:
        """Render on a cluster from now on, or on this machine if the address is empty; see `checked_address`."""
        address = checked_address(text, self.places)
        with self._news:
            self.cluster = address
            self._changed()

    def state(self) -> dict[str, Any]:
        """All that a tab has to know, as values for JSON."""
        work = self.workshop.described()
        with self._news:
            painter, recipe = self.painter, self.settings.recipe
            shown = None if painter is None else self.workshop.in_folder(painter.opened.results.path)
            return {
                "work": work,
                "version": self._version,
                "start": None if self.start is None else {"id": self.start[0], "octave": self.start[1]},
                "cluster": self.cluster or "",
                "opened": None if painter is None else opened_told(painter, self.places, recipe, self._source, shown),
                "physics": physics_told(recipe),
                "notice": self.notice,
                **self.settings.described(),
            }

    def news(self) -> Iterator[str]:
        """The state as JSON, now and whenever it has changed; empty texts while nothing changes."""
        known = -1
        while not self._ended:
            with self._news:
                self._news.wait_for(lambda known=known: self._version != known or self._ended, _STILL_HERE)
                changed, known = self._version != known, self._version
            yield json_text(self.state()) if changed else ""

    def end(self) -> list[str]:
        """End all `news`, and pause the tries; returns the names of those that ran."""
        with self._news:
            self._ended = True
            self._news.notify_all()
        return self.workshop.end()

    def _opened(self) -> SightPainter:
        if self.painter is None:
            raise InputError(_NOTHING)
        return self.painter

    def _changed(self) -> None:
        with self._news:
            self._latest.keep(self.settings.recipe)
            self._version += 1
            self._news.notify_all()

"""The states of a run at the end of each octave but its last, octaves/N: each is a run that ended there.

So `--from RUN/octaves/1` goes on from the end of the first octave, with all that is checked of other runs, and while
the run itself goes on too. What a run has reached in the end is in its own state/.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tnst_mi.io.atomic import written_whole
from tnst_mi.io.pictures.png import write_png
from tnst_mi.optimisation.glimpse import Glimpses, SmokeColour
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.before_after import side_by_side
from tnst_mi.run.folder import OCTAVES, holds_run
from tnst_mi.run.states import write_state


def octave_folder(out: Path, octave: int) -> Path:
    """The folder of what a run keeps of an octave, counted from 0; its name counts from 1, as people do."""
    return out / OCTAVES / str(octave + 1)


def kept_octaves(out: Path) -> list[int]:
    """The octaves, counted from 0, of which the run in a folder has kept the end."""
    folders = (out / OCTAVES).glob("*")
    numbers = sorted(int(folder.name) for folder in folders if folder.name.isdecimal() and holds_run(folder))
    return [number - 1 for number in numbers if number > 0]


class KeptOctaves:
    """Keeps the state of all frames, and the main view of one, at the end of each octave.

    Args:
        out: the folder of the run.
        recipe: of the run.
        record: the contents of its run.json so far.
        shown: index of the frame whose picture is kept.
        colours: those of a frame by its index, before it is stylized; None for a grey one.
        may_write: called before anything is written; raises if that must not happen any more.
    """

    def __init__(
        self,
        out: Path,
        recipe: Recipe,
        record: Mapping[str, Any],
        shown: int,
        colours: Callable[[int], SmokeColour | None],
        may_write: Callable[[], None],
    ) -> None:
        self._out, self._recipe, self._record = out, recipe, record
        self._shown, self._colours, self._may_write = shown, colours, may_write

    def octave_done(self, glimpses: Glimpses) -> None:
        """An octave of all frames is done, and it is not the last one.

        Raises:
            OSError: the folder cannot be written.
        """
        self._may_write()
        folder = octave_folder(self._out, glimpses.octave)
        frames = [{"name": name, "state": write_state(folder, name, state)} for name, state in glimpses.states()]
        for name, before, after in glimpses.of([self._shown], self._colours):
            write_png(folder / "images" / f"{name}_comparison.png", side_by_side(before, after))
        with written_whole(folder / "recipe.toml") as temporary:
            temporary.write_text(self._recipe.to_toml(), "utf-8")
        # Last: it makes the folder that of a run.
        record = {**self._record, "status": "octave", "frames": frames}
        with written_whole(folder / "run.json") as temporary:
            temporary.write_text(json.dumps(record, indent=1) + "\n", "utf-8")

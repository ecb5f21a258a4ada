"""A try or a render of a studio: how far it has got, what the page shows of it, and what can be done with it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError, MissingFileError
from tnst_mi.machine.terminal import displayable, duration, one_line
from tnst_mi.recipe.paths import shipped_name
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.folder import DAMAGE
from tnst_mi.run.kept_octaves import kept_octaves, octave_folder
from tnst_mi.studio.choices.networks import require_network
from tnst_mi.studio.jobs.live import LiveRun
from tnst_mi.studio.jobs.processes import DONE, FAILED, INTERRUPTED, PAUSED, RUNNING, RunProcess
from tnst_mi.studio.plain import is_plain, plain_json, plain_recipe

#: Folders of both kinds of work below that of the studio, and what one of them is called.
TRIES, RENDERS = "tries", "renders"
_KINDS = {TRIES: "try", RENDERS: "render"}

#: What they are called in the folder of the studio.
ID = re.compile(r"(?:tries|renders)/\d{4,6}")

#: Points of a curve that are sent, at most, and their digits: more than its pixels show.
_POINTS, _DIGITS = 140, 4


def title_of(name: str) -> str:
    """What the page calls a try or a render.

    Example:
        >>> title_of("tries/0003")
        'try 3'
    """
    kind, number = name.split("/")
    return f"{_KINDS[kind]} {int(number)}"


class StudioWork:
    """A try or a render.

    Args:
        name: such as "tries/0003".
        process: what does it.
    """

    def __init__(self, name: str, process: RunProcess) -> None:
        self.name, self.process = name, process
        self.live = LiveRun(process.folder, process.recipe_file, process.record.shape)
        self.goals, self.subject, self.asked_at = "", "", _written_at(process.recipe_file)
        self._named = False
        self.status = INTERRUPTED
        self._described: dict[str, Any] = {}
        self.update()

    def update(self) -> bool:
        """Look again; whether something has changed. Whatever is wrong with its files is said where it is shown."""
        before = self._described
        try:
            self.status = self.process.status()
            if not self._named:
                self.goals, self.subject = _goals(self.process.recipe_file), _subject(self.process)
                self._named = True
            self.live.update()
            self._described = self._now()
        except Exception as error:  # others must not suffer from what is wrong with this one, which may be anything
            self._described = self._damaged(error)
        return self._described != before

    @property
    def picture(self) -> Path | None:
        """The comparison of a frame before and after, as far as the run has got."""
        return _comparison(self.process.folder)

    def picture_of(self, octave: int) -> Path | None:
        """Likewise at the end of an octave, counted from 0, of which the state is kept."""
        return _comparison(octave_folder(self.process.folder, octave))

    def kept(self, octave: int | None) -> tuple[Path, tuple[int, int]]:
        """A state from which another run can go on: the folder that it has, its octave, and the iterations done there.

        Args:
            octave: the one, counted from 0, at whose end it was kept; None for that in which the run has ended.

        Raises:
            InputError: there is none.
        """
        if octave is None and self.status != RUNNING and (reached := self._reached()) is not None:
            return self.process.folder, reached
        if octave is not None and octave in kept_octaves(self.process.folder):
            folder = octave_folder(self.process.folder, octave)
            if (reached := _recorded_state(folder)) is not None:
                return folder, reached
        where = "its end" if octave is None else f"octave {octave + 1}"
        raise InputError(f"studio: {self.name} has kept no state of {where}; choose one of those that it shows")

    @property
    def resumable(self) -> bool:
        """Whether it can be gone on with: also what has failed on a cluster, which may be done elsewhere."""
        failed_elsewhere = self.status == FAILED and self.process.record.cluster is not None
        return self.status in (PAUSED, INTERRUPTED) or failed_elsewhere

    def require_network(self, recipe: Recipe) -> str:
        """The name of the network with which a recipe goes on from here; see `networks.require_network`."""
        return require_network(title_of(self.name), self.process.record.network, recipe.weights, "begin anew")

    def described(self) -> dict[str, Any]:
        """What the page shows, as it was found by the last `update`."""
        return self._described

    def _now(self) -> dict[str, Any]:
        kind = self.name.split("/")[0]
        losses, octaves = self.live.losses, self.live.octaves
        every = -(-len(losses) // _POINTS) or 1
        ended_early = self.status in (FAILED, INTERRUPTED)
        picture = self.picture
        return {
            "id": self.name,
            "title": title_of(self.name),
            "of": self.subject,
            "alone": self.process.record.alone,
            "status": self.status,
            "goals": self.goals,
            "line": self._line(),
            "error": one_line(self.process.ending()) if ended_early else self.process.trouble,
            "losses": [float(f"{loss:.{_DIGITS}g}") for loss in losses[::every]],
            "octaves": octaves[::every],
            "done": self.live.done,
            "total": self.live.total,
            "left": self.live.left if self.status == RUNNING else None,
            "picture": None if picture is None else _version(picture),
            "states": self._states(),
            "cluster": self.process.record.cluster,
            "network": self.process.record.network,
            "dashboard": self.process.dashboard() if self.status == RUNNING else None,
            "actions": self._actions(kind),
        }

    def _damaged(self, error: Exception) -> dict[str, Any]:
        """What the page shows where the files of a run cannot be understood."""
        shown = {"id": self.name, "title": title_of(self.name), "status": self.status, "goals": self.goals}
        shown |= {"of": self.subject, "alone": self.process.record.alone}
        said = {"line": self.goals, "error": one_line(f"its files are damaged ({type(error).__name__}: {error})")}
        unknown = dict.fromkeys(("total", "left", "picture", "cluster", "network", "dashboard"))
        empty: dict[str, Any] = {"losses": [], "octaves": [], "done": 0, "states": []}
        actions = ["pause", "delete"] if self.status == RUNNING else ["delete"]
        return shown | said | unknown | empty | {"actions": actions}

    def _states(self) -> list[dict[str, Any]]:
        """The states from which another run can go on, by their octaves; that of None is where the run has ended."""
        folder = self.process.folder
        states = [
            {
                "octave": octave,
                "title": f"end of octave {octave + 1}",
                "picture": self.picture_of(octave) is not None,
            }
            for octave in kept_octaves(folder)
        ]
        if self.status != RUNNING and (reached := self._reached()) is not None:
            octave, iterations = reached
            ended = "the end" if self.status == DONE else "where it stopped"
            title = f"{ended}: octave {octave + 1}, iteration {iterations}"
            states.append({"octave": None, "title": title, "picture": self.picture is not None})
        return states

    def _reached(self) -> tuple[int, int] | None:
        """The octave and the iterations in it that are done, from which another run can go on; None if there are none.

        A run that has gone on from the end of another may have done none of its own.
        """
        return _recorded_state(self.process.folder) if self.status == DONE else self.live.reached

    def _actions(self, kind: str) -> list[str]:
        if self.status == RUNNING:
            return ["pause", "delete"]
        if self.status == DONE:
            return ["open", *(["finish"] if kind == TRIES else []), "delete"]
        return ["resume", "delete"] if self.resumable else ["delete"]

    def _origin(self) -> str | None:
        """The title of the try or render that this one has gone on from, if there is one in the same folder."""
        begun, out = self.process.record.start_from, self.process.folder.parents[1]
        if begun is None or not Path(begun).is_relative_to(out):
            return None
        name = "/".join(Path(begun).relative_to(out).parts[:2])
        return title_of(name) if ID.fullmatch(name) else None

    def _line(self) -> str:
        """How far it has got, or what has come out, in a few words."""
        parts = [self.goals]
        if (origin := self._origin()) is not None:
            parts.append(f"from {origin}")
        losses, octaves = self.live.losses, self.live.octaves
        if self.status == DONE:
            parts += _outcome(self.process.folder)
        elif losses:
            parts.append(f"octave {octaves[-1] + 1}")
            parts.append(f"{self.live.done} of {self.live.total or '?'} iterations")
            parts.append(f"loss in this octave {losses[-1]:.4g}")
            if self.status == RUNNING and self.live.left is not None:
                parts.append(f"about {duration(self.live.left)} left")
        elif self.status == RUNNING:
            parts.append("begins")
        if (network := self.process.record.network) is not None:
            parts.append(f"network {network.split()[0]}")
        return ", ".join(parts)


def _comparison(folder: Path) -> Path | None:
    """The picture of the middle frame of a run, before and after; links are not followed."""
    pictures = sorted((folder / "images").glob("*_comparison.png"))
    middle = pictures[len(pictures) // 2] if pictures else None
    return None if middle is None or not is_plain(middle, folder) else middle


def _version(file: Path) -> str | None:
    """What changes when a file is written anew; None if it is gone."""
    try:
        return str(file.stat().st_mtime_ns)
    except OSError:
        return None


def _recorded_state(folder: Path) -> tuple[int, int] | None:
    """The octave and the iterations of the state that a run has written of all its frames; None if there is none."""
    try:
        states = [frame["state"] for frame in plain_json(folder / "run.json")["frames"]]
        octaves, iterations = ([int(state[key]) for state in states] for key in ("octave", "iterations"))
        return max(octaves), min(iterations)
    except DAMAGE:
        return None


def _goals(recipe_file: Path) -> str:
    """The goals of a recipe in a few words."""
    try:
        recipe = plain_recipe(recipe_file)
    except MissingFileError:
        return "a recipe of which a file is gone"
    except InputError:
        return "a damaged recipe"
    names = [Path(shipped_name(name)).stem for name in recipe.style]
    return " + ".join([*names, *recipe.tag, *recipe.semantic]) or "a recipe of its own"


def _subject(process: RunProcess) -> str:
    """The input of a run in a few words, and the frame that it is of, if it is of one alone."""
    source = Path(process.record.source)
    name = displayable(source.name if source.is_dir() else source.stem)
    if not process.record.alone:
        return name
    try:
        return f"{name}, frame {plain_recipe(process.recipe_file).frames}"
    except InputError:
        return name


def _written_at(file: Path) -> float:
    """When a file was written; 0 if it is gone."""
    try:
        return file.stat().st_mtime
    except OSError:
        return 0.0


def _outcome(folder: Path) -> list[str]:
    """The loss and the mass before and after, and the time that it took."""
    try:
        run = plain_json(folder / "run.json")
        frames = run["frames"]
        before, after = (sum(float(frame[f"mass_{when}"]) for frame in frames) for when in ("before", "after"))
        parts = [f"mass {_change(after / before - 1)}"] if before > 0 else []
        losses = [(frame["loss_before"], frame["loss_after"]) for frame in frames if frame["loss_before"] is not None]
        if losses:
            means = [sum(float(loss) for loss in side) / len(losses) for side in zip(*losses, strict=True)]
            parts.insert(0, f"loss in the fixed views {means[0]:.3g} → {means[1]:.3g}")
        return [*parts, duration(float(run["seconds"]))]
    except DAMAGE:
        return []


def _change(by: float) -> str:
    """A change in percent; without a sign where it rounds to none.

    Example:
        >>> _change(-0.0001), _change(-0.012)
        ('0.0%', '-1.2%')
    """
    text = f"{by:+.1%}"
    return text[1:] if text[1:] == "0.0%" else text

"""What the page can ask of tries and renders, and do with them, by the paths of its URLs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import printable
from tnst_mi.studio.jobs.work import RENDERS, TRIES
from tnst_mi.studio.page.messages import PageAnswer, PageRequest, text_in
from tnst_mi.studio.plain import excerpt, plain_bytes
from tnst_mi.studio.session import Session

#: Bytes of a log that are shown, at most; octaves that a recipe may have; and names that are deleted at once.
_LONGEST_TEXT, _MOST_OCTAVES, _MOST_NAMES = 1 << 18, 16, 2000

_KINDS = {"try": TRIES, "render": RENDERS}


class WorkRoutes:
    """Answers what concerns tries and renders.

    Args:
        session: what all tabs share.

    Attributes:
        routes: by method and path.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self.routes: Mapping[tuple[str, str], Callable[[PageRequest], PageAnswer]] = {
            ("GET", "/work/picture"): self._picture,
            ("GET", "/work/recipe"): lambda request: self._text(request, ".toml"),
            ("GET", "/work/log"): lambda request: self._text(request, ".log"),
            ("POST", "/work"): self._act,
            ("POST", "/cluster"): self._cluster,
        }

    def _act(self, request: PageRequest) -> PageAnswer:
        values, session = request.json(), self._session
        action = text_in(values, "action")
        if action in _KINDS:
            session.begin(_KINDS[action], _frame(values.get("alone")))
        elif action == "delete":
            session.delete(_names(values))
        elif action == "anew":
            session.begin_anew()
        elif action == "all-frames":
            session.take_all_frames()
        elif action == "branch":
            session.go_on_from(text_in(values, "id"), _octave(values.get("octave")))
        else:
            act = {
                "pause": session.workshop.pause,
                "resume": lambda name: session.workshop.resume(name, session.cluster),
                "finish": lambda name: session.workshop.go_on(RENDERS, name, None, cluster=session.cluster),
                "open": session.open_work,
            }.get(action)
            if act is None:
                raise InputError(
                    "studio: an action is try, render, pause, resume, finish, open, branch, anew, all-frames or delete"
                )
            act(text_in(values, "id"))
        return PageAnswer.of_json({})

    def _cluster(self, request: PageRequest) -> PageAnswer:
        self._session.set_cluster(text_in(request.json(), "address"))
        return PageAnswer.of_json({})

    def _picture(self, request: PageRequest) -> PageAnswer:
        work = self._session.workshop.work(request.query.get("id", ""))
        octave = request.query.get("octave")
        picture = work.picture if octave is None else work.picture_of(_octave(octave))
        return PageAnswer(_content(picture, work.process.folder), "image/png")

    def _text(self, request: PageRequest, suffix: str) -> PageAnswer:
        process = self._session.workshop.work(request.query.get("id", "")).process
        text = printable_lines(excerpt(process.folder.with_suffix(suffix), _LONGEST_TEXT, last=True))
        return PageAnswer(text.encode("utf-8"), "text/plain; charset=utf-8")


def printable_lines(text: str) -> str:
    """A text of several lines, without what controls a terminal."""
    return "\n".join(printable(line) for line in text.splitlines())


def _content(picture: Path | None, folder: Path) -> bytes:
    """What a picture in the folder of a run holds, which may be removed, or written anew, at any time."""
    try:
        if picture is not None:
            return plain_bytes(picture, folder)
    except OSError:
        pass
    raise InputError("studio: there is no picture, or none any more")


def _frame(value: Any) -> int | None:
    """The index of the frame that is to be tried alone; None for all."""
    if not isinstance(value, int | None) or isinstance(value, bool):
        raise InputError("studio: alone is the index of a frame, from 0, or nothing for all")
    return value


def _octave(value: Any) -> Any:
    """The index of an octave, of a query or of a JSON value; None for the end of a run."""
    if value is None:
        return None
    index = int(value) if isinstance(value, str) and value.isdecimal() and len(value) < 4 else value
    if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < _MOST_OCTAVES:
        raise InputError(f"studio: octave is an index from 0 to {_MOST_OCTAVES - 1}, or nothing for the end")
    return index


def _names(values: Mapping[str, Any]) -> list[str]:
    names = values.get("ids")
    if not isinstance(names, list) or len(names) > _MOST_NAMES or not all(isinstance(name, str) for name in names):
        raise InputError(f"studio: ids is a list of at most {_MOST_NAMES} tries and renders")
    return names

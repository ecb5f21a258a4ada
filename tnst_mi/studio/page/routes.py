"""What the page can ask for and do, by the paths of its URLs."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np
from PIL import Image

from tnst_mi.errors import InputError
from tnst_mi.io.pictures.png import eight_bits
from tnst_mi.resources import DATA
from tnst_mi.studio.choices.examples import ExampleMaker
from tnst_mi.studio.choices.masks import MaskEdit
from tnst_mi.studio.choices.motifs import MotifBrowser
from tnst_mi.studio.choices.similarity import PictureAnswers
from tnst_mi.studio.page.messages import PageAnswer, PageRequest, text_in
from tnst_mi.studio.page.server import ALIKE, PAINTING, UPLOAD
from tnst_mi.studio.page.work_routes import WorkRoutes
from tnst_mi.studio.session import Session

#: The scripts of the page.
_SCRIPTS = (
    *("requests.js", "view.js", "movement.js", "projection.js", "gizmos.js", "brush.js", "regions.js"),
    *("choices.js", "alike.js", "examples.js", "knobs.js", "pointed.js", "work.js", "studio.js"),
)

#: The files of the page.
_PAGE = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/studio.css": ("studio.css", "text/css; charset=utf-8"),
    **{f"/{name}": (name, "text/javascript; charset=utf-8") for name in _SCRIPTS},
}

#: Quality of JPEG while the camera moves, and when it is still.
_MOVING, _STILL = 80, 92


class StudioRoutes:
    """Answers the requests of the page.

    Args:
        session: what all tabs share.
        motifs: what can be chosen.
        examples: makes pictures of these.
    """

    def __init__(self, session: Session, motifs: MotifBrowser, examples: ExampleMaker) -> None:
        self._examples = examples
        self.session, self.motifs, self._answers = session, motifs, PictureAnswers()
        self._routes: dict[tuple[str, str], Callable[[PageRequest], PageAnswer]] = {
            ("GET", "/events"): self._events,
            ("GET", "/view"): self.view,
            ("GET", "/arrows"): lambda request: PageAnswer.of_json(session.opened().arrows(request.query)),
            ("GET", "/files"): self._files,
            ("GET", "/motifs"): self._motifs,
            ("GET", "/thumbnail"): self._thumbnail,
            ("GET", "/examples"): lambda request: PageAnswer.of_json(examples.described()),
            ("POST", "/examples"): self._make_examples,
            ("POST", UPLOAD): self._upload,
            ("POST", ALIKE): self._alike,
            ("GET", "/place"): self._place,
            ("GET", "/share"): self._share,
            ("POST", "/mask"): self._mask,
            ("POST", PAINTING): self._painting,
            ("POST", "/open"): self._open,
            ("POST", "/set"): self._set,
            ("POST", "/goal"): self._goal,
            ("POST", "/clear"): self._clear,
            **WorkRoutes(session).routes,
        }

    def __call__(self, request: PageRequest) -> PageAnswer:
        """Answer a request.

        Raises:
            InputError: it cannot be done.
        """
        if request.method == "GET" and request.path in _PAGE:
            name, kind = _PAGE[request.path]
            return PageAnswer((DATA / "studio" / name).read_bytes(), kind)
        if route := self._routes.get((request.method, request.path)):
            return route(request)
        return PageAnswer.of_json({"error": "nothing is there"}, 404)

    def view(self, request: PageRequest) -> PageAnswer:
        """A picture of what is opened, as JPEG; see `Shown.paint`."""
        sight, picture = self.session.opened().paint(request.query, self.session.recipe())
        body = jpeg(picture, _MOVING if sight.coarse else _STILL)
        return PageAnswer(body, "image/jpeg")

    def _events(self, request: PageRequest) -> PageAnswer:
        return PageAnswer(kind="text/event-stream", events=self.session.news())

    def _files(self, request: PageRequest) -> PageAnswer:
        return PageAnswer.of_json(self.session.places.entries(request.query.get("at", "")))

    def _motifs(self, request: PageRequest) -> PageAnswer:
        weights = self.session.recipe().weights
        return PageAnswer.of_json(self.motifs.found(request.query.get("find", ""), weights))

    def _alike(self, request: PageRequest) -> PageAnswer:
        weights = self.session.recipe().weights
        answer = self._answers.answer(request.query.get("name", ""), request.body, weights)
        return PageAnswer.of_json(self.motifs.alike(request.query.get("find", ""), weights, answer))

    def _thumbnail(self, request: PageRequest) -> PageAnswer:
        picture = self.motifs.thumbnail(*(request.query.get(of) for of in ("style", "atlas", "made")))
        # As long as the studio runs, a name means the same picture.
        return PageAnswer(picture, "image/png", headers={"Cache-Control": "max-age=300"})

    def _make_examples(self, request: PageRequest) -> PageAnswer:
        self.session.require_own()
        goals, weights = request.json().get("goals"), self.session.recipe().weights
        if not isinstance(goals, list):
            raise InputError("studio: goals is missing, or no list")
        self._examples.ask(goals, self.motifs.tags(weights), weights)
        return PageAnswer.of_json(self._examples.described())

    def _upload(self, request: PageRequest) -> PageAnswer:
        self.session.require_own()
        self.session.require_anew()
        goal = self.motifs.upload(request.query.get("name", ""), request.body)
        self.session.toggle("style", goal)
        return PageAnswer.of_json({})

    def _open(self, request: PageRequest) -> PageAnswer:
        self.session.open(self.session.places.within(text_in(request.json(), "path")))
        return PageAnswer.of_json({})

    def _set(self, request: PageRequest) -> PageAnswer:
        values = request.json()
        self.session.set(text_in(values, "key"), values.get("value"))
        return PageAnswer.of_json({})

    def _goal(self, request: PageRequest) -> PageAnswer:
        values = request.json()
        key, goal = text_in(values, "key"), text_in(values, "goal")
        # What a recipe came with can be removed, whether or not it could be chosen here.
        if goal not in self.session.settings.goals(key):
            self.motifs.require_offered(key, goal, self.session.recipe().weights)
        self.session.toggle(key, goal)
        return PageAnswer.of_json({})

    def _clear(self, request: PageRequest) -> PageAnswer:
        self.session.clear()
        return PageAnswer.of_json({})

    def _place(self, request: PageRequest) -> PageAnswer:
        return PageAnswer.of_json(self.session.opened().place(request.whole("frame")))

    def _share(self, request: PageRequest) -> PageAnswer:
        share = self.session.opened().share(self.session.recipe(), request.whole("target"), request.whole("frame"))
        return PageAnswer.of_json({"share": share})

    def _mask(self, request: PageRequest) -> PageAnswer:
        values = request.json()
        frame = values.get("frame", 0)
        if not isinstance(frame, int) or isinstance(frame, bool):
            raise InputError("mask: frame is the index of a frame, from 0")
        self.session.edit_mask(MaskEdit.of_json(values), frame)
        return PageAnswer.of_json({})

    def _painting(self, request: PageRequest) -> PageAnswer:
        self.session.require_own()
        view = request.number("azimuth"), request.number("elevation")
        self.session.paint_mask(request.body, request.whole("target"), view, request.whole("frame"))
        return PageAnswer.of_json({})


def jpeg(picture: np.ndarray, quality: int) -> bytes:
    """A picture (H, W) or (H, W, 3) in [0, 1] as JPEG."""
    encoded = io.BytesIO()
    Image.fromarray(eight_bits(picture)).save(encoded, "JPEG", quality=quality)
    return encoded.getvalue()

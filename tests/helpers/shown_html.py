"""What HTML shows: its texts, and the pixels of the pictures that are embedded in it."""

from __future__ import annotations

import base64
import io
import re
from html.parser import HTMLParser

import numpy as np
from PIL import Image

_VOID = {"img", "input", "meta", "br"}


class ShownHtml(HTMLParser):
    """Parsed HTML, which must be well formed and refer to nothing outside of it.

    Attributes:
        tags: the names of all elements.
        attributes: of the elements, by the name of each: a list of dicts.
        texts: all texts.
    """

    def __init__(self, source: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: dict[str, list[dict[str, str | None]]] = {}
        self.texts: list[str] = []
        self._open: list[str] = []
        self.feed(source)
        self.close()
        assert self._open == []
        # No address of anything else: the characters of an embedded picture have no colon.
        assert re.search(r"https?:|://|url\(|@import", source) is None

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes.setdefault(tag, []).append(dict(attrs))
        for name, value in attrs:
            assert not name.startswith("on")
            assert name not in ("src", "href") or str(value).startswith("data:image/png;base64,")
        if tag not in _VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    @property
    def text(self) -> str:
        """All texts, in one."""
        return " ".join(self.texts)

    @property
    def pictures(self) -> list[np.ndarray]:
        """The pixels of every picture."""
        return [pixels(image["src"]) for image in self.attributes.get("img", [])]


def pixels(address: str | None) -> np.ndarray:
    """The pixels of a PNG that its address holds."""
    assert address is not None
    kind, _, data = address.partition(",")
    assert kind == "data:image/png;base64"
    with Image.open(io.BytesIO(base64.b64decode(data, validate=True)), formats=["PNG"]) as image:
        assert image.mode == "L"
        return np.asarray(image)

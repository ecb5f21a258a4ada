"""What the server passes to the routes, and what these give back."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import one_line
from tnst_mi.studio.telling import json_text


@dataclass(frozen=True)
class PageRequest:
    """A request of the page that has been let in.

    Attributes:
        method: GET or POST.
        path: without the query, such as /view.
        query: each key once.
        body: of a POST, bounded in size.
    """

    method: str
    path: str
    query: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""

    def number(self, name: str) -> float:
        """A number of the query.

        Raises:
            InputError: it is none, or not finite.
        """
        text = self.query.get(name, "")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(one_line(f"{self.path}: {name} = {text!r}: expected a number"))
        return value

    def whole(self, name: str) -> int:
        """A whole number of the query; see `number`."""
        value = self.number(name)
        if not value.is_integer():
            raise InputError(one_line(f"{self.path}: {name} = {value:g}: expected a whole number"))
        return int(value)

    def json(self) -> dict[str, Any]:
        """The body as a JSON object.

        Raises:
            InputError: it is none.
        """
        try:
            values = json.loads(self.body)
        except (ValueError, RecursionError):
            values = None
        if not isinstance(values, dict):
            raise InputError(f"{self.path}: the body is not a JSON object")
        return values


@dataclass(frozen=True)
class PageAnswer:
    """An answer to the page.

    Attributes:
        body: its bytes.
        kind: their media type.
        status: of HTTP.
        headers: further ones.
        events: in place of a body, texts that are sent as they come (server-sent events), empty ones to keep the
            connection open.
    """

    body: bytes = b""
    kind: str = "application/json"
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)
    events: Iterator[str] | None = None

    @classmethod
    def of_json(cls, values: Any, status: int = 200) -> PageAnswer:
        """Values as JSON."""
        return cls(json_text(values).encode("utf-8"), status=status)


def text_in(values: Mapping[str, Any], name: str) -> str:
    """A text among the values of a request.

    Raises:
        InputError: it is missing, or none.
    """
    value = values.get(name)
    if not isinstance(value, str):
        raise InputError(f"studio: {name} is missing, or no text")
    return value

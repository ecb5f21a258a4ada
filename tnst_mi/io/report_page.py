"""Pages of reports: one look, filled from templates that ship with the package."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from tnst_mi.io.atomic import written_whole
from tnst_mi.resources import DATA


def page(template: str, **values: Any) -> str:
    """A page as HTML; `template` is the name of a file among the package's data."""
    templates = Environment(
        loader=FileSystemLoader(DATA), autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
    )
    return templates.get_template(template).render(values)


def embedded(png: bytes) -> str:
    """A PNG as the address of an image that is part of the page."""
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"


def write_text(path: Path, text: str) -> None:
    """Write a text, whole or not at all."""
    with written_whole(path) as temporary:
        temporary.write_text(text, "utf-8")

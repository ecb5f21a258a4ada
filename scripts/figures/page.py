"""docs/figures.md: all figures that were made, with what the paper claims, what we measure and where we differ."""

from __future__ import annotations

import io
import json
import textwrap
from pathlib import Path
from typing import Any

from PIL import Image

from figures import MODULES
from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole

#: Largest width of a picture on the page in pixels, and largest size of its file in bytes.
_WIDEST, _LARGEST = 1400, 250_000

_HEAD = """# The paper's figures

Each figure and table of the paper, made by one command of `scripts/reproduce.py`: what the paper claims, what we see
and measure, and where we differ. Everything here was made by `python scripts/reproduce.py all` at its small size, on
grids of about 64 cells across ({machine}). `--size paper` takes the paper's settings and simulations of
200×300×200 cells, which `scripts/simulate.py` makes. This page is written by `python scripts/reproduce.py page`.

✓ marks a claim that the numbers in it bear out, ✗ one that they do not. Times are those of a machine with other work to
do.

| figure | claims borne out | seconds |
|---|---|---|
{rows}
"""

_SECTION = """
## {title}

`{command}`

{paper}

![{title}](images/figures/{name}.png)

{claims}

{differs}Made in {seconds:.0f} s.
"""


def write_page(out: Path, docs: Path) -> None:
    """Write `docs`/figures.md and its pictures, `docs`/images/figures/NAME.png, from the figures found in `out`.

    Raises:
        InputError: there is no figure in `out`.
    """
    names = [name for name in MODULES if (out / f"{name}.json").exists() and (out / f"{name}.png").exists()]
    if not names:
        raise InputError(f"{out}: holds no figure; make some with scripts/reproduce.py FIGURE --out {out}")
    records = {name: json.loads((out / f"{name}.json").read_text("utf-8")) for name in names}
    for name in names:
        path = docs / "images" / "figures" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as temporary, Image.open(out / f"{name}.png") as picture:
            temporary.write_bytes(palette_png(picture))
    with written_whole(docs / "figures.md") as temporary:
        temporary.write_text(page(records), "utf-8")


def page(records: dict[str, dict[str, Any]]) -> str:
    """The page in Markdown, from the JSON of each figure by its name."""
    rows = "\n".join(_row(record) for record in records.values())
    machines = dict.fromkeys(_machine(record["device"]) for record in records.values())
    return _HEAD.format(rows=rows, machine=" or ".join(machines)) + "".join(
        _SECTION.format(
            name=name,
            title=record["title"],
            command=record["command"],
            paper=_wrapped(f"**The paper:** {record['paper']}"),
            claims="\n".join(_wrapped(f"- {_mark(claim)} {claim['text']}.", "  ") for claim in record["claims"]),
            differs=_wrapped(f"**Where we differ:** {record['differs']}") + "\n\n" if record["differs"] else "",
            seconds=record["seconds"],
        )
        for name, record in records.items()
    )


def palette_png(picture: Image.Image, widest: int = _WIDEST, largest: int = _LARGEST) -> bytes:
    """A picture as PNG of at most 256 colours, made smaller until its width and its file are within bounds."""
    picture = picture.convert("RGB")
    scale = min(1.0, widest / picture.width)
    while True:
        size = (max(1, round(picture.width * scale)), max(1, round(picture.height * scale)))
        small = picture.resize(size, Image.Resampling.LANCZOS) if scale < 1 else picture
        data = io.BytesIO()
        small.quantize(256, dither=Image.Dither.NONE).save(data, "PNG", optimize=True)
        if data.tell() <= largest or size == (1, 1):
            return data.getvalue()
        scale *= 0.85


def _row(record: dict[str, Any]) -> str:
    title, claims = record["title"], record["claims"]
    held = sum(claim["holds"] for claim in claims)
    return f"| [{title}](#{_anchor(title)}) | {held} of {len(claims)} | {record['seconds']:.0f} |"


def _wrapped(text: str, indent: str = "") -> str:
    return textwrap.fill(text, 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _mark(claim: dict[str, Any]) -> str:
    return "✓" if claim["holds"] else "✗"


def _anchor(title: str) -> str:
    """What a heading is linked by: its letters, digits, hyphens and underscores, with hyphens for spaces."""
    return "".join(c for c in title.lower().replace(" ", "-") if c.isalnum() or c in "-_")


def _machine(device: dict[str, Any]) -> str:
    threads = f" with {device['threads']} threads" if "threads" in device else ""
    return f"`{device['variant']}`{threads}"

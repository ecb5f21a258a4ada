"""What is told of a reconstruction: report.json, and report.html, which shows the same with its pictures."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import mitsuba as mi
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tnst_mi.io.report_page import embedded, page, write_text
from tnst_mi.machine import environment
from tnst_mi.reconstruction.preparation import Preparation
from tnst_mi.reconstruction.settings import SETTING_KINDS, ReconstructionSettings

#: Views of a frame whose pictures are on the page, at most: of more, those that are shown worst.
_VIEWS = 12


def write_report(out: Path, prepared: Preparation, records: Sequence[Mapping[str, Any]], finished: bool) -> None:
    """Write how smoke was reconstructed, and how well; report.json last, so that it vouches for the rest.

    Args:
        out: the folder of the results, with the pictures.
        prepared: what was reconstructed.
        records: of the frames that there are.
        finished: whether the last of them is.

    Raises:
        OSError: something cannot be written, or a picture is gone.
    """
    told = {
        "cameras": str(prepared.cameras.file),
        "finished": finished and len(records) == len(prepared.frames),
        "settings": asdict(prepared.settings),
        "shape": list(prepared.place.shape),
        "voxel_size": prepared.place.placement.voxel_size,
        "corner": list(prepared.place.placement.corner),
        "up": prepared.place.placement.up,
        "views": [view.name for view in prepared.views if not view.held_out],
        "held_out": [view.name for view in prepared.views if view.held_out],
        "assumed": [*prepared.remarks, *remarks_of_frames(records)],
        "frames": list(records),
        "versions": environment.versions(),
        "device": environment.device(mi.variant()),
    }
    shown = [_pictured(out, record) for record in _shown(records)]
    settings, usual = prepared.settings, ReconstructionSettings()
    chosen = [
        (name, kind.show(getattr(settings, name)), getattr(settings, name) != getattr(usual, name))
        for name, kind in SETTING_KINDS.items()
    ]
    figure = embedded(_png(convergence_figure(records)))
    html = page(
        "reconstruction.html",
        report=told,
        device=environment.device_line(mi.variant()),
        shown=shown,
        settings=chosen,
        convergence=figure,
    )
    write_text(out / "report.html", html)
    write_text(out / "report.json", json.dumps(told, indent=1, allow_nan=False, default=str) + "\n")


def remarks_of_frames(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """What is to be said of frames, once where it is the same of several; of a sequence, with their names.

    Example:
        >>> remarks_of_frames([{"name": f"smoke_{n}", "number": n, "remarks": ["dark"]} for n in (1, 2, 3)])
        ['dark (smoke_1 and 2 other frames)']
    """
    frames: dict[str, list[str]] = {}
    for record in records:
        for remark in record.get("remarks", ()):
            frames.setdefault(remark, []).append("" if record["number"] is None else record["name"])
    found = []
    for remark, (first, *others) in frames.items():
        more = f" and {len(others)} other frame{'s' * (len(others) > 1)}" if others else ""
        found.append(f"{remark} ({first}{more})" if first else remark)
    return found


def convergence_figure(records: Sequence[Mapping[str, Any]]) -> Figure:
    """How far the pictures of each step were from the renderings; a dotted line is where a finer grid begins."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    axes = figure.subplots()
    for record in records:
        steps, errors, before = [], [], 0
        for level in record["convergence"]:
            if level["rms"]:
                each = level["steps"] / len(level["rms"])
                steps += [before + each * (number + 0.5) for number in range(len(level["rms"]))]
                errors += [100 * rms for rms in level["rms"]]
                before += level["steps"]
                axes.axvline(before, color="0.7", linestyle=":", linewidth=1)
        axes.plot(steps, errors, linewidth=1, label=record["name"] if len(records) <= _VIEWS else None)
    axes.set(xlabel="step", ylabel="RMS of rendering − picture, % of the peak", yscale="log")
    if 1 < len(records) <= _VIEWS:
        axes.legend()
    return figure


def _shown(records: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The frames whose pictures are on the page: the first, the last, and the one that is shown worst."""
    judged = [record for record in records if record["psnr"] is not None]
    worst = [min(judged, key=lambda record: record["psnr"])["name"]] if judged else []
    names = {records[0]["name"], records[-1]["name"], *worst}
    return [record for record in records if record["name"] in names]


def _pictured(out: Path, record: Mapping[str, Any]) -> dict[str, Any]:
    """A record with its pictures: those of its sides, and of the views that were held out, the worst first."""

    def picture(name: str) -> str:
        return embedded((out / "images" / f"{record['name']}_{name}.png").read_bytes())

    views = sorted(record["psnr_of_views"].items(), key=lambda view: float("inf") if view[1] is None else view[1])
    pictures = [{"name": name, "psnr": psnr, "picture": picture(name)} for name, psnr in views[:_VIEWS]]
    return {**record, "sides": picture("sides"), "views": pictures, "not_shown": len(views) - len(pictures)}


def _png(figure: Figure) -> bytes:
    held = io.BytesIO()
    FigureCanvasAgg(figure).print_png(held)
    return held.getvalue()

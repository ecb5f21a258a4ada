"""The output of a comparison of any two renderers.

report.html   everything, with pictures       report.json   every number, see `record`
pixels.npz    the numbers of every pixel, for a later comparison of which this is the baseline
figures/*.png                                 images/*.exr  mean images of either side, and their difference
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from pathlib import Path
from typing import Any

from tnst_mi.compare.bench import plots
from tnst_mi.compare.bench.baseline import pixel_columns
from tnst_mi.compare.bench.bench_settings import BenchSettings
from tnst_mi.compare.bench.measurement import Measured
from tnst_mi.compare.bench.record import PIXELS
from tnst_mi.compare.figures import write_figure
from tnst_mi.io.grids.npz import write_arrays
from tnst_mi.io.pictures.exr import write_exr
from tnst_mi.io.report_page import page, write_text


def write_bench(out: Path, settings: BenchSettings, measured: Measured, record: dict[str, Any]) -> None:
    """Write everything into a folder; report.json last, so that it vouches for the rest."""
    names = (settings.left.text, settings.right.text)
    figures = {}
    for number, pair in enumerate(measured.images):
        figures[f"images_{number}"] = plots.pair_figure(pair, measured.views, names)
        for view in range(len(measured.views)):
            for side, image in (("left", pair.left.mean), ("right", pair.right.mean)):
                _write_image(out / "images" / f"{number}_view_{view}_{side}.exr", image[view], pair.where)
    if record["convergence"]:
        figures["convergence"] = plots.convergence_figure(record["convergence"])
    figures["tails"] = plots.tail_figure(measured.families())
    taken = [row for row in record["derivatives"] if row["left"] or row["right"]]
    if taken:
        figures["derivatives"] = plots.derivative_figure(taken)
    encoded = {}
    for name, figure in figures.items():
        path = out / "figures" / f"{name}.png"
        write_figure(path, figure)
        encoded[name] = base64.b64encode(path.read_bytes()).decode("ascii")
    pixels = next(tests for tests in measured.families() if tests.name == "pixels")
    write_arrays(out / PIXELS, pixel_columns(pixels))
    record = record | {"pixels": hashlib.sha256((out / PIXELS).read_bytes()).hexdigest()}
    write_text(out / "report.html", page("compare_sides.html", record=record, figures=encoded))
    write_text(out / "report.json", json.dumps(record, indent=1, allow_nan=False) + "\n")


def _write_image(path: Path, image: Any, where: str) -> None:
    attributes = {"what": re.sub(r"\W+", " ", where, flags=re.ASCII).strip() or "scene"}
    write_exr(path, image[..., 0] if image.shape[-1] == 1 else image, attributes)

"""What is told of a reconstruction: the page, and the pictures of its smoke."""

from __future__ import annotations

import json
import re

import numpy as np

from tnst_mi.reconstruction.output.sides import three_sides
from tnst_mi.reconstruction.reconstruct import reconstruct


def test_the_page_has_everything_in_it(views, tmp_path):
    text = views.read_text().replace("[views.held_out_01]", '[views."1 < 2"]')
    assert "1 < 2" in text
    (views.parent / "named.toml").write_text(text)
    keys = {"iterations": 3, "levels": 1, "batch": 3}
    found = reconstruct(views.parent / "named.toml", tmp_path / "out", keys, progress=False)
    html = (tmp_path / "out" / "report.html").read_text()
    # Its pictures are part of it: one of three sides, three views, the convergence.
    sources = re.findall(r'src="(.{0,30})', html)
    assert len(sources) == 5 and all(source.startswith("data:image/png;base64,") for source in sources)
    assert "http" not in re.sub(r'src="[^"]*"', "", html)
    assert "1 &lt; 2" in html and "1 < 2" not in html
    told = [f"{psnr:.1f} dB" for psnr in (found.records[0]["psnr"], *found.records[0]["psnr_of_views"].values())]
    assert all(psnr in html for psnr in told) and "<b>iterations</b></td><td>3<" in html
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [(level["steps"], len(level["rms"])) for level in report["frames"][0]["convergence"]] == [(3, 3)]


def test_three_sides_of_smoke():
    """A box at the left, below and in front is where a viewer sees it."""
    extinction = np.zeros((4, 6, 5), np.float32)
    extinction[3, 0, 0:2] = 0.7  # z near the viewer of the front, y below, x on the left
    picture = three_sides(extinction)
    assert picture.shape == (6, 7 + 6 + 7)
    front, right, above = picture[:, 1:6], picture[:, 8:12], picture[1:5, 14:19]
    assert np.argwhere(front > 0).tolist() == [[5, 0], [5, 1]] and np.isclose(front.max(), 1 - np.exp(-0.7))
    # From +x, what is in front is on the left; from above, it is at the bottom.
    assert np.argwhere(right > 0).tolist() == [[5, 0]] and np.isclose(right.max(), 1 - np.exp(-1.4))
    assert np.argwhere(above > 0).tolist() == [[3, 0], [3, 1]]

"""The notebooks of docs/notebooks run, and show what they say they do. They are kept without outputs."""

from __future__ import annotations

import ast
import json
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from shown_html import ShownHtml

import tnst_mi

NOTEBOOKS = Path(__file__).resolve().parents[2] / "docs" / "notebooks"

NAMES = ("artists", "researchers")


def cells(name: str, kind: str) -> list[str]:
    """The sources of the cells of a notebook that are "code" or "markdown"."""
    notebook = json.loads((NOTEBOOKS / f"{name}.ipynb").read_text("utf-8"))
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == kind]


class Ran:
    """A notebook whose cells have been run one after the other.

    Attributes:
        names: what is defined in the end.
        shown: the HTML of what its cells show.
        figures: number of figures.
    """

    def __init__(self, name: str) -> None:
        self.names: dict[str, Any] = {"__name__": "__main__"}
        self.shown: list[str] = []
        for number, source in enumerate(cells(name, "code")):
            tree, where = ast.parse(source), f"{name}, cell {number}"
            last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
            exec(compile(tree, where, "exec"), self.names)
            if isinstance(last, ast.Expr):
                value = eval(compile(ast.Expression(last.value), where, "eval"), self.names)
                if hasattr(value, "_repr_html_"):
                    self.shown.append(value._repr_html_())
        self.figures = len(plt.get_fignums())
        plt.close("all")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variant: str) -> Iterator[Path]:
    """Where temporary files go; figures are drawn without a window, and the variant is what it was in the end."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    plt.switch_backend("agg")
    tnst_mi.activate("llvm_ad_rgb")
    yield tmp_path
    tnst_mi.activate(variant)


@pytest.mark.parametrize("name", NAMES)
def test_notebooks_are_kept_without_outputs(name: str) -> None:
    notebook = json.loads((NOTEBOOKS / f"{name}.ipynb").read_text("utf-8"))
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell for cell in code if cell["outputs"] or cell["execution_count"] is not None] == []
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    identities = [cell["id"] for cell in notebook["cells"]]
    assert len(set(identities)) == len(identities)


def test_there_are_no_others() -> None:
    assert sorted(file.stem for file in NOTEBOOKS.glob("*.ipynb")) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_links_lead_somewhere(name: str) -> None:
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", "\n".join(cells(name, "markdown")))
    assert len(links) >= 3
    assert [link for link in links if not (NOTEBOOKS / link).is_file()] == []


def test_the_notebook_for_artists(folder: Path) -> None:
    ran = Ran("artists")
    assert len(ran.shown) == 8
    for shown in ran.shown:
        ShownHtml(shown)
    frame, draft, final = ran.names["frame"], ran.names["spirals"], ran.names["final"]
    for result in (draft, ran.names["net"], final):
        (record,) = result.run["frames"]
        assert record["loss_after"] < record["loss_before"]
        assert abs(record["mass_after"] / record["mass_before"] - 1) < 0.01
    assert final.run["from"] is not None
    changes = [result.densities[0] - frame.density for result in (draft, final)]
    assert np.corrcoef(*(change.ravel() for change in changes))[0, 1] > 0.5
    assert (folder / final.out.relative_to(folder) / "density" / "frame_0061.npz").is_file()


def test_the_notebook_for_researchers(folder: Path) -> None:
    ran = Ran("researchers")
    names = ran.names
    assert names["within"] > 0.985 and abs(names["scores"].mean()) < 0.2
    assert 0.85 < names["scores"].std() < 1.15 and len(names["scores"]) > 300
    for measured, closed_form in names["ratios"].values():
        assert measured == pytest.approx(closed_form, rel=1e-5)
    assert len(names["deviations"]) == 4 and max(names["deviations"].values()) < 1e-3
    assert names["echoed"].loss_after < 1.2 * names["echoed"].loss_before < 0
    assert ran.figures == 3 and len(ran.shown) == 2

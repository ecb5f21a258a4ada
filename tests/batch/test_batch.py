"""`tnst-mi batch`: every recipe on every input, resumed, with a page that tells what became of each."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from command_line import Run, refused, run, smoke, tiny_weights
from hypothesis import given
from hypothesis import strategies as st

from tnst_mi.batch.jobs import DONE, FAILED, INTERRUPTED, WAITING, RunOutcome, jobs_of
from tnst_mi.batch.page import write_page
from tnst_mi.errors import InputError
from tnst_mi.optimisation.runner import SequenceOptimisation
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.difference import recipe_differences

__all__ = ["run", "smoke", "tiny_weights"]

KEYS = 'semantic = ["inception_3a/3x3:2"]\noctaves = 1\niterations = 2\nviews = 1\n'


@pytest.fixture
def recipes(tmp_path: Path, tiny_weights: Path) -> list[Path]:
    """Two that differ in γ."""
    files = [tmp_path / "thin one.toml", tmp_path / "thick.toml"]
    for file, gamma in zip(files, (0.1, 1.0), strict=True):
        file.write_text(f'{KEYS}gamma = {gamma}\nweights = "{tiny_weights}"\n', "utf-8")
    return files


class Links(HTMLParser):
    """What a page refers to."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.found: set[str] = set()
        self.feed(page.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found |= {unquote(value) for name, value in attrs if name in ("src", "href") and value}


def rows(out: Path) -> list[dict]:
    return json.loads((out / "batch.json").read_text("utf-8"))["runs"]


def test_all_runs_are_those_of_stylize_and_the_page_leads_to_them(
    run: Run, recipes: list[Path], smoke: Path, tmp_path: Path
) -> None:
    out, single = tmp_path / "out", smoke / "f_08.npz"
    ran = run("batch", *recipes, smoke, single, "--out", out)
    assert ran.code == 0, ran.errors
    found = rows(out)
    assert [(row["recipe"], row["input"], row["status"]) for row in found] == [
        (recipe, source, DONE) for source in ("smoke", "f_08") for recipe in ("thin_one", "thick")
    ]
    assert [row["frames"] for row in found] == [3, 3, 1, 1]
    links = Links(out / "index.html").found
    assert all((out / link).exists() for link in links) and len(links) == 4 * 3 + 2
    assert "batch: run 4 of 4, about" in "\n".join(ran.errors)

    alone = tmp_path / "alone"
    assert run("stylize", single, "--recipe", recipes[1], "--out", alone).code == 0
    one, other = (np.load(folder / "density" / "f_08.npz")["density"] for folder in (alone, out / "thick" / "f_08"))
    assert np.array_equal(one, other)
    row, record = found[3], json.loads((alone / "run.json").read_text("utf-8"))["frames"][0]
    assert (row["loss_before"], row["loss_after"]) == (record["loss_before"], record["loss_after"])
    assert row["mass_change"] == pytest.approx(record["mass_after"] / record["mass_before"] - 1)


def test_what_is_done_stays_and_what_was_interrupted_goes_on(
    run: Run, recipes: list[Path], smoke: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, begun = tmp_path / "out", []
    optimise = SequenceOptimisation.run

    def counted(self: SequenceOptimisation, *arguments: object) -> object:
        begun.append(self)
        if len(begun) == 2:
            raise KeyboardInterrupt
        return optimise(self, *arguments)

    monkeypatch.setattr(SequenceOptimisation, "run", counted)
    ran = run("batch", *recipes, smoke / "f_08.npz", smoke / "f_09.npz", "--out", out)
    assert ran.code == 3
    assert rows(out)[0]["status"] == DONE and rows(out)[3]["status"] == WAITING
    written = (out / "thin_one" / "f_08" / "density" / "f_08.npz").stat().st_mtime_ns
    ran = run("batch", *recipes, smoke / "f_08.npz", smoke / "f_09.npz", "--out", out)
    assert ran.code == 0, ran.errors
    assert [row["status"] for row in rows(out)] == [DONE] * 4 and len(begun) == 2 + 3
    assert (out / "thin_one" / "f_08" / "density" / "f_08.npz").stat().st_mtime_ns == written
    assert run("batch", *recipes, smoke / "f_08.npz", "--out", out, "--overwrite").code == 0
    assert len(begun) == 2 + 3 + 2


def test_a_run_that_cannot_be_done_is_told_and_the_others_go_on(
    run: Run, recipes: list[Path], smoke: Path, tmp_path: Path
) -> None:
    out, damaged = tmp_path / "out", tmp_path / "damaged.npz"
    damaged.write_bytes((smoke / "f_08.npz").read_bytes()[:-40])
    ran = run("batch", *recipes, damaged, smoke / "f_09.npz", "--out", out)
    assert ran.code == 1
    assert [row["status"] for row in rows(out)] == [FAILED, FAILED, DONE, DONE]
    assert "damaged.npz" in rows(out)[0]["error"] and "\n" not in rows(out)[0]["error"]
    assert "2 of 4 runs could not be done: thin_one on damaged, thick on damaged" in ran.errors[-1]
    assert (out / "index.html").read_text("utf-8").count('class="failed"') == 2
    # The same command tries again.
    damaged.write_bytes((smoke / "f_08.npz").read_bytes())
    assert run("batch", *recipes, damaged, smoke / "f_09.npz", "--out", out).code == 0


def test_flags_count_for_all_recipes(run: Run, recipes: list[Path], smoke: Path, tmp_path: Path) -> None:
    assert run("batch", *recipes, smoke / "f_08.npz", "--iterations", 1, "--out", tmp_path / "out").code == 0
    for name in ("thin_one", "thick"):
        assert Recipe.from_toml(tmp_path / "out" / name / "f_08" / "recipe.toml").iterations == 1


def test_mistakes_are_answered_before_anything_is_written(
    run: Run, recipes: list[Path], smoke: Path, tmp_path: Path
) -> None:
    out, single = tmp_path / "out", smoke / "f_08.npz"
    refused(
        run, tmp_path, ["batch", single, "--out", out], "batch: expected recipes .* and inputs, one or more of each"
    )
    refused(run, tmp_path, ["batch", *recipes, "--out", out], "batch: expected recipes")
    refused(run, tmp_path, ["batch", *recipes, single, smoke / "no.npz", "--out", out], "no.npz: no such file")
    refused(run, tmp_path, ["batch", tmp_path / "no.toml", single, "--out", out], "no.toml: no such file")
    refused(
        run, tmp_path, ["batch", *recipes, single, "--out", smoke], "it holds no batch; give an empty or new folder"
    )
    other = tmp_path / "other"
    other.mkdir()
    (other / "f_08.npz").write_bytes(single.read_bytes())
    message = "would share the folder thin_one/f_08; rename one, or give each once"
    refused(run, tmp_path, ["batch", *recipes, single, other / "f_08.npz", "--out", out], message)
    refused(run, tmp_path, ["batch", recipes[0], recipes[0].parent / "x" / ".." / recipes[0].name, single], "--out")


@given(st.text(st.characters(codec="utf-8", exclude_characters="/\0"), min_size=1, max_size=12))
def test_folders_of_runs_stay_in_that_of_the_batch(name: str) -> None:
    out = Path("/somewhere/out")
    try:
        jobs = jobs_of({Path(f"{name}.toml"): Recipe()}, [Path(f"in/{name}")], out)
    except (InputError, ValueError):
        return
    for job in jobs:
        assert job.out.resolve().is_relative_to(out) and len(job.out.relative_to(out).parts) == 2


def test_text_of_files_and_errors_is_no_markup(tmp_path: Path) -> None:
    recipe = Recipe(tag=("<b>",))
    jobs = jobs_of({Path("a.toml"): recipe, Path("b.toml"): Recipe(tag=("c",))}, [Path("<i>.npz")], tmp_path)
    write_page(tmp_path / "index.html", jobs, [RunOutcome(FAILED, "no <script>"), RunOutcome(INTERRUPTED)])
    page = (tmp_path / "index.html").read_text("utf-8")
    assert not re.search("<b>|<i>|<script>", page)
    assert "no &lt;script&gt;" in page and "[&#x27;&lt;b&gt;&#x27;]" in page


def test_differences_of_recipes() -> None:
    recipes = Recipe(gamma=0.1, window=3), Recipe(gamma={1: 0.1, 2: 1.0}, window=3), Recipe(window=3)
    assert recipe_differences(*recipes) == {"gamma": (0.1, {"1": 0.1, "2": 1.0}, 0.1)}

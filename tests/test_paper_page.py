"""docs/paper.md is true: what its table names exists, and everything in the paper is in it."""

from __future__ import annotations

import ast
import re
import tomllib
from itertools import pairwise
from pathlib import Path

import pytest

from tnst_mi.recipe.presets import PRESETS
from tnst_mi.recipe.recipe import KINDS

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs" / "paper.md").read_text("utf-8")

#: The rows of the first table: cells by column.
HEAD, _, *ROWS = [
    [cell.strip() for cell in line.split("|")[1:-1]]
    for line in TEXT.partition("## The table")[2].partition("\n## ")[0].splitlines()
    if line.startswith("|")
]


def in_code(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def names_of(path: Path) -> set[str]:
    """The functions and classes of a file, methods apart."""
    tree = ast.parse(path.read_text("utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}


def test_every_row_has_all_columns_and_a_verdict() -> None:
    assert len(HEAD) == 5
    for row in ROWS:
        assert len(row) == 5, row
        assert row[2] in ("same", "differs"), row
        assert row[3] or row[2] == "same", f"{row[0]}: does not say why"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0][:40])
def test_files_and_functions_exist(row: list[str]) -> None:
    """The second column holds files, each followed by names of functions or classes in it."""
    found = in_code(row[1])
    assert found and "/" in found[0] and "/" not in found[-1], row[1]
    file = found[0]
    for before, name in pairwise(found):
        if "/" in name:
            assert "/" not in before, f"{before}: no function of it is named"
            file = name
        else:
            assert name in names_of(ROOT / file), f"{file} has no {name}"
    assert re.sub(r"`[^`]+`|[, ]", "", row[1]) == "", "nothing but files and names"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0][:40])
def test_keys_and_their_values_are_those_of_recipes(row: list[str]) -> None:
    assert re.sub(r"`[^`]+`|[, ]", "", row[4]) == "", "nothing but keys"
    for code in in_code(row[4]):
        key, _, value = code.partition(" = ")
        assert key in KINDS
        if value:
            assert KINDS[key].check(tomllib.loads(code)[key]) == PRESETS["paper"][key]


def test_the_preset_s_keys_are_all_in_the_table_with_their_values() -> None:
    told = {code.partition(" = ")[0] for row in ROWS for code in in_code(row[4]) if " = " in code}
    assert told == set(PRESETS["paper"])


def test_the_whole_paper_is_in_the_table() -> None:
    first = "\n".join(row[0] for row in ROWS)
    assert {int(number) for number in re.findall(r"\bEq\. (\d+)", first)} == set(range(1, 12))
    for part in ("Algorithm 1", "Symbols of Table 1", "Table 2: Semantic", "Table 2: Style", "Table 2: Volcano"):
        assert part in first
    assert "Table 2: Sato" in first


def test_every_figure_of_the_paper_is_in_the_table() -> None:
    """By its module; what is not of the paper are our formulas beside its own."""
    source = (ROOT / "scripts" / "figures" / "__init__.py").read_text("utf-8")
    modules = ast.literal_eval(re.search(r"MODULES = (\{.*?\})", source, re.DOTALL)[1])
    told = {Path(code).stem for row in ROWS for code in in_code(row[1]) if code.startswith("scripts/figures/")}
    assert told == set(modules.values()) - {"paper_formulas", "transport", "motif_size", "recipe_keys", "final_look"}
    assert "images/figures/preset.png" in TEXT


def test_numbers_of_table_2_are_those_of_the_recipes() -> None:
    import tnst_mi

    for name in ("semantic", "style", "volcano", "sato"):
        recipe = tnst_mi.Recipe.from_toml(ROOT / "scenes" / "paper" / f"{name}.toml")
        (row,) = [row for row in ROWS if row[0].lower().startswith(f"table 2: {name}")]
        assert f"η {recipe.eta:g}, γ {recipe.gamma:g}, {recipe.octaves} scales" in row[0]
        assert f"scenes/paper/{name}.toml" in row[3]

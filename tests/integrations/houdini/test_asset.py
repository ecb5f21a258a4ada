"""The Houdini asset: its files are what the recipe's documentation makes of them, and every key has its parameter."""

from __future__ import annotations

import re
from typing import Any

import build_houdini_asset
import pytest
from houdini_asset.controls import label_of, parms_of
from houdini_asset.files import DEFINITION
from houdini_asset.interface import DECIDED
from tnst_mi_houdini import values

from tnst_mi.recipe.parameters import parameters

FOLDER = build_houdini_asset.ASSET / DEFINITION


def parm_blocks(script: str) -> dict[str, str]:
    """The text of each parameter, by its name; of a list, that of its parts is in it."""
    blocks = re.findall(r"(?:parm|multiparm) \{\s+name +\"([^\"]+)\"(.*?)\n\s*\}\n", script, re.DOTALL)
    assert len(blocks) == len(dict(blocks)), "two parameters have one name"
    return dict(blocks)


@pytest.fixture(scope="module")
def script() -> str:
    return (FOLDER / "DialogScript").read_text(encoding="utf-8")


def of(key: str) -> dict[str, Any]:
    return next(about for about in parameters() if about["key"] == key)


def test_the_committed_files_are_what_is_generated(capsys: pytest.CaptureFixture[str]) -> None:
    """If this fails, run python scripts/build_houdini_asset.py."""
    assert build_houdini_asset.main(["--check"]) == 0, capsys.readouterr().out


def test_every_section_is_listed_and_there() -> None:
    """As in expanded assets that are published: index, list, the empty mark, and a folder for the definition."""
    asset = build_houdini_asset.ASSET
    assert DEFINITION == "tnst__mi_8_8Sop_1stylize_8_81.0"
    for folder in (asset, FOLDER):
        lines = (folder / "Sections.list").read_text(encoding="utf-8").splitlines()
        assert lines[0] == '""'
        listed = {line.split("\t")[0] for line in lines[1:]}
        assert listed == {path.name for path in folder.iterdir()} - {"Sections.list"}
    assert (asset / "houdini.hdalibrary").read_bytes() == b""
    assert "Python:       true\n" in (asset / "INDEX__SECTION").read_text(encoding="utf-8")
    for name in ("PythonCook", "PythonModule", "OnDeleted"):
        compile((FOLDER / name).read_text(encoding="utf-8"), name, "exec")


def test_every_key_has_its_parameter_with_its_help(script: str) -> None:
    blocks = parm_blocks(script)
    for about in parameters():
        assert (about["key"] in blocks) == (about["key"] not in DECIDED)
        if about["key"] not in DECIDED:
            assert about["help"].replace("\\", "\\\\").replace('"', '\\"') in script
    # Braces and quotes are in pairs, or Houdini reads none of it.
    outside = re.sub(r'"(?:[^"\\]|\\.)*"', "", script)
    assert outside.count("{") == outside.count("}") and '"' not in outside


def test_labels_are_words() -> None:
    for about in parameters():
        label = label_of(about["key"])
        assert "_" not in label and len(label) > 2 and label[0].isupper(), label


def test_numbers_have_their_ranges_defaults_and_words(script: str) -> None:
    blocks = parm_blocks(script)
    assert 'default { "1" }' in blocks["strength"] and "range   { 0! 1! }" in blocks["strength"]
    assert 'default { "-10" "10" }' in blocks["azimuth"] and "range   { -360! 360! }" in blocks["azimuth"]
    assert 'default { "0.002" }' in blocks["eta"] and "range   { 0! 0.02 }" in blocks["eta"]
    # A word in place of the number, and numbers that are not set, are a menu beside it.
    assert '"auto" "auto"' in blocks["gamma_choice"] and 'default { "number" }' in blocks["gamma_choice"]
    assert 'default { "medium" }' in blocks["look_choice"] and '"thick" "thick"' in blocks["look_choice"]
    assert 'default { "unset" }' in blocks["fps_choice"] and 'default { "24" }' in blocks["fps"]
    assert 'hidewhen "{ gamma_choice != number }"' in blocks["gamma"]
    assert "eta_choice" not in blocks


def test_choices_are_menus_and_pictures_files(script: str) -> None:
    blocks = parm_blocks(script)
    assert all(f'"{choice}"' in blocks["style_loss"] for choice in of("style_loss")["choices"])
    assert 'default { "unset" }' in blocks["preset"] and '"paper"' in blocks["preset"]
    assert "type    file" in blocks["style"] and '"flames" "flames"' in blocks["style"]
    assert '"flower" "flower"' in blocks["tag"] and "type    file" in blocks["camera"]


def test_a_help_of_a_key_changes_the_files() -> None:
    """What is generated follows the documentation: bounds, help and choices are read from nowhere else."""
    (parm,) = parms_of({**of("strength"), "help": 'Say "no".', "high": 2.0}, {})
    assert r'help    "Say \"no\"."' in parm and "{ 0! 2! }" in parm


def test_the_table_has_the_same_keys() -> None:
    assert [about["key"] for about in values.keys()] == [
        about["key"] for about in parameters() if about["key"] not in DECIDED
    ]

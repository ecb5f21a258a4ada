"""Names of views become names of files: those that cannot are refused before anything is written."""

from __future__ import annotations

import json
import reprlib

import pytest

from tnst_mi.cli import main

BAD = ["../../outside", "a/b", "a\\b", "a\0b", "new\nline", ".", "..", "", "x" * 300, "sides", "SIDES"]


@pytest.mark.parametrize("name", BAD)
def test_a_name_that_no_file_can_have_is_refused(views, tmp_path, name, capsys):
    cameras = tmp_path / "cameras.toml"
    cameras.write_text(views.read_text().replace("[views.held_out_00]", f"[views.{json.dumps(name)}]"))
    assert main(["reconstruct", str(cameras), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert f"{cameras}: view {reprlib.repr(name)}: its name " in told and "rename it" in told and told.count("\n") == 1
    assert list(tmp_path.iterdir()) == [cameras]


def test_names_that_differ_in_capitals_are_refused(views, tmp_path, capsys):
    cameras = tmp_path / "cameras.toml"
    cameras.write_text(views.read_text().replace("[views.held_out_00]", "[views.View_01]"))
    assert main(["reconstruct", str(cameras), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert f"{cameras}: views 'view_01' and 'View_01': differ in capitals alone" in told and told.count("\n") == 1

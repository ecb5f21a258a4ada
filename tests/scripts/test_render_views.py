"""scripts/render_views.py: what it refuses, and what it writes over."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import render_views


def test_mistakes_are_told_in_one_line(tmp_path, monkeypatch, capsys):
    np.save(tmp_path / "smoke.npy", np.ones((4, 4, 4), np.float32))

    def run(*arguments: str | Path) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["render_views.py", *map(str, arguments)])
        code = render_views.main()
        return code, capsys.readouterr().err

    out, few = tmp_path / "views", ("--views", "1", "--held-out", "0", "--size", "4")
    for flags, told in (
        (("--noise", "loud"), "--noise loud: expected"),
        (("--frames", "x:2"), "--frames x:2"),
        (("--frames", "7:8"), "frames = '7:8'"),
    ):
        code, error = run(tmp_path / "smoke.npy", "--out", out, *few, *flags)
        assert code == 2 and told in error and error.count("\n") == 1 and not out.exists()
    assert run(tmp_path / "nowhere.npz", "--out", out)[0] == 2
    assert run(tmp_path / "smoke.npy", "--out", out, *few) == (0, "")
    written = (out / "view_00.exr").read_bytes()
    code, error = run(tmp_path / "smoke.npy", "--out", out, *few, "--gamma", "1")
    assert code == 2 and "is not empty" in error and (out / "view_00.exr").read_bytes() == written
    assert run(tmp_path / "smoke.npy", "--out", out, *few, "--gamma", "1", "--overwrite") == (0, "")
    assert (out / "view_00.exr").read_bytes() != written


def test_help_names_the_defaults(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["render_views.py", "--help"])
    with pytest.raises(SystemExit):
        render_views.main()
    told = " ".join(capsys.readouterr().out.split())
    assert "None" not in told and told.count("(default: ") == 10

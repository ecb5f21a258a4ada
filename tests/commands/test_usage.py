"""Wrong usage: the message names the mistake, and what was meant."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from command_line import Run, refused, run, smoke

__all__ = ["run", "smoke"]


@pytest.mark.parametrize(
    "line",
    [
        "stylize smoke --out b --style nett",
        "stylize smoke --out b --tag x --iterations 3.5",
        "stylize smoke --out b --tag x --window 4",
        "stylize smoke --out b --tag x --frames 40:50",
        "stylize smoke --out b --tag x --transport flow --steps 2",
        "stylize smoke --out b",
        "stylize smoke --out b --recipe bad.toml",
        "stylize smoke --out full --tag x",
        "stylize nowhere --out b --tag x",
        "demo --out full",
        "render smoke --out full",
        "render smoke --out b --frames 40:50",
        "compare smoke --out full",
        "convert smoke full",
        "info smoke --frames 40:50",
    ],
)
def test_mistakes_in_flags_are_found_before_anything_large_is_imported(line: str, smoke: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("eta")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes").touch()
    program = (
        "import sys; from tnst_mi.cli import main; code = main(sys.argv[1:]); import mitsuba; "
        "sys.exit(f'{code} {mitsuba.variant()} ' + ', '.join({'torch', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *line.split()], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.stderr.splitlines()[-1] == "2 None "


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("styliz a --out b", "no command 'styliz'; did you mean stylize?"),
        (
            "frobnicate",
            "expected one of demo, stylize, train, batch, reconstruct, render, show, diff, compare, convert, atlas, "
            "studio, info, weights, doctor",
        ),
        ("stylize", "Missing from tnst-mi stylize: --out FOLDER"),
        ("stylize a", "Missing from tnst-mi stylize: --out FOLDER"),
        ("stylize a --out", "Missing value for argument .*--out"),
        ("stylize a --out b --lamm 1", "unexpected '--lamm'; did you mean --lam?"),
        ("stylize a --out b --lamm=1", "unexpected '--lamm'; did you mean --lam?"),
        ("stylize a --out b c", "unexpected 'c'"),
        ("stylize --out b --tag x", "stylize: expected INPUT: a density file, a folder of numbered ones, or a pattern"),
        ("stylize --out b --resume", "b: no run to resume there; leave out --resume to begin one"),
        ("info", "expected one or more files"),
        ("render a --out b --views 1,2,3", "--views 1,2,3: expected AZIMUTH,ELEVATION"),
        ("render a --out b --views nan,0", "--views nan,0: expected"),
        ("render a --out b --gamma 0", "--gamma 0: expected a number above 0"),
        ("stylize a --out b --gamma x", "--gamma x: expected a number above 0"),
        ("stylize a --out b --azimuth 10,-10", "--azimuth 10,-10: expected two numbers LOW,HIGH, in this order, from"),
        ("stylize a --out b --azimuth -10", "--azimuth -10: expected two numbers"),
        ("stylize a --out b --quadrature Paper", "--quadrature Paper: expected paper, exact"),
        ("stylize a --out b --steps 0", "--steps 0: expected an integer"),
        ("stylize a --out b --semantic conv2", "--semantic conv2: expected a list of layers"),
        ("stylize a --out b --style nowhere.png", "--style: style = 'nowhere.png': no such picture"),
        ("stylize a --out b", "nothing to stylize towards"),
        ("stylize a --out b --tag x --light lamp.xml", "--light: light = 'lamp.xml': no such file, nor one of"),
        ("stylize a --out b --tag x --resume --overwrite", "expected only one of them"),
        ("stylize nowhere.npz --out b --tag x", "nowhere.npz: no such file"),
        ("stylize nowhere --out b --tag x", "nowhere: no such file or folder"),
        ("stylize nowhere.vdb --out b --tag x", "nowhere.vdb: no such file or folder"),
        ("info nowhere.npz", "nowhere.npz: no such file"),
        ("render nowhere.npz --out b", "nowhere.npz: no such file"),
    ],
)
def test_wrong_usage(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, message: str) -> None:
    monkeypatch.chdir(tmp_path)
    refused(run, tmp_path, line.split(), message)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("stylize a --out b --angle 10", "unexpected '--angle'; did you mean --azimuth?"),
        ("stylize a --out b --intensity=2", "unexpected '--intensity'; did you mean --strength?"),
        ("stylize a --out b --learning-rate 2", "did you mean --eta?"),
        ("stylize a --out b --style-image x.png", "did you mean --style?"),
        ("stylize a --out b --device cuda", "did you mean --variant?"),
        (
            "stylize a --out b --preview",
            "unexpected '--preview'; a single octave gives a quick preview .*--octaves 1",
        ),
        ("stylize a --out b --output c", "did you mean --out?"),
        ("convert a b --time-step 2", "unexpected '--time-step'; did you mean --dt?"),
        ("convert a b --camera 2", "unexpected '--camera'; tnst-mi convert --help lists what is known"),
        # A guess that is unlike is worse than none, and one that the command refuses too.
        ("info a --bogus", "unexpected '--bogus'; tnst-mi info --help lists what is known"),
        ("stylize a --files x --out b", "unexpected '--files'; INPUT is given without a flag"),
        ("stylize --input a --out b", "unexpected '--input'; INPUT is given without a flag"),
        ("convert --input=a b", "unexpected '--input'; INPUT is given without a flag"),
        ("convert a --out b", "unexpected '--out'; OUTPUT is given without a flag"),
        ("info --files a", "unexpected '--files'; FILE… is given without a flag"),
        ("info a --frame 9:12", "unexpected '--frame'; did you mean --frames?"),
        ("stylize a -o b", "unexpected '-o'; did you mean --out?"),
        # Choices are listed alike, with the likeliest; other words for a range and a table are seen through.
        ("render a --out b --look thcik", "--look thcik: expected thin, medium or thick; did you mean thick?"),
        ("render a --out b --integrator volpth", "--integrator volpth: expected .* or volpath; did you mean volpath?"),
        ("convert a b --format vbd", "--format vbd: expected npz, vol, uni or vdb; did you mean vdb?"),
        ("render a --out b --spp x --look thin", "--spp x: expected an integer from 1 to 1000000$"),
        ("render a --out b --turntable 1.5", "--turntable 1.5: expected an integer from 1 to 100000$"),
        ("info a --frames 1-2", '--frames 1-2: expected a range of frame numbers, such as "70:89"; write 1:2$'),
        ("stylize a --out b --tag x --frames -3..-1", "; write -3:-1$"),
        ("compare a --out b --frames 1,2", "; write 1:2$"),
        ("info a --crop maybe", r"--crop maybe: expected on or off \(true or false in a recipe\)$"),
        (
            "stylize a --out b --tag x --gamma 0=0.1,3=1.0",
            "--gamma 0=0.1,3=1.0: .*; keyframes are written in braces: '{0=0.1,3=1.0}'$",
        ),
        ("stylize a --out b --tag x --gamma 0:0.1", "keyframes are written in braces: '{0:0.1}'$"),
        ("render a --out b --gamma {0:0.1,3:1}", "--gamma {0:0.1,3:1}: render takes one value, keyframes are of styl"),
        ("stylize a --out b --tag x --eta {0:1", "--eta {0:1: expected a value for each frame, such as '{49: 0.1, 72"),
        ("stylize a --out b --tag x --octaves {0:1}", "--octaves: octaves = .*: cannot be keyframed"),
        ("stylize a --out b --tag x --eta {0:-1}", "--eta: frame 0: eta = -1: expected a number above 0"),
    ],
)
def test_what_was_meant(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, message: str) -> None:
    monkeypatch.chdir(tmp_path)
    refused(run, tmp_path, line.split(), message)


def test_a_pattern_without_quotes(run: Run, smoke: Path, tmp_path: Path) -> None:
    files = [smoke / f"f_0{number}.npz" for number in (7, 8, 9)]
    refused(run, tmp_path, ["stylize", *files, "--out", tmp_path / "out"], "as a pattern in quotes, such as 'smoke_")

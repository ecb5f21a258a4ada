"""Recipe files as editors write them: read, or refused in one line with the remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from tnst_mi.errors import InputError
from tnst_mi.recipe.paths import STYLES
from tnst_mi.recipe.recipe import Recipe

TEXT = 'style = ["spirals"]\noctaves = 1\n# Größe\n'


@pytest.mark.parametrize(
    "data", [TEXT.encode("utf-8-sig"), TEXT.replace("\n", "\r\n").encode("utf-8"), TEXT.encode("utf-8")]
)
def test_files_that_are_read(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "r.toml").write_bytes(data)
    assert Recipe.from_toml(tmp_path / "r.toml").octaves == 1


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (TEXT.encode("utf-16"), "UTF-16 text or no text, expected UTF-8; save it as UTF-8"),
        (TEXT.encode("utf-16-le"), "UTF-16 text or no text"),
        (TEXT.encode("utf-16-be"), "UTF-16 text or no text"),
        (TEXT.encode("cp1252"), "byte 0xf6 in line 3 is not UTF-8, perhaps Windows-1252; save the file as UTF-8"),
        ("style = [„spirals“]".encode(), 'not valid TOML .*; use straight quotes: "'),
        ("quadrature = ‘exact’".encode(), "use straight quotes"),
        (rb'style = ["C:\Users\me\fire.png"]', r"; write paths in single quotes, 'C:\\smoke\\fire.png', or with /"),
        (rb'style = ["C:\temp\fire.png"]', r"has the control character '\\t' in it, .* in single quotes"),
        (b"octaves: 1", "write key = value, not key: value"),
        (b"eta = 1\neta = 2", "a key may be there once"),
        (b"gamma = 0,1", "write decimals with a point"),
        (b"[stylize]\noctaves = 1", "unknown key 'stylize'; a recipe has no sections: write its keys without"),
        (b"octave = 1", "unknown key 'octave'; did you mean 'octaves'"),
        (b"intensity = 1", "unknown key 'intensity'; did you mean 'strength'"),
        (b"preview = true", "unknown key 'preview'; a single octave gives a quick preview"),
        (b"zzz = 1", "unknown key 'zzz'; tnst-mi stylize --help lists the keys"),
        (b'weights = "a\\u0001b"', "has the control character"),
    ],
)
def test_files_that_are_not(tmp_path: Path, data: bytes, message: str) -> None:
    (tmp_path / "r.toml").write_bytes(data)
    with pytest.raises(InputError, match=message) as error:
        Recipe.from_toml(tmp_path / "r.toml")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) - len(str(tmp_path)) < 300


def test_yaml_is_named(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text("style: [spirals]\noctaves: 1\n")
    with pytest.raises(InputError, match=r"it is named as YAML: write key = value in a .toml file"):
        Recipe.from_toml(tmp_path / "r.yaml")


def test_homes_and_backslashes_in_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "styles").mkdir()
    picture = tmp_path / "styles" / "net.png"
    picture.write_bytes((STYLES / "net.png").read_bytes())
    for text in ("~/styles/net.png", "styles\\net.png", ".\\styles\\net.png"):
        (tmp_path / "r.toml").write_text(f"style = ['{text}']")
        assert Recipe.from_toml(tmp_path / "r.toml").style == (str(picture),)
    (tmp_path / "r.toml").write_text("weights = '~/styles'")
    assert Recipe.from_toml("~/r.toml").weights == str(picture.parent)
    (tmp_path / "r.toml").write_text("weights = '~nobody-of-that-name/styles'")
    assert Recipe.from_toml("~/r.toml").weights == "~nobody-of-that-name/styles"


def test_a_path_that_no_recipe_can_hold(tmp_path: Path) -> None:
    picture = tmp_path / "n\udcfft.png"
    picture.write_bytes((STYLES / "net.png").read_bytes())
    with pytest.raises(InputError, match="the path is not UTF-8, as a recipe file has to be; rename the file"):
        Recipe.from_dict({"style": [str(picture)]})


@pytest.mark.parametrize("frames", ["7", "-3:-2", "1.5", "1.0:2.5", "-2:2"])
def test_frames(frames: str) -> None:
    first, last = Recipe(frames=frames).frame_range or (None, None)
    ends = (frames.split(":") * 2)[:2] if ":" not in frames else frames.split(":")
    assert (first, last) == (float(ends[0]), float(ends[1]))
    assert isinstance(first, float) == isinstance(last, float) == ("." in frames)
    assert Recipe(gamma={-3: 0.1, 1: 0.5}).at(-1).gamma == pytest.approx(0.3)
    assert Recipe(gamma={1: 0.1, 2: 0.2}).at(1.5).gamma == pytest.approx(0.15)

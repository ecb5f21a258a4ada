"""Keys and values of recipes are only as deep as they need to be, since Python's parser takes very long for others."""

from __future__ import annotations

import time
import tomllib
from pathlib import Path

import pytest

from tnst_mi.errors import InputError
from tnst_mi.io.bounded_toml import toml_values
from tnst_mi.recipe.flag_values import value_of_flag
from tnst_mi.recipe.recipe import Recipe

DEEP = ".".join(["a"] * 20_000)


@pytest.mark.parametrize(
    "text",
    [
        f"{DEEP} = 1",
        f"[{DEEP}]",
        f"[[ {DEEP.replace('.', ' . ')} ]]",
        f"gamma = {{{DEEP} = 1}}",
        '"a".' * 5000 + "a = 1",
        "'a\"'\t.\t" * 5000 + "a = 1",
        'x = """"""\n' + '"#".' * 5000 + "a = 1",
        'x = ["""a""""", {' + DEEP + ' = "b"}]',
        "x = ['''a''''', {" + DEEP + " = 'b'}]",
        'x = "\\\\" # "\n' + DEEP + " = 1",
        'x = """\\"""" # """\n' + DEEP + ' = """1"""',
    ],
)
def test_deep_keys_are_refused_at_once(tmp_path: Path, text: str) -> None:
    (tmp_path / "r.toml").write_text(text)
    began = time.process_time()
    with pytest.raises(InputError, match=r"r.toml: a key of more than 4 parts; write keys such as eta, or gamma\.49 "):
        Recipe.from_toml(tmp_path / "r.toml")
    assert time.process_time() - began < 0.5


@pytest.mark.parametrize("text", ["[" * 9, "style = " + "[" * 100_000, "x = " + "{a = " * 9, "x = [" + "[{a = [" * 3])
def test_deep_values_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "r.toml").write_text(text)
    with pytest.raises(InputError, match=r"r.toml: more than 8 brackets inside of one another; write lists"):
        Recipe.from_toml(tmp_path / "r.toml")


def test_deep_flags_are_refused_at_once() -> None:
    began = time.process_time()
    with pytest.raises(InputError, match=r"^--gamma .*expected a value for each frame"):
        value_of_flag("gamma", f"{{{DEEP} = 1}}")
    assert time.process_time() - began < 0.5


@pytest.mark.parametrize(
    "text",
    [
        "a.b.c.d = 1\n[x.y.z.w]\na.b.c.d = 2",
        f'x = "{DEEP}" # {DEEP} {"[" * 20}',
        f'x = \'\'\'\n{DEEP}\n"""{"[" * 20}\'\'\'\ny = """\n{DEEP}\\""" \'\'\' {"{" * 20}"""""',
        f'x = \'{DEEP}\\\'\ny = "\\"{DEEP}"',
        "x = [1.5, 2.5, 3.5, 4.5, 5.5, 1979-05-27T07:32:00.5]\n'a.b.c'.\"d.e.f\" = [[[[[[[[1]]]]]]]]",
        "\n".join(f"gamma.{number} = [[1], [2.5]]" for number in range(20)),
    ],
)
def test_others_are_read_as_they_are(text: str) -> None:
    assert toml_values(text) == tomllib.loads(text)

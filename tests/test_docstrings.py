"""The examples in the docstrings of the public names run, and every public name has one."""

from __future__ import annotations

import doctest

import pytest

import tnst_mi

WITHOUT = {"Result", "activate", "InputError"}
"""Public names without an example of their own: what others' examples give, or what needs none."""

NAMES = sorted(set(tnst_mi.__all__) - WITHOUT)


def examples(name: str) -> list[doctest.DocTest]:
    """The docstrings of a public function, or of a class and its methods, that have examples."""
    found = doctest.DocTestFinder(exclude_empty=True).find(getattr(tnst_mi, name), name, module=False, globs={})
    return [test for test in found if test.examples]


def test_the_names_without_an_example_are_public() -> None:
    assert WITHOUT <= set(tnst_mi.__all__)


@pytest.mark.parametrize("name", NAMES)
def test_the_example_of_a_public_name_runs(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    tests = examples(name)
    assert tests, f"tnst_mi.{name} has no example in its docstring"
    for test in tests:
        failed = doctest.DocTestRunner(verbose=False).run(test).failed
        assert failed == 0, capsys.readouterr().out

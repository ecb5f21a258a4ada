"""Which digits in the names of files are frame numbers."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tnst_mi.io.files.frame_numbers import missing, numbered, pattern_of, step_of


def numbers(*names: str) -> list[int | float | None]:
    return [found.number for found in numbered(names)]


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        # Anywhere in the name, padded or not.
        (["smoke_0009", "smoke_0010"], [9, 10]),
        (["smoke9", "smoke10"], [9, 10]),
        (["0009_smoke_res64", "0010_smoke_res64"], [9, 10]),
        (["f7.hires", "f8.hires"], [7, 8]),
        (["sim2_0001_128", "sim2_0002_128"], [1, 2]),
        (["2024-05-01_smoke_0031", "2024-05-01_smoke_0032"], [31, 32]),
        # A single name: the last digits.
        (["sim2_0031"], [31]),
        (["smoke"], [None]),
        # A version is no frame.
        (["smoke_v003.1001", "smoke_v003.1002"], [1001, 1002]),
        (["smoke.1001.v3", "smoke.1002.v3"], [1001, 1002]),
        (["smoke.1001_v4"], [1001]),
        (["smoke_v003"], [None]),
        (["v001", "v002"], [1, 2]),
        # Signs after a separator, or at the start.
        (["smoke.-003", "smoke.-002", "smoke.-001"], [-3, -2, -1]),
        (["smoke_-1", "smoke_0", "smoke_1"], [-1, 0, 1]),
        (["-2", "-1", "0"], [-2, -1, 0]),
        # A - after a word is a minus if others of the name have none.
        (["smoke-003", "smoke-002"], [3, 2]),
        (["smoke-001", "smoke0000", "smoke0001"], [-1, 0, 1]),
        (["a_1-0001", "a_1-0002"], [1, 2]),
        # Sub-frames.
        (["smoke.0001", "smoke.0001.50", "smoke.0002"], [1, 1.5, 2]),
        (["smoke.0001.25", "smoke.0002.25"], [1.25, 2.25]),
        (["smoke.0001.50", "smoke.0002.00"], [1.5, 2]),
        (["smoke.0001.50"], [1.5]),
        (["smoke.1", "smoke.1.5"], [1, 1.5]),
        (["smoke.-1.5", "smoke.-1", "smoke.0"], [-1.5, -1, 0]),
        # Of one frame alone, or of unpadded ones: they count evenly as fractions.
        (["s.0001.25", "s.0001.50", "s.0001.75"], [1.25, 1.5, 1.75]),
        (["s.1.25", "s.1.5", "s.1.75"], [1.25, 1.5, 1.75]),
        (["s.1.25", "s.1.75", "s.2.25", "s.2.75"], [1.25, 1.75, 2.25, 2.75]),
        (["s_0001.5", "s_0002.5", "s_0003.5"], [1.5, 2.5, 3.5]),
        (["a1.0001.25", "a1.0001.75", "a2.0001.25", "a2.0001.75"], [1.25, 1.75, 1.25, 1.75]),
        (["s.0001.333", "s.0001.667"], [1.333, 1.667]),
        (["s.0001.1", "s.0001.2", "s.0001.3"], [1.1, 1.2, 1.3]),
        # Takes, years, resolutions and versions before the number, or behind it.
        (["take.1.0001", "take.1.0002"], [1, 2]),
        (["take.1.0025", "take.1.0050", "take.1.0075"], [25, 50, 75]),
        (["take.1.1", "take.1.2", "take.1.3"], [1, 2, 3]),
        (["take.2.0", "take.2.5", "take.2.10"], [0, 5, 10]),
        (["take.1.1", "take.1.2", "take.2.1", "take.2.2"], [1, 2, 1, 2]),
        (["smoke_2024.0001", "smoke_2024.0002"], [1, 2]),
        (["smoke.2024.001", "smoke.2024.002"], [1, 2]),
        (["0001.256", "0002.256"], [1, 2]),
        # No sub-frames: too many digits, nothing that varies before them, a version.
        (["smoke.3.0001", "smoke.3.0002"], [1, 2]),
        (["smoke.1920.01", "smoke.1920.02"], [1, 2]),
        (["smoke.v003.1001", "smoke.v003"], [1001, None]),
    ],
)
def test_the_number_of_a_name(names: list[str], expected: list[int | float | None]) -> None:
    found = numbers(*names)
    assert found == expected
    assert [type(number) for number in found if number is not None] == [
        float if number % 1 else int for number in found if number is not None
    ]


def test_other_names_are_other_series() -> None:
    found = numbered(["a_0001", "a_0002", "b_0001", "shot1_0001", "shot1_0002", "shot2_0001"])
    assert len({name.series for name in found}) == 4
    assert [name.number for name in found] == [1, 2, 1, 1, 2, 1]


def test_a_sub_frame_and_a_negative_frame_are_of_the_series_of_the_others() -> None:
    assert len({name.series for name in numbered(["s.-001", "s.0000", "s.0000.50"])}) == 1
    assert len({name.series for name in numbered(["s-01", "s00", "s01"])}) == 1


def test_the_pattern_of_a_series() -> None:
    assert pattern_of(numbered(["s_0009.hi", "s_0010.hi"])) == "s_####.hi"
    assert pattern_of(numbered(["s_9", "s_10"])) == "s_#"
    assert pattern_of(numbered(["s"])) == "s"


@pytest.mark.parametrize(
    ("names", "otherwise"),
    [
        (["s.0001.25", "s.0001.50"], ("s.0001.#", 25)),
        (["s.1.25", "s.1.5"], ("s.1.#", 25)),
        (["s_0001.5", "s_0002.5"], ("s_#.5", 1)),
        (["take.1.1", "take.1.2"], ("take.#", 1.1)),
        (["s.1.5", "s.2.5"], ("s.#", 1.5)),
        # Nothing to choose between.
        (["s.0001", "s.0001.50"], None),
        (["s.0001.25", "s.0001.75", "s.0002.25"], None),
        (["smoke.1920.01", "smoke.1920.02"], None),
        (["take.1.0001", "take.1.0002"], None),
    ],
)
def test_the_other_number_that_a_name_may_have(names: list[str], otherwise: tuple[str, int | float] | None) -> None:
    assert numbered(names)[0].otherwise == otherwise


@settings(max_examples=200)
@given(
    first=st.integers(-9999, 9999),
    count=st.integers(2, 12),
    step=st.integers(1, 5),
    width=st.integers(1, 6),
    around=st.sampled_from([("smoke.", ""), ("fluid_data_", ""), ("", "_sim"), ("v12_", ".dense"), ("a_v2.", "_x")]),
)
def test_whatever_is_written_comes_back(first: int, count: int, step: int, width: int, around: tuple[str, str]) -> None:
    written = [first + step * i for i in range(count)]
    names = [f"{around[0]}{'-' if n < 0 else ''}{abs(n):0{width}d}{around[1]}" for n in written]
    assert numbers(*names) == written
    assert len({name.series for name in numbered(names)}) == 1
    assert (step_of(written), missing(written)) == (step, [])


@settings(max_examples=300)
@given(st.lists(st.text("ab01.-_v é", max_size=9), max_size=6))
def test_any_names_are_taken_apart(names: list[str]) -> None:
    found = numbered(names)
    assert len(found) == len(names)
    assert all(pattern_of([name]) is not None for name in found)


@pytest.mark.parametrize(
    ("counted", "step", "gaps"),
    [
        ([10, 12, 14, 16], 2, []),
        ([10, 12, 16, 18], 2, [14]),
        ([1, 4, 5, 9], 1, [2, 3, 6, 7, 8]),
        ([1, 1.5, 2, 3], 0.5, [2.5]),
        ([0.1, 0.2, 0.3], 0.1, []),
        ([-3, 0, 3], 3, []),
        # Thirds and sixths, rounded or cut off.
        ([1, 1.333, 1.667, 2], 1 / 3, []),
        ([1, 1.33, 1.66, 2], 1 / 3, []),
        ([-1.667, -1.333, -1], 1 / 3, []),
        ([0.5, 0.667, 0.833, 1, 1.166], 1 / 6, []),
        ([1, 1.333, 2], 1 / 3, [5 / 3]),
        ([1.3, 1.34, 1.38], 0.04, []),
        ([1.3, 1.35, 1.4, 1.45], 0.05, []),
        ([7], 1, []),
        ([], 1, []),
    ],
)
def test_steps_and_gaps(counted: list[int | float], step: int | float, gaps: list[int | float]) -> None:
    assert (step_of(counted), missing(counted)) == (step, gaps)


def test_gaps_of_any_size_take_no_time() -> None:
    assert missing([0, 1, 10**12]) == list(range(2, 13))

"""The kinds of values that a recipe holds: each knows its range, its TOML form and its command-line form."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, Protocol


class Kind(Protocol):
    """The interface of every kind of recipe value; `expected` completes the sentence "expected ..."."""

    @property
    def expected(self) -> str:
        """The allowed values in words."""
        ...

    @property
    def placeholder(self) -> str:
        """The placeholder for the value in --help."""
        ...

    def check(self, value: Any) -> Any:
        """Return the value in its normal form, or raise ValueError; a value in normal form is accepted again."""

    def read(self, text: Any) -> Any:
        """Turn the text of a flag (all texts of a repeatable one) into a value for `check`, or raise ValueError."""

    def show(self, value: Any) -> str:
        """Write a checked value as typed on the command line."""
        ...


@dataclass(frozen=True)
class Number:
    """A finite float with bounds; `above` is an exclusive lower bound; `words` are also accepted."""

    low: float | None = None
    high: float | None = None
    above: float | None = None
    words: tuple[str, ...] = ()

    @property
    def expected(self) -> str:
        """The allowed values in words."""
        number = "a number" + _range_in_words(self.low, self.high, self.above)
        return " or ".join((number, *self.words))

    @property
    def placeholder(self) -> str:
        """The placeholder for the value in --help."""
        return "|".join(("NUMBER", *self.words))

    def check(self, value: Any) -> Any:
        """Accept ints and floats inside the bounds, and the words."""
        if isinstance(value, str) and value in self.words:
            return value
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError
        _require_inside(value, self.low, self.high, self.above)
        return float(value)

    def read(self, text: str) -> float | str:
        """Read a decimal number or one of the words."""
        return text if text in self.words else float(text)

    def show(self, value: float | str) -> str:
        """Write the shortest decimal form, or the word."""
        return value if isinstance(value, str) else f"{value:g}"


@dataclass(frozen=True)
class Integer:
    """An integer with bounds; `word` is also accepted if given; `odd` restricts it to odd numbers."""

    low: int | None = None
    high: int | None = None
    word: str | None = None
    odd: bool = False

    @property
    def expected(self) -> str:
        """The allowed values in words."""
        number = f"an {'odd ' if self.odd else ''}integer{_range_in_words(self.low, self.high, None)}"
        return f"{number} or {self.word}" if self.word else number

    @property
    def placeholder(self) -> str:
        """The placeholder for the value in --help."""
        return f"INTEGER|{self.word}" if self.word else "INTEGER"

    def check(self, value: Any) -> int | str:
        """Accept ints inside the bounds, and the word."""
        if self.word and value == self.word:
            return self.word
        if isinstance(value, bool) or not isinstance(value, int) or (self.odd and value % 2 == 0):
            raise ValueError
        _require_inside(value, self.low, self.high, None)
        return value

    def read(self, text: str) -> int | str:
        """Read an integer or the word."""
        return text if text == self.word else int(text)

    def show(self, value: int | str) -> str:
        """Write the number or the word."""
        return str(value)


@dataclass(frozen=True)
class Switch:
    """True or false, as a flag on or off; the flag of a `bare` one has no value, and means on."""

    placeholder: str = "on|off"
    expected: str = "on or off (true or false in a recipe)"
    bare: bool = False

    def check(self, value: Any) -> bool:
        """Accept truth values."""
        if not isinstance(value, bool):
            raise ValueError
        return value

    def read(self, text: str) -> bool:
        """Read "on" or "true", "off" or "false"."""
        if text not in ("true", "false", "on", "off"):
            raise ValueError
        return text in ("true", "on")

    def show(self, value: bool) -> str:
        """Write "on" or "off"."""
        return "on" if value else "off"


@dataclass(frozen=True)
class Choice:
    """One of a few words."""

    options: tuple[str, ...]

    @property
    def expected(self) -> str:
        """The allowed values in words."""
        *others, last = self.options
        return f"{', '.join(others)} or {last}" if others else last

    @property
    def placeholder(self) -> str:
        """The placeholder for the value in --help."""
        return "|".join(self.options)

    def check(self, value: Any) -> str:
        """Accept exactly the options."""
        if value not in self.options:
            raise ValueError
        return value

    def read(self, text: str) -> str:
        """The text is the value."""
        return text

    def show(self, value: str) -> str:
        """The value is the text."""
        return value


@dataclass(frozen=True)
class Text:
    """A text of a given pattern, or None for "not set"."""

    placeholder: str
    expected: str
    pattern: str = r".+"

    def check(self, value: Any) -> str | None:
        """Accept None and matching texts."""
        if value is None:
            return None
        if not isinstance(value, str) or not re.fullmatch(self.pattern, value):
            raise ValueError
        return value

    def read(self, text: str) -> str:
        """The text is the value."""
        return text

    def show(self, value: str | None) -> str:
        """The value is the text."""
        return "not set" if value is None else value


@dataclass(frozen=True)
class Texts:
    """Any number of texts of a given pattern; the flag is repeated for each."""

    placeholder: str
    expected: str
    pattern: str = r".+"

    def check(self, value: Any) -> tuple[str, ...]:
        """Accept lists of matching texts."""
        if not isinstance(value, list | tuple):
            raise ValueError
        if not all(isinstance(item, str) and re.fullmatch(self.pattern, item) for item in value):
            raise ValueError
        return tuple(value)

    def read(self, text: tuple[str, ...]) -> tuple[str, ...]:
        """Every use of the flag gives one text."""
        return text

    def show(self, value: tuple[str, ...]) -> str:
        """The texts, separated by spaces."""
        return " ".join(value) or "none"


@dataclass(frozen=True)
class Range:
    """A closed range of numbers (low, high) within bounds."""

    low: float
    high: float
    placeholder: str = "LOW,HIGH"

    @property
    def expected(self) -> str:
        """The allowed values in words."""
        return f"two numbers {self.placeholder}, in this order, from {self.low:g} to {self.high:g}"

    def check(self, value: Any) -> tuple[float, float]:
        """Accept two ordered numbers inside the bounds."""
        if not isinstance(value, list | tuple) or len(value) != 2:
            raise ValueError
        low, high = (Number(self.low, self.high).check(item) for item in value)
        if low > high:
            raise ValueError
        return low, high

    def read(self, text: str) -> tuple[float, ...]:
        """Read `LOW,HIGH`."""
        return tuple(float(part) for part in text.split(","))

    def show(self, value: tuple[float, float]) -> str:
        """Write `LOW,HIGH`."""
        return f"{value[0]:g},{value[1]:g}"


@dataclass(frozen=True)
class LayerWeights:
    """A weight for each named layer: in TOML a table or a list of "LAYER=WEIGHT"; a weight left out is 1."""

    placeholder: str = "LAYER[=WEIGHT],…"
    expected: str = 'layers with weights of 0 or more, such as ["conv2/3x3", "inception_3b/output=0.5"]'

    def check(self, value: Any) -> dict[str, float]:
        """Accept a mapping, or a list of texts."""
        if isinstance(value, list | tuple):
            return self.check(dict(self._entry(item) for item in value))
        if not isinstance(value, dict) or not value or not all(isinstance(key, str) and key for key in value):
            raise ValueError
        return {layer: Number(low=0.0).check(weight) for layer, weight in value.items()}

    def read(self, text: str) -> list[str]:
        """Split the text at its commas."""
        return text.split(",")

    def show(self, value: dict[str, float]) -> str:
        """Write `LAYER=WEIGHT,…`, omitting weights of 1."""
        return ",".join(layer if weight == 1.0 else f"{layer}={weight:g}" for layer, weight in value.items())

    @staticmethod
    def _entry(item: Any) -> tuple[str, float]:
        if not isinstance(item, str):
            raise ValueError
        layer, equals, weight = item.partition("=")
        return layer, float(weight) if equals else 1.0


def _range_in_words(low: float | None, high: float | None, above: float | None) -> str:
    if above is not None:
        return f" above {_exactly(above)}" + ("" if high is None else f", at most {_exactly(high)}")
    if low is not None and high is not None:
        return f" from {_exactly(low)} to {_exactly(high)}"
    return "" if low is None else f" of {_exactly(low)} or more"


def _exactly(bound: float) -> str:
    return str(bound) if isinstance(bound, int) else f"{bound:g}"


def _require_inside(value: float, low: float | None, high: float | None, above: float | None) -> None:
    if low is not None and value < low:
        raise ValueError
    if high is not None and value > high:
        raise ValueError
    if above is not None and value <= above:
        raise ValueError

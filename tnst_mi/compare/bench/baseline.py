"""An earlier report.json as a baseline: whether either side has changed since, by what chance alone may make of it.

Where both runs have the same seed and nothing has changed, they have the same numbers. Otherwise each test of the
report is of the earlier mean against the present one, for each side; what was known to disagree may go on doing so.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.compare.bench.batches import welch
from tnst_mi.compare.bench.decision import Family, alarms, merged
from tnst_mi.compare.bench.record import FORMAT
from tnst_mi.errors import InputError
from tnst_mi.machine.gate import opening

#: The largest report that is read, in bytes.
_LARGEST = 1 << 26

#: What must be as it was, for the numbers to mean the same.
_SAME = ("subject", "left", "right")

_NUMBERS = ("left", "left_error", "left_degrees", "right", "right_error", "right_degrees")


def read_baseline(path: Path) -> dict[str, Any]:
    """A report that `tnst-mi compare --left … --right …` wrote.

    Raises:
        InputError: it is missing, damaged, or none.
    """
    with opening(path, "a report.json of tnst-mi compare"), path.open("rb") as file:
        text = file.read(_LARGEST + 1)
    if len(text) > _LARGEST:
        raise InputError(f"{path}: is larger than {_LARGEST} bytes, expected a report.json of tnst-mi compare")
    try:
        record = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read as JSON ({' '.join(str(error).split())})") from None
    found = record.get("format") if isinstance(record, dict) else None
    if found != FORMAT:
        raise InputError(
            f"{path}: its format is {found!r}, expected {FORMAT!r}: a report.json of tnst-mi compare --left … --right …"
        )
    _require_tests(path, record.get("tests"))
    return record


def require_same(path: Path, baseline: dict[str, Any], subject: dict[str, Any], left: str, right: str) -> None:
    """Check that a baseline is of the same comparison, before anything is measured.

    Raises:
        InputError: it is of another one.
    """
    for key, here in zip(_SAME, (subject, left, right), strict=True):
        if baseline.get(key) != here:
            raise InputError(
                f"{path}: its {key} is {_short(baseline.get(key))}, here it is {_short(here)}; "
                "compare the same again, or write another baseline"
            )


def require_same_tests(path: Path, baseline: dict[str, Any], record: dict[str, Any]) -> None:
    """Check that a baseline has the tests of a record.

    Raises:
        InputError: it has others.
    """
    labels = [{test["label"] for test in one["tests"]} for one in (baseline, record)]
    if labels[0] != labels[1]:
        raise InputError(
            f"{path}: has {len(labels[0])} tests where there are {len(labels[1])} here; give the same --gradients"
        )


def changes(baseline: dict[str, Any], record: dict[str, Any]) -> tuple[list[Family], list[np.ndarray]]:
    """Tests of each side against the baseline, in which `left` is the earlier mean, and which of them alarm."""
    families = []
    for side in ("left", "right"):
        before = {test["label"]: test for test in baseline["tests"]}
        pairs = [(before[test["label"]], test) for test in record["tests"]]
        families.append(_changes(side, pairs))
    families = merged(families)
    return families, alarms(families)


def change_verdict(families: Sequence[Family], found: Sequence[np.ndarray]) -> str:
    """One line: whether something has changed since the baseline, and the clearest change."""
    total = sum(len(tests.labels) for tests in families)
    count = sum(int(alarm.sum()) for alarm in found)
    if not count:
        return f"unchanged: none of {total} numbers differs from the baseline by more than chance explains"
    tests, alarm = next((tests, alarm) for tests, alarm in zip(families, found, strict=True) if alarm.any())
    worst = np.flatnonzero(alarm)[np.argmin(tests.tail[alarm])]
    return (
        f"CHANGED: {count} of {total} numbers differ from the baseline, the clearest {tests.name}: "
        f"{tests.labels[worst]}: {tests.left[worst]:.6g} before, {tests.right[worst]:.6g} now"
    )


def _changes(side: str, pairs: Sequence[tuple[dict[str, Any], dict[str, Any]]]) -> Family:
    def column(index: int, key: str) -> np.ndarray:
        return np.array([pair[index][f"{side}{key}"] for pair in pairs], np.float64)

    before, now = ((column(i, ""), column(i, "_error"), column(i, "_degrees")) for i in (0, 1))
    return Family(
        f"of the {side}",
        [test["label"] for _, test in pairs],
        before[0],
        now[0],
        before[1],
        now[1],
        before[2],
        now[2],
        welch(*before, *now),
        np.array([test["allowance"] for _, test in pairs], np.float64),
        np.array([test["tested"] and earlier["tested"] for earlier, test in pairs], bool),
    )


def _require_tests(path: Path, tests: Any) -> None:
    if not isinstance(tests, list) or not all(isinstance(test, dict) for test in tests):
        raise InputError(f"{path}: tests is {_short(tests)}, expected a list of tables")
    for number, test in enumerate(tests):
        where = f"{path}: test {number}"
        if not isinstance(test.get("label"), str) or not isinstance(test.get("tested"), bool):
            raise InputError(f"{where} lacks its label, or whether it was tested")
        for key in _NUMBERS:
            value = test.get(key)
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise InputError(f"{where} {key} is {_short(value)}, expected a finite number")
            if key.endswith(("_error", "_degrees")) and not 0 <= value < 1e9:
                raise InputError(f"{where} {key} is {value!r}, expected 0 or more")


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 120 else f"{text[:117]}…"

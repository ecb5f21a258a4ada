"""An earlier report as a baseline: whether either side has changed since, by what chance alone may make of it.

Where both runs have the same seed and nothing has changed, they have the same numbers. Otherwise each test is of the
earlier mean against the present one, for each side. What was known to disagree may go on doing so, but two that agreed
must not begin to, and what could be tested must be testable. The numbers of pixels are in a file beside the report.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.compare.bench.bench_settings import BenchSettings
from tnst_mi.compare.bench.record import FORMAT, OUTCOMES, PIXELS
from tnst_mi.compare.bench.renderers.sides import spelled_out
from tnst_mi.compare.bench.statistics.batches import welch
from tnst_mi.compare.bench.statistics.decision import FALSE_ALARMS, Family, alarms, merged
from tnst_mi.errors import InputError
from tnst_mi.io.grids.npz import read_arrays
from tnst_mi.machine.gate import opening

#: The largest report that is read, in bytes.
_LARGEST = 1 << 26

_NUMBERS = ("left", "left_error", "left_degrees", "right", "right_error", "right_degrees")

#: Families of which every test must remain possible; of others, some. Whether paths reach a pixel is chance.
_ALL_NEEDED = ("means", "derivatives")


@dataclass(frozen=True, eq=False)
class Baseline:
    """An earlier report.

    Attributes:
        path: of its report.json.
        record: that file.
        pixels: the columns of `pixel_columns`, each (tests,); None if the file of pixels is not beside it.
    """

    path: Path
    record: dict[str, Any]
    pixels: dict[str, np.ndarray] | None


def pixel_columns(pixels: Family) -> dict[str, np.ndarray]:
    """What a later comparison needs of the family of pixels, by the names of the file's arrays."""
    return {name: getattr(pixels, name) for name in (*_NUMBERS, "tested")}


def read_baseline(path: Path) -> Baseline:
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
    if record.get("outcome") not in OUTCOMES:
        raise InputError(f"{path}: outcome is {_short(record.get('outcome'))}, expected one of {', '.join(OUTCOMES)}")
    return Baseline(path, record, _pixels(path.with_name(PIXELS), record.get("pixels")))


def _pixels(file: Path, sha256: Any) -> dict[str, np.ndarray] | None:
    """The numbers of pixels, if they are there."""
    if not file.is_file():
        return None
    if hashlib.sha256(file.read_bytes()).hexdigest() != sha256:
        raise InputError(f"{file}: is not the file that the report beside it was written with; copy both, or remove it")
    found = read_arrays(file, (*_NUMBERS, "tested"))
    if found.keys() != {*_NUMBERS, "tested"} or len({array.shape for array in found.values()}) != 1:
        raise InputError(f"{file}: has the arrays {', '.join(found)}, expected those of tnst-mi compare")
    return found


def require_same(baseline: Baseline, subject: dict[str, Any], settings: BenchSettings) -> None:
    """Check that a baseline is of the same comparison, before anything is measured.

    Raises:
        InputError: it is of another one.
    """
    before, told = baseline.record, baseline.record.get("settings")
    earlier = before["subject"] if isinstance(before.get("subject"), dict) else {}
    told = told if isinstance(told, dict) else {}
    compared = [(f"subject's {key}", earlier.get(key), subject.get(key)) for key in {**earlier, **subject}]
    for name, side in (("left", settings.left), ("right", settings.right)):
        compared.append((name, spelled_out(str(before.get(name))), spelled_out(side.text)))
    compared.append(("tolerance", told.get("tolerance"), settings.tolerance))
    compared.append(("gradients", told.get("parameters"), list(settings.parameters)))
    for name, then, now in compared:
        if then != now:
            raise InputError(
                f"{baseline.path}: its {name} is {_short(then)}, here it is {_short(now)}; "
                "compare the same again, or write another baseline"
            )


def require_same_tests(baseline: Baseline, families: Sequence[Family]) -> None:
    """Check that a baseline has these tests.

    Raises:
        InputError: it has others.
    """
    before = [test["label"] for test in baseline.record["tests"]]
    now = [label for tests in families if tests.name != "pixels" for label in tests.labels]
    if Counter(before) != Counter(now) or len(set(now)) < len(now):
        raise InputError(f"{baseline.path}: has {len(before)} tests, expected the same {len(now)} as here, each once")
    count = next((len(tests.labels) for tests in families if tests.name == "pixels"), 0)
    if baseline.pixels is not None and baseline.pixels["left"].shape != (count,):
        raise InputError(
            f"{baseline.path.with_name(PIXELS)}: has {baseline.pixels['left'].size} pixels, expected {count}"
        )


def held_against(baseline: Baseline, families: Sequence[Family]) -> dict[str, str]:
    """What has become of a comparison since: `outcome` is "unchanged", "changed" or "inconclusive"; the `verdict`.

    Half of the false alarms that are allowed are for numbers that change, half for those that cease to agree.
    """
    known = [(tests, earlier) for tests in families if (earlier := _columns(baseline, tests)) is not None]
    changes = merged([_changes(earlier, side, tests) for side in ("left", "right") for tests, earlier in known])
    found = alarms(changes, FALSE_ALARMS / 2)
    total, count = sum(len(tests.labels) for tests in changes), sum(int(alarm.sum()) for alarm in found)
    if count:
        tests, alarm = next((tests, alarm) for tests, alarm in zip(changes, found, strict=True) if alarm.any())
        worst = np.flatnonzero(alarm)[np.argmin(tests.tail[alarm])]
        return {
            "outcome": "changed",
            "verdict": f"CHANGED: {count} of {total} numbers differ from the baseline, the clearest {tests.name}: "
            f"{tests.labels[worst]}: {tests.left[worst]:.6g} before, {tests.right[worst]:.6g} now",
        }
    now = alarms(families, FALSE_ALARMS / 2)
    disagreeing = [tests.name for tests, alarm in zip(families, now, strict=True) if alarm.any()]
    if baseline.record["outcome"] == "agree" and disagreeing:
        return {"outcome": "changed", "verdict": f"CHANGED: the sides agreed, and disagree in {', '.join(disagreeing)}"}
    if lost := [line for tests, earlier in known for line in _lost(earlier, tests)]:
        more = f" and {len(lost) - 1} more" if len(lost) > 1 else ""
        return {
            "outcome": "inconclusive",
            "verdict": f"INCONCLUSIVE: what the baseline could test cannot be tested now: {lost[0]}{more}",
        }
    apart = "" if baseline.pixels is not None else f"; without pixels, since no {PIXELS} is beside the baseline"
    return {
        "outcome": "unchanged",
        "verdict": f"unchanged: none of {total} numbers differs from the baseline by more than chance explains{apart}",
    }


def _columns(baseline: Baseline, tests: Family) -> dict[str, np.ndarray] | None:
    """The earlier numbers of a family, in its order; None if there are none."""
    if tests.name == "pixels":
        return baseline.pixels
    rows = {test["label"]: test for test in baseline.record["tests"]}
    found = [rows[label] for label in tests.labels]
    return {key: np.array([row[key] for row in found]) for key in (*_NUMBERS, "tested")}


def _changes(earlier: dict[str, np.ndarray], side: str, tests: Family) -> Family:
    """Tests of one side against the earlier numbers of a family, in which `left` is the earlier mean."""
    name = f"pixels of the {side}" if tests.name == "pixels" else f"of the {side}"
    before, after = (
        [np.asarray(found[f"{side}{key}"], np.float64) for key in ("", "_error", "_degrees")]
        for found in (earlier, pixel_columns(tests))
    )
    return Family(
        name,
        tests.labels,
        before[0],
        after[0],
        before[1],
        after[1],
        before[2],
        after[2],
        welch(*before, *after),
        tests.allowance,
        tests.size,
        np.ones(len(tests.labels)),
        np.asarray(earlier["tested"], bool) & tests.tested,
    )


def _lost(earlier: dict[str, np.ndarray], tests: Family) -> list[str]:
    """Tests that were possible and are no longer."""
    before = np.asarray(earlier["tested"], bool)
    if tests.name in _ALL_NEEDED:
        gone = before & ~tests.tested
        return [label for label, is_gone in zip(tests.labels, gone, strict=True) if is_gone]
    return [f"all {tests.name}"] if before.any() and not tests.tested.any() else []


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

"""The numbers of a comparison as report.json, whose schema is `tnst_mi/data/compare.schema.json`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tnst_mi.compare.bench.bench_settings import BATCHES, BenchSettings
from tnst_mi.compare.bench.measurement import Measured
from tnst_mi.compare.bench.statistics.batches import Batches, difference
from tnst_mi.compare.bench.statistics.decision import FALSE_ALARMS, Family, alarms, detectable
from tnst_mi.compare.bench.statistics.hypotheses import ImagePair
from tnst_mi.compare.values import relative_rms

FORMAT = "tnst_mi.compare/1"

#: The file beside report.json with the numbers of every pixel, for `baseline`.
PIXELS = "pixels.npz"

OUTCOMES = ("agree", "disagree", "inconclusive")

#: The family that is too large to be written test by test, and how many of its alarms are named.
_LARGE, _NAMED = "pixels", 20

METHOD = (
    "difference of the means of independent batches, less what does not count, in standard errors, against Student's t "
    "with Welch's degrees of freedom; the probability is divided evenly among the families, in each by Holm's procedure"
)


def record_of(subject: dict[str, Any], settings: BenchSettings, measured: Measured) -> dict[str, Any]:
    """All numbers; `subject` says what was rendered."""
    families = measured.families()
    found, seen = alarms(families), detectable(families)
    outcome = outcome_of(measured, found)
    record = {
        "format": FORMAT,
        "subject": subject,
        "left": settings.left.text,
        "right": settings.right.text,
        "variants": dict(zip(("left", "right"), measured.variants, strict=True)),
        "settings": {
            "spp": settings.spp,
            "gradient_spp": settings.gradient_spp,
            "batches": BATCHES,
            "tolerance": settings.tolerance,
            "seed": settings.seed,
            "parameters": list(settings.parameters),
        },
        "traced": dict(zip(("left", "right"), measured.traced, strict=True)),
        "outcome": outcome,
        "agree": outcome == "agree",
        "verdict": verdict(settings, measured, families, found, seen),
        "not_tested": not_tested(measured, families, seen),
        "false_alarms": {"probability": FALSE_ALARMS, "method": METHOD},
        "families": [_summary(*row) for row in zip(families, found, seen, strict=True)],
        "tests": [
            test
            for tests, alarm, least in zip(families, found, seen, strict=True)
            if tests.name != _LARGE
            for test in _tests(tests, alarm, least)
        ],
        "convergence": [row for pair in measured.images for row in convergence(pair, settings.spp)],
        "arbiters": [row for pair in measured.images for row in _arbiters(pair)],
        "derivatives": [
            {
                "where": derivative.where,
                "parameter": derivative.parameter,
                "left": _estimates(derivative.left),
                "right": _estimates(derivative.right),
                "missing": list(derivative.missing),
                "steps": dict(zip(("left", "right"), derivative.steps, strict=True)),
            }
            for derivative in measured.derivatives
        ],
    }
    return record


def outcome_of(measured: Measured, found: Sequence[np.ndarray]) -> str:
    """ "disagree" if any test alarms, "inconclusive" if of something that was asked for nothing could be tested, or
    "agree"."""
    if any(alarm.any() for alarm in found):
        return "disagree"
    return "inconclusive" if measured.unseen() else "agree"


def verdict(
    settings: BenchSettings,
    measured: Measured,
    families: Sequence[Family],
    found: Sequence[np.ndarray],
    seen: Sequence[np.ndarray],
) -> str:
    """One line: whether the sides agree, otherwise the clearest difference, what was tested, and how precisely."""
    sides = f"{settings.left.text} and {settings.right.text}"
    counts = ", ".join(f"{int(tests.tested.sum())} of {len(tests.labels)} {tests.name}" for tests in families)
    shares = [(tests.name, _largest_share(tests, least)) for tests, least in zip(families, seen, strict=True)]
    precise = ", ".join(f"{_percent(share)} in {name}" for name, share in shares if share is not None)
    tested = f"tested: {counts}; " + (f"9 of 10 differences are found that reach {precise}; " if precise else "")
    tested += f"differences up to {settings.tolerance:g} of the RMS do not count"
    total = sum(int(alarm.sum()) for alarm in found)
    if not total and (unseen := measured.unseen()):
        return f"INCONCLUSIVE: {sides}: nothing could be tested of the {', the '.join(unseen)}; {tested}"
    if not total:
        return f"agree: {sides} do not differ by more than chance explains; {tested}"
    # A mean says more than a tile, and that more than a pixel.
    tests, alarm = next((tests, alarm) for tests, alarm in zip(families, found, strict=True) if alarm.any())
    worst = np.flatnonzero(alarm)[np.argmin(tests.tail[alarm])]
    numbers = f"{tests.left[worst]:.6g} and {tests.right[worst]:.6g}, {_apart(tests, worst)}"
    return (
        f"DISAGREE: {sides} differ in {total} of {sum(len(tests.labels) for tests in families)} tests, the clearest of "
        f"the {tests.name}: {tests.labels[worst]}: {numbers}; {tested}"
    )


def _apart(tests: Family, index: int) -> str:
    value, error = tests.difference.value[index], tests.difference.standard_error[index]
    return f"{abs(value) / error:.1f} standard errors apart" if error > 0 else "without noise"


def _percent(share: float) -> str:
    return f"{share:.0f}%" if share >= 10 else f"{share:.2g}%"


def _largest_share(tests: Family, least: np.ndarray) -> float | None:
    """In percent of their sizes, the largest of the detectable differences; None if there is none."""
    known = np.isfinite(least) & (tests.size > 0)
    return 100 * float((least[known] / tests.size[known]).max()) if known.any() else None


def not_tested(measured: Measured, families: Sequence[Family], seen: Sequence[np.ndarray]) -> list[str]:
    """What the verdict says nothing about, and why."""
    lines = []
    for tests in families:
        black = ~tests.tested & (tests.left == 0) & (tests.right == 0)
        reasons = {
            "where both sides are 0": black,
            "where most batches have the same value: more --spp, or an independent sampler": ~tests.tested & ~black,
        }
        lines += [f"{int(which.sum())} {tests.name}, {reason}" for reason, which in reasons.items() if which.any()]
    lines += [
        f"{pair.where} anything: both sides are black".strip()
        for pair in measured.images
        if not pair.left.values.any() and not pair.right.values.any()
    ]
    lines += [
        f"the sign of the {label}: only differences of {_percent(100 * differs / size)} would be found; more --spp"
        for tests, least in zip(families, seen, strict=True)
        if tests.name == "derivatives"
        for label, differs, size in zip(tests.labels, least, tests.size, strict=True)
        if differs > size > 0
    ]
    lines += measured.untested
    lines += list(dict.fromkeys(reason for derivative in measured.derivatives for reason in derivative.missing))
    if not measured.derivatives:
        lines.append("derivatives: none were asked for (--gradients)")
    return lines


def convergence(pair: ImagePair, spp: int) -> list[dict[str, Any]]:
    """Differences against the number of paths: of the first batches, each time twice as many.

    Without bias the RMS of the pixels' differences is what their noise lets one expect, and the mean's interval
    contains 0, however many paths there are.
    """
    count = max(len(pair.left.values), len(pair.right.values))
    rows, used = [], 2
    while used <= count:
        left, right = pair.left.first(used), pair.right.first(used)
        pixels = difference(left, right)
        mean = difference(_whole(left), _whole(right))
        rows.append(
            {
                "where": pair.where,
                "spp": max(1, spp // count) * used,
                "rms": float(np.sqrt(np.mean(pixels.value**2))),
                "expected_rms": float(np.sqrt(np.mean(pixels.standard_error**2))),
                "bias": float(mean.value[0]),
                "bias_half_width": float(mean.half_width[0]),
            }
        )
        used *= 2
    return rows


def _whole(images: Batches) -> Batches:
    """The mean of all pixels, (batches, 1)."""
    return Batches(images.values.reshape(len(images.values), -1).mean(1, keepdims=True), images.rare)


def _arbiters(pair: ImagePair) -> list[dict[str, Any]]:
    return [
        {
            "where": pair.where,
            "arbiter": name,
            "left": relative_rms(pair.left.mean, image),
            "right": relative_rms(pair.right.mean, image),
        }
        for name, image in pair.arbiters.items()
    ]


def _estimates(found: dict[str, Batches]) -> dict[str, Any]:
    return {
        way: {"value": float(estimate.mean), "half_width": float(estimate.half_width)}
        for way, estimate in found.items()
    }


def _summary(tests: Family, alarm: np.ndarray, least: np.ndarray) -> dict[str, Any]:
    share = _largest_share(tests, least)
    scores = tests.scores[np.isfinite(tests.scores)]
    return {
        "name": tests.name,
        "tests": len(tests.labels),
        "tested": int(tests.tested.sum()),
        "alarms": int(alarm.sum()),
        "named": [tests.labels[i] for i in np.flatnonzero(alarm)[np.argsort(tests.tail[alarm])][:_NAMED]],
        "smallest_tail": float(tests.tail.min()),
        "detectable": None if share is None else share / 100,
        "z_mean": float(scores.mean()) if len(scores) else None,
        "z_rms": float(np.sqrt(np.mean(scores**2))) if len(scores) else None,
    }


def _tests(tests: Family, alarm: np.ndarray, least: np.ndarray) -> list[dict[str, Any]]:
    width = tests.difference.half_width
    return [
        {
            "family": tests.name,
            "label": label,
            "left": float(tests.left[i]),
            "left_error": float(tests.left_error[i]),
            "left_degrees": int(tests.left_degrees[i]),
            "right": float(tests.right[i]),
            "right_error": float(tests.right_error[i]),
            "right_degrees": int(tests.right_degrees[i]),
            "difference": float(tests.difference.value[i]),
            "half_width": float(width[i]),
            "allowance": float(tests.allowance[i]),
            "detectable": float(least[i]) if np.isfinite(least[i]) else None,
            "tail": float(tests.tail[i]),
            "tested": bool(tests.tested[i]),
            "alarm": bool(alarm[i]),
        }
        for i, label in enumerate(tests.labels)
    ]

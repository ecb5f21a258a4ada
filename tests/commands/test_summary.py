"""What is said of a run that is done."""

from __future__ import annotations

import numpy as np
import pytest

import tnst_mi
from tnst_mi.commands.stylize import mass_remark, sequence_summary
from tnst_mi.frame import Frame
from tnst_mi.run.record import sequence_record


@pytest.mark.parametrize(
    ("keys", "after", "remedy"),
    [
        ({"lam": 1.0}, 80.0, 'lost 20.0% of its smoke; transport = "flow" and lam = 0'),
        ({"lam": 0.0, "steps": "auto"}, 80.0, 'lost 20.0% of its smoke; transport = "flow" and steps = 1'),
        ({"transport": "flow", "lam": 0.5}, 112.0, "gained 12.0% of its smoke; lam = 0"),
        ({"transport": "flow", "lam": {1: 0.0, 9: 1.0}}, 105.3, "gained 5.3% of its smoke; lam = 0"),
        (
            {"transport": "flow", "lam": 0.0},
            80.0,
            "lost 20.0% of its smoke; a lower eta or strength, or more room around the smoke,",
        ),
        ({}, float("nan"), None),
        ({}, 96.0, None),
        ({"parameterisation": "density"}, 200.0, None),
    ],
)
def test_a_changed_mass_is_remarked_upon_with_what_keeps_it(keys: dict, after: float, remedy: str | None) -> None:
    recipe = tnst_mi.Recipe.from_dict({"style": ["net"], **keys})
    records = [
        {"name": "empty", "number": 8, "mass_before": 0.0, "mass_after": 0.0},
        {"name": "a", "number": 9, "mass_before": 100.0, "mass_after": after},
        {"name": "b", "number": 10, "mass_before": 100.0, "mass_after": 97.0},
    ]
    said = mass_remark(recipe, records)
    assert said == (remedy and f"a {remedy} would keep more of it (docs/transport.md)")


@pytest.mark.parametrize(
    ("change", "said"), [(0.2, "flicker 2.36 at window 1, "), (0.005, "flicker: too little changed to measure it, ")]
)
def test_flicker_is_not_told_of_what_hardly_changed(change: float, said: str) -> None:
    sequence = {"flicker": 2.36, "window": 1, "loss_before": 14.5, "loss_after": 13.5, "relative_change": change}
    losses = f"mean loss in the fixed views 14.5 → 13.5, relative change {change}"
    assert sequence_summary(sequence) == f"sequence  {said}{losses}"


def test_drift_is_the_range_of_what_frames_gain_or_lose() -> None:
    frames = [Frame(np.full((2, 2, 2), d, np.float32), name=str(i)) for i, d in enumerate((1.0, 2.0, 0.0))]
    losses = {"loss_before": 2.0, "loss_after": 1.0, "terms_before": {}, "terms_after": {}}
    records = [
        {"name": f.name, "mass_before": f.mass, "mass_after": after, **losses}
        for f, after in zip(frames, (7.6, 16.32, 0.0), strict=True)
    ]
    found = sequence_record(tnst_mi.Recipe(tag=("a",)), frames, [f.density for f in frames], records)
    assert found["mass_changes"] == [pytest.approx(-0.05), pytest.approx(0.02), None]
    assert found["mass_drift"] == pytest.approx(0.07)

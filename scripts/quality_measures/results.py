"""What is shown of a comparison whose trials are done: its records, and the rows of its sheet."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from quality_measures.compared import Trial
from quality_measures.crops import EDGE
from quality_measures.seen import style_picture
from quality_measures.sheet import Panel
from quality_measures.table import Records
from quality_measures.trials import Comparison


def records(comparison: Comparison) -> dict[str, Records]:
    """The records by (input, style, variant), by what is equal."""
    return {
        equal: {_cell(trial): comparison.record(trial) for trial in trials}
        for equal, trials in comparison.by_budget().items()
    }


def described(comparison: Comparison) -> str:
    """What was compared, in words."""
    grids = {smoke.name: " × ".join(map(str, smoke.frames[0].density.shape)) for smoke in comparison.smokes}
    recipe = comparison.recipe(comparison.trials()[0])
    return (
        f"{comparison.driver.flavour} optimises, {comparison.judge.flavour} judges. {recipe.octaves} octaves × "
        f"{comparison.iterations} iterations × {recipe.views} views; "
        + ", ".join(f"{name} {grid} cells" for name, grid in grids.items())
        + f"; pieces of up to {EDGE} pixels."
    )


def panels(comparison: Comparison) -> list[list[Panel]]:
    """A row for each style: the picture, then for each input what it was and what each trial has made of it."""
    trials = comparison.trials()
    rows = []
    for style in comparison.styles:
        row: list[Panel] = []
        for smoke in comparison.smokes:
            of_cell = [trial for trial in trials if trial.smoke is smoke and trial.style == style]
            for number, trial in enumerate(of_cell):
                before, after = comparison.pictures(trial)
                if not row:
                    picture = style_picture(comparison.recipe(trial).style[0], before.shape)
                    row.append(Panel(picture.grey, Path(style).stem))
                if number == 0:
                    row.append(Panel(before, smoke.name))
                row.append(Panel(after, _caption(trial, comparison.record(trial))))
        rows.append(row)
    return rows


def _caption(trial: Trial, record: dict[str, Any]) -> str:
    return f"{trial.variant.name}, {trial.iterations} iterations\ntexture {record['texture']:.2f}"


def _cell(trial: Trial) -> tuple[str, str, str]:
    return trial.smoke.name, Path(trial.style).stem, trial.variant.name

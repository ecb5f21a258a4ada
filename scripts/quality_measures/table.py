"""What came of a comparison, in Markdown."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

#: The measures of a record, with their headings in the tables.
MEASURES = {
    "texture": "texture",
    "scrambled": "texture, scrambled",
    "contrast": "contrast",
    "spectral_distance": "spectral distance",
    "frequency": "frequency",
    "mass_kept": "mass kept",
    "flicker": "flicker",
    "perceptual_flicker": "perceptual flicker",
}

#: A texture distance counts as better from this part of the other one downwards.
CLEARLY_BETTER = 0.85

#: Records by (input, style, variant), of one budget.
Records = Mapping[tuple[str, str, str], Mapping[str, Any]]


def report(budgets: Mapping[str, Records], variants: Sequence[str], head: str) -> str:
    """All tables: for each budget what the judge says of each cell, and the means of all measures.

    Args:
        budgets: records by what is equal.
        variants: their names; the first is the one that others are compared with.
        head: what is said above them.
    """
    parts = ["# Quality of stylizations", "", head]
    for equal, records in budgets.items():
        parts += ["", f"## At {equal}", "", *summary(records, variants), "", *textures(records, variants)]
    parts += ["", "## All trials", "", *all_trials(budgets)]
    return "\n".join(parts) + "\n"


def summary(records: Records, variants: Sequence[str]) -> list[str]:
    """A row for each variant: means over all cells, and in how many the judge sees it clearly nearer than the first."""
    cells = sorted({(smoke, style) for smoke, style, _ in records})
    rows = []
    for variant in variants:
        of_variant = [records[*cell, variant] for cell in cells]
        ratios = [records[*cell, variant]["texture"] / records[*cell, variants[0]]["texture"] for cell in cells]
        better = sum(ratio <= CLEARLY_BETTER for ratio in ratios)
        worse = sum(ratio >= 1 / CLEARLY_BETTER for ratio in ratios)
        means = [_mean(record[measure] for record in of_variant) for measure in MEASURES]
        against = "–" if variant == variants[0] else f"{better} better, {worse} worse of {len(cells)}"
        rows.append((variant, *means, against))
    return _table(("variant", *MEASURES.values(), f"texture against {variants[0]} by 15%"), rows)


def textures(records: Records, variants: Sequence[str]) -> list[str]:
    """The relative texture distance of each cell, and what the style itself would have in the smoke's silhouette."""
    rows = []
    for smoke, style in dict.fromkeys((smoke, style) for smoke, style, _ in records):
        of_cell = [records[smoke, style, variant] for variant in variants]
        rows.append((smoke, style, *(_number(r["texture"]) for r in of_cell), _number(of_cell[0]["reachable"])))
    return _table(("input", "style", *variants, "the style itself"), rows)


def all_trials(budgets: Mapping[str, Records]) -> list[str]:
    """A row for each stylization."""
    rows = {}
    for records in budgets.values():
        for (smoke, style, variant), record in records.items():
            rows[smoke, style, variant, record["iterations"]] = (
                smoke,
                style,
                variant,
                str(record["iterations"]),
                f"{record['seconds']:.1f}",
                *(_number(record[measure]) for measure in MEASURES),
            )
    return _table(("input", "style", "variant", "iterations", "seconds", *MEASURES.values()), list(rows.values()))


def _mean(values: Iterable[float | None]) -> str:
    known = [value for value in values if value is not None]
    return _number(statistics.fmean(known) if known else None)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]

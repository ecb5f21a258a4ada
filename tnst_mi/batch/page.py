"""The page of a batch: its runs in a table, inputs from top to bottom, recipes from left to right."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from string import Template
from urllib.parse import quote

from tnst_mi.batch.jobs import DONE, Job, RunOutcome
from tnst_mi.io.atomic import written_whole
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.resources import DATA
from tnst_mi.run.difference import recipe_differences

_TEMPLATE = DATA / "batch.html"


def write_page(path: Path, jobs: Sequence[Job], outcomes: Sequence[RunOutcome]) -> None:
    """Write the HTML page; pictures and runs are links, relative to its folder."""
    cells = {
        (job.input_name, job.recipe_name): _cell(job, outcome, path.parent)
        for job, outcome in zip(jobs, outcomes, strict=True)
    }
    inputs, recipes = (list(dict.fromkeys(names)) for names in zip(*cells, strict=True))
    by_name = {job.recipe_name: job.recipe for job in jobs}
    done = sum(outcome.status == DONE for outcome in outcomes)
    head = "".join(f"<th>{html.escape(name)}</th>" for name in recipes)
    rows = [
        f"<tr><th>{html.escape(name)}</th>{''.join(cells[name, recipe] for recipe in recipes)}</tr>" for name in inputs
    ]
    page = Template(_TEMPLATE.read_text("utf-8")).substitute(
        title=html.escape(f"{path.parent.name}: {done} of {len(jobs)} runs done"),
        head=head,
        rows="\n".join(rows),
        keys="\n".join(_keys([by_name[name] for name in recipes])),
    )
    with written_whole(path) as temporary:
        temporary.write_text(page, "utf-8")


def _keys(recipes: Sequence[Recipe]) -> list[str]:
    return [
        f"<tr><th><code>{html.escape(key)}</code></th>"
        + "".join(f"<td>{'' if value is None else html.escape(str(value))}</td>" for value in values)
        + "</tr>"
        for key, values in recipe_differences(*recipes).items()
    ]


def _cell(job: Job, outcome: RunOutcome, batch: Path) -> str:
    folder = quote(job.out.relative_to(batch).as_posix())
    lines = [html.escape(outcome.status if outcome.error is None else outcome.error)] if outcome.status != DONE else []
    if outcome.loss_before is not None and outcome.loss_after is not None:
        lines.append(f"loss {outcome.loss_before:.3g} → {outcome.loss_after:.3g}")
    if outcome.mass_change is not None:
        lines.append(f"mass {outcome.mass_change:+.1%}")
    if outcome.frames > 1:
        lines.append(f"{outcome.frames} frames")
    if outcome.seconds is not None:
        lines.append(f"{outcome.seconds:.0f} s")
    picture = f'<img src="{quote(outcome.picture)}" alt="before and after" loading="lazy">' if outcome.picture else ""
    links = [f'<a href="{folder}/recipe.toml">recipe</a>'] if outcome.picture else []
    links += [f'<a href="{quote(outcome.video)}">video</a>'] if outcome.video else []
    told = f"<p>{', '.join(lines)}</p><p>{' '.join(links)}</p>"
    return f'<td class="{outcome.status}"><a href="{folder}/">{picture}</a>{told}</td>'

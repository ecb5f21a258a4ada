"""The masks of a recipe, as the page lists and edits them: for each target the parts whose product its mask is."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.io.files.frame_numbers import Number
from tnst_mi.machine.terminal import one_line
from tnst_mi.recipe.paths import shipped_name
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.region_keys import GOALS, form_of
from tnst_mi.recipe.targets import parts_of, table_of

#: What the page may say of a part, as numbers and switches. Files are never among it: it could name any of the machine.
_KEYS = ("shape", "centre", "radius", "low", "high", "edge", "strength", "invert", "follow")

#: Parts of a mask, at most: each is another grid to evaluate.
_MOST = 16

_ACTIONS = ("add", "change", "remove")


def mask_tables(recipe: Recipe) -> list[list[dict[str, Any]]]:
    """For each target of a recipe, or the whole of one without targets, the parts of its mask as tables."""
    masks = [target.get("mask") for target in recipe.target] or [recipe.mask]
    return [[dict(table_of(part)) for part in parts_of(mask)] for mask in masks]


def masks_described(recipe: Recipe, ids: PartIds) -> list[dict[str, Any]]:
    """What the page shows of each target: its title, and the id, form, title and table of each part of its mask."""
    titles = [_goal_of(number, target) for number, target in enumerate(recipe.target, start=1)] or ["all goals"]
    parts = [
        [
            {"id": identity, "form": form_of(table), "title": _title(table), "table": table}
            for identity, table in zip(of_target, tables, strict=True)
        ]
        for of_target, tables in zip(ids.of(recipe), mask_tables(recipe), strict=True)
    ]
    return [{"title": title, "parts": of_target} for title, of_target in zip(titles, parts, strict=True)]


def starts_of_following(recipe: Recipe, first: int | float | None) -> set[int | float | None]:
    """The numbers of the frames from which masks of a recipe follow the smoke.

    Args:
        recipe: whose masks.
        first: the number of the first frame.
    """
    follows = [table.get("follow", False) for tables in mask_tables(recipe) for table in tables]
    return {first if follow is True else follow for follow in follows if follow is not False}


@dataclass(frozen=True)
class MaskEdit:
    """A change of the mask of a target.

    Attributes:
        action: "add" a part, "change" keys of one, or "remove" one.
        target: index of the target, 0 in a recipe without targets.
        part: index of the part that is changed or removed.
        values: the keys of a new part, or those that are changed; None takes a key away.
        id: of the part, as pages are told; it counts in place of the index, which another tab may have changed.
    """

    action: str
    target: int
    part: int = 0
    values: Mapping[str, Any] = field(default_factory=dict)
    id: int | None = None

    @classmethod
    def of_json(cls, values: Mapping[str, Any]) -> MaskEdit:
        """An edit that the page asks for.

        Raises:
            InputError: it is none, or it names a file.
        """
        action, keys = values.get("action"), values.get("values", {})
        target, part, identity = values.get("target", 0), values.get("part", 0), values.get("id")
        if action not in _ACTIONS:
            raise InputError(one_line(f"mask: action = {action!r}: expected one of {', '.join(_ACTIONS)}"))
        if not all(isinstance(index, int) and not isinstance(index, bool) for index in (target, part, identity or 0)):
            raise InputError("mask: target, part and id are whole numbers, from 0")
        if not isinstance(keys, Mapping):
            raise InputError("mask: values are a table of keys, such as {radius: 4}")
        if foreign := [key for key in keys if key not in _KEYS]:
            raise InputError(one_line(f"mask: the page sets no {foreign[0]!r}, expected one of {', '.join(_KEYS)}"))
        return cls(action, target, part, keys, identity)

    def from_frame(self, numbers: Sequence[Number | None], index: int) -> MaskEdit:
        """The edit, of which what begins to follow the smoke does so from a frame, by its index among these."""
        number = numbers[index]
        if self.values.get("follow") is not True or not isinstance(number, int) or len(numbers) < 2:
            return self
        return replace(self, values={**self.values, "follow": number})

    def applied(self, recipe: Recipe) -> dict[str, Any]:
        """The keys of a recipe that this changes, with their new values, which the recipe has yet to check.

        Raises:
            InputError: there is no such target or part, or there are too many.
        """
        masks = mask_tables(recipe)
        tables = _at(masks, self.target, "target")
        if self.action == "add":
            if len(tables) >= _MOST:
                raise InputError(f"mask: has {_MOST} parts already; remove some")
            tables.append(_without_none(self.values))
        else:
            table = _at(tables, self.part, "part of the mask")
            if self.action == "change":
                tables[self.part] = _without_none({**table, **self.values})
            else:
                del tables[self.part]
        mask = tables or None
        if not recipe.target:
            return {"mask": mask}
        targets = [dict(target) for target in recipe.target]
        targets[self.target] |= {"mask": mask}
        return {"target": [_without_none(target) for target in targets]}


class PartIds:
    """Names parts of masks by numbers that stay theirs when others are added and removed, and are not given again.

    Args:
        ids: of the parts of each target's mask.
    """

    _next = itertools.count(1)

    def __init__(self, ids: list[list[int]] | None = None) -> None:
        self._ids = ids or []

    def of(self, recipe: Recipe) -> list[list[int]]:
        """The ids of the parts of each target's mask; new ones, if the recipe is not the one that had them."""
        counts = [len(tables) for tables in mask_tables(recipe)]
        if [len(ids) for ids in self._ids] != counts:
            self._ids = [[next(self._next) for _ in range(count)] for count in counts]
        return self._ids

    def located(self, edit: MaskEdit, recipe: Recipe) -> MaskEdit:
        """An edit with the index of the part that its id names.

        Raises:
            InputError: there is no such part any more.
        """
        if edit.id is None:
            return edit
        ids = _at(self.of(recipe), edit.target, "target")
        if edit.id not in ids:
            raise InputError("mask: this region is gone, removed or replaced in another tab; nothing has been changed")
        return replace(edit, part=ids.index(edit.id))

    def after(self, edit: MaskEdit, recipe: Recipe) -> PartIds:
        """The ids after an edit that has been located and can be done."""
        ids = [list(of_target) for of_target in self.of(recipe)]
        if edit.action == "add":
            ids[edit.target].append(next(self._next))
        elif edit.action == "remove":
            del ids[edit.target][edit.part]
        return PartIds(ids)


def _at(items: list[Any], index: int, name: str) -> Any:
    if not 0 <= index < len(items):
        raise InputError(f"mask: there is no {name} {index}, counted from 0; there are {len(items)}")
    return items[index]


def _without_none(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _goal_of(number: int, target: Mapping[str, Any]) -> str:
    key = next(goal for goal in GOALS if goal in target)
    names = target[key] if isinstance(target[key], list | tuple) else ()
    return f"{number}: {key} {' '.join(Path(shipped_name(name)).stem for name in names)}".rstrip()


def _title(table: Mapping[str, Any]) -> str:
    """What a part is, in a word or two."""
    form = form_of(table)
    if form == "grid":
        return f"grid {table['grid']}"
    if form == "file":
        return f"file {Path(table['file']).name}"
    if form == "image":
        return f"painting {Path(table['image']).stem}"
    return form

"""What the page can set of a recipe: sliders for the keys that matter most, and the goals that have been chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import one_line
from tnst_mi.recipe.keys import Integer
from tnst_mi.recipe.paths import shipped_name
from tnst_mi.recipe.recipe import KINDS, Recipe, documentation
from tnst_mi.run.going_on import FREE
from tnst_mi.studio.choices.masks import MaskEdit, PartIds, masks_described

#: Keys that name goals, and what one of theirs is called on the page.
GOAL_KEYS = ("style", "tag", "semantic")

#: Those that come with recipes alone.
OTHER_GOALS = ("content", "match", "target")


@dataclass(frozen=True)
class Knob:
    """A slider.

    Attributes:
        key: of the recipe.
        label: in a word or two.
        low, high: its ends, within what the key allows.
        step: between its values; of a logarithmic one, between their logarithms to base 10.
        logarithmic: whether each step multiplies.
        word: what the key may be instead of a number, such as "auto".
    """

    key: str
    label: str
    low: float
    high: float
    step: float
    logarithmic: bool = False
    word: str | None = None


#: In the order of the page.
KNOBS = (
    Knob("strength", "strength", 0.0, 1.0, 0.05),
    Knob("motif_size", "motif size", 0.05, 1.0, 0.05, word="auto"),
    Knob("gamma", "γ, thickness", 0.005, 5.0, 0.05, logarithmic=True),
    Knob("lam", "λ, expansion", 0.0, 1.0, 0.05),
    Knob("eta", "η, step size", 0.0002, 0.02, 0.05, logarithmic=True),
    Knob("window", "window", 1, 15, 2),
    Knob("coherence", "steadiness", 0.0, 5.0, 0.25),
    Knob("octaves", "octaves", 1, 5, 1),
    Knob("iterations", "iterations", 1, 60, 1),
    Knob("views", "views", 1, 16, 1),
)

_KNOBS = {knob.key: knob for knob in KNOBS}


@dataclass
class StudioSettings:
    """A recipe, and what has been set since.

    Attributes:
        base: the recipe of what is opened, or the defaults.
        values: the keys that were set, with their values.
        parts: what the parts of masks are called.
    """

    base: Recipe = field(default_factory=Recipe)
    values: dict[str, Any] = field(default_factory=dict)
    parts: PartIds = field(default_factory=PartIds)

    @property
    def recipe(self) -> Recipe:
        """The recipe as it is set."""
        return self._with(self.values)

    def set(self, key: str, value: object) -> None:
        """Set a key of a slider, or take what was set back if the value is None.

        Raises:
            InputError: there is no such slider, or the key does not allow the value.
        """
        if key not in _KNOBS:
            raise InputError(one_line(f"studio: no slider {key!r}, expected one of {', '.join(_KNOBS)}"))
        if isinstance(KINDS[key], Integer) and isinstance(value, float) and value.is_integer():
            value = int(value)
        values = {name: old for name, old in self.values.items() if name != key}
        if value is not None:
            values[key] = value
        self._with(values)
        self.values = values

    def goals(self, key: str) -> list[str]:
        """The goals of a key, as the page knows them.

        Raises:
            InputError: the key names no goals.
        """
        if key not in GOAL_KEYS:
            raise InputError(one_line(f"studio: no goals {key!r}, expected one of {', '.join(GOAL_KEYS)}"))
        return [shipped_name(name) for name in getattr(self.recipe, key)]

    def toggle(self, key: str, goal: str) -> None:
        """Add a goal, or remove it if it is there.

        Raises:
            InputError: the key names no goals, or does not allow it.
        """
        before = self.goals(key)
        after = [name for name in before if name != goal] if goal in before else [*before, goal]
        values = self.values | {key: after}
        self._with(values)
        self.values = values

    def edited(self, edit: MaskEdit) -> StudioSettings:
        """These settings after an edit of a mask.

        Raises:
            InputError: there is no such mask, or the recipe does not allow what becomes of it.
        """
        recipe = self.recipe
        edit = self.parts.located(edit, recipe)
        values = self.values | edit.applied(recipe)
        settings = StudioSettings(self.base, values, self.parts.after(edit, recipe))
        settings._with(settings.values)
        return settings

    def described(self) -> dict[str, Any]:
        """What the page shows: sliders with their help, goals, and the keys that have others."""
        recipe, texts = self.recipe, documentation()
        knobs = [
            vars(knob)
            | {
                "value": getattr(recipe, knob.key),
                "set": knob.key in self.values,
                "free": knob.key in FREE,
                "keyframed": knob.key in recipe.keyframes,
                "help": texts[knob.key],
                "expected": KINDS[knob.key].expected,
            }
            for knob in KNOBS
        ]
        goals = [{"key": key, "goal": shipped_name(name)} for key in GOAL_KEYS for name in getattr(recipe, key)]
        return {
            "knobs": knobs,
            "goals": goals,
            "other_goals": [key for key in OTHER_GOALS if getattr(recipe, key)],
            "masks": masks_described(recipe, self.parts),
        }

    def _with(self, values: Mapping[str, Any]) -> Recipe:
        return self.base.updated(values, "studio: ", Path.cwd())

"""What the page can set of a recipe: sliders for the keys that matter most, and the goals that have been chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import one_line
from tnst_mi.network.shipped import PATTERNS
from tnst_mi.recipe.keys import Choice, Integer
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


@dataclass(frozen=True)
class Pick:
    """A key that is one of a few words.

    Attributes:
        key: of the recipe.
        label: in a word or two.
    """

    key: str
    label: str

    @property
    def words(self) -> tuple[str, ...]:
        """What it may be."""
        kind = KINDS[self.key]
        assert isinstance(kind, Choice)
        return kind.options


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
    Knob("colour_weight", "weight of colours", 0.0, 4.0, 0.25),
)
PICKS = (Pick("colour", "colour of the smoke"),)

_SETTABLE = {control.key: control for control in (*KNOBS, *PICKS)}


class StudioSettings:
    """A recipe, and what has been set since.

    It is checked when something is set, and not when it is read: a file that it names may go meanwhile, and what is
    left must be shown, and can be removed. What is new is looked for; what a run needs of files, `require_files`.

    Args:
        base: the recipe of what is opened, or the defaults.
        values: the keys that were set, with their values; paths are absolute.
        parts: what the parts of masks are called.

    Attributes:
        base, values, parts: likewise.
        recipe: the recipe as it is set.
    """

    def __init__(
        self, base: Recipe | None = None, values: Mapping[str, Any] | None = None, parts: PartIds | None = None
    ) -> None:
        self._base, self.values = base or Recipe(), dict(values or {})
        self.parts = parts or PartIds()
        self.recipe = _over(self._base, self.values)

    @property
    def base(self) -> Recipe:
        """The recipe of what is opened, or the defaults."""
        return self._base

    @base.setter
    def base(self, base: Recipe) -> None:
        self.recipe = _over(base, self.values)
        self._base = base

    def set(self, key: str, value: object) -> None:
        """Set a key of a slider or a choice, or take what was set back if the value is None.

        Raises:
            InputError: there is no such slider or choice, or the key does not allow the value.
        """
        if key not in _SETTABLE:
            raise InputError(one_line(f"studio: no slider {key!r}, expected one of {', '.join(_SETTABLE)}"))
        if isinstance(KINDS[key], Integer) and isinstance(value, float) and value.is_integer():
            value = int(value)
        values = {name: old for name, old in self.values.items() if name != key}
        if value is not None:
            values[key] = value
        self._take(values)

    def free(self) -> dict[str, Any]:
        """What has been set of sliders that may differ from what is gone on from."""
        return {key: value for key, value in self.values.items() if key in _SETTABLE and key in FREE}

    def set_again(self, values: Mapping[str, Any]) -> list[str]:
        """Set what was set before of keys that have other values now; returns these keys."""
        changed = {key: value for key, value in values.items() if getattr(self.recipe, key) != value}
        self._take(self.values | changed)
        return list(changed)

    def cleared(self) -> StudioSettings:
        """These settings without goals and masks."""
        without = {key: getattr(Recipe(), key) for key in (*GOAL_KEYS, *OTHER_GOALS, "mask")}
        return StudioSettings(self.base, self.values | without)

    def take_all_frames(self) -> None:
        """Let the recipe be of all frames of an input."""
        if self.recipe.frames is not None:
            self._take(self.values | {"frames": None})

    def goals(self, key: str) -> list[str]:
        """The goals of a key, as the page knows them.

        Raises:
            InputError: the key names no goals.
        """
        if key not in GOAL_KEYS:
            raise InputError(one_line(f"studio: no goals {key!r}, expected one of {', '.join(GOAL_KEYS)}"))
        return [shipped_name(name) for name in getattr(self.recipe, key)]

    def toggle(self, key: str, goal: str, flavour: str | None = None) -> None:
        """Add a goal, or remove it if it is there.

        Args:
            key: of the recipe.
            goal: the value.
            flavour: of the network among whose channels it is chosen. Runs take the one that ships with the package for
                channels only if the recipe names it, and so it does from now on.

        Raises:
            InputError: the key names no goals, or does not allow it.
        """
        there, goals = self.goals(key), getattr(self.recipe, key)
        if goal in there:
            goals = tuple(path for path, name in zip(goals, there, strict=True) if name != goal)
        else:
            goals += getattr(Recipe().updated({key: [goal]}, "studio: ", Path.cwd()), key)
        meant = {"weights": PATTERNS} if key == "semantic" and flavour == PATTERNS else {}
        self._take(self.values | {key: goals} | (meant if self.recipe.weights is None else {}))

    def edited(self, edit: MaskEdit) -> StudioSettings:
        """These settings after an edit of a mask.

        Raises:
            InputError: there is no such mask, or the recipe does not allow what becomes of it.
        """
        edit = self.parts.located(edit, self.recipe)
        values = self.values | edit.applied(self.recipe)
        return StudioSettings(self.base, values, self.parts.after(edit, self.recipe))

    def require_files(self) -> None:
        """Check that all files are there that the recipe names.

        Raises:
            InputError: one is not.
        """
        try:
            self.recipe.located(Path.cwd())
        except InputError as error:
            raise InputError(f"{error}; bring it back, or remove the goal or the region that needs it") from None

    def described(self) -> dict[str, Any]:
        """What the page shows: sliders and choices with their help, goals, and the keys that have others."""
        recipe = self.recipe
        knobs = [vars(knob) | self._told(knob.key) for knob in KNOBS]
        picks = [vars(pick) | {"words": pick.words} | self._told(pick.key) for pick in PICKS]
        goals = [{"key": key, "goal": shipped_name(name)} for key in GOAL_KEYS for name in getattr(recipe, key)]
        return {
            "knobs": knobs,
            "picks": picks,
            "goals": goals,
            "other_goals": [key for key in OTHER_GOALS if getattr(recipe, key)],
            "masks": masks_described(recipe, self.parts),
            "frames": recipe.frames,
        }

    def _told(self, key: str) -> dict[str, Any]:
        """What the page shows of a key."""
        return {
            "value": getattr(self.recipe, key),
            "set": key in self.values,
            "free": key in FREE,
            "keyframed": key in self.recipe.keyframes,
            "help": documentation()[key],
            "expected": KINDS[key].expected,
        }

    def _take(self, values: dict[str, Any]) -> None:
        self.recipe = _over(self.base, values)
        self.values = values


def _over(base: Recipe, values: Mapping[str, Any]) -> Recipe:
    """A recipe with values of keys in place of its own; whether their files are there is not asked."""
    given = {name: dict(base.keyframes[name]) if name in base.keyframes else getattr(base, name) for name in base.given}
    return Recipe(**{**given, **values})

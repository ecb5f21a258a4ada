"""What is said of settings, in a line: which stay when something is opened or gone on from, and which are fixed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tnst_mi.errors import InputError
from tnst_mi.studio.choices.masks import mask_tables
from tnst_mi.studio.choices.settings import GOAL_KEYS, OTHER_GOALS, StudioSettings
from tnst_mi.studio.source import Source


@dataclass(frozen=True)
class Remark:
    """A line of the page.

    Attributes:
        text: likewise.
        clears: whether a button beside it removes the goals and the regions.
    """

    text: str
    clears: bool = False


def stays(settings: StudioSettings, before: Source | None, now: Source | None) -> Remark | None:
    """What of the recipe stays when an input is opened after another one; None if nothing does."""
    if before is None or before == now:
        return None
    goals = any(getattr(settings.recipe, key) for key in (*GOAL_KEYS, *OTHER_GOALS))
    regions = any(mask_tables(settings.recipe))
    kept = [name for name, there in (("goals", goals), ("regions", regions)) if there]
    return Remark(f"The {' and '.join(kept)} that were set stay.", clears=True) if kept else None


def fixed(title: str) -> InputError:
    """Why something cannot be set while what is called so is gone on from."""
    return InputError(
        f"studio: goes on from {title}, whose goals, regions and fixed settings stay; the × beside it begins anew"
    )


def taken_over(title: str, kept: Sequence[str]) -> Remark:
    """What the next one has from what it goes on from, and which keys stay as they were set before."""
    text = f"Goals, regions and settings are those of {title}"
    if kept:
        text += f"; {', '.join(kept)} {'stays as it was' if len(kept) == 1 else 'stay as they were'} set before"
    return Remark(f"{text}.")

"""What a run was started for, kept beside its results, so that it can be resumed after Blender was closed."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

from ..problems import CannotStylizeError

#: In the folder of results.
FILE = "blender_plan.json"


class UnreadablePlanError(CannotStylizeError):
    """There is no plan that can be read."""


@dataclass(frozen=True)
class Part:
    """One of the stylizations of a plan.

    Attributes:
        name: of the marker that it begins at; empty if it is the only one.
        results: folder of its run.
    """

    name: str
    results: str


@dataclass(frozen=True)
class Plan:
    """A run or a batch.

    Attributes:
        item: name of the object whose smoke it is.
        source: what is read.
        out: folder of the run, or of the batch.
        recipes: files of the recipes of a batch; none for a run.
        parts: what comes of it.
        notes: what the artist should know of it, a line each: shots that are skipped, cameras that see no smoke.
    """

    item: str
    source: str
    out: str
    recipes: tuple[str, ...]
    parts: tuple[Part, ...]
    notes: tuple[str, ...] = ()

    @property
    def is_batch(self) -> bool:
        """Whether it is one of several recipes."""
        return bool(self.recipes)


def write_plan(plan: Plan, folder: Path) -> None:
    """Write a plan into a folder, whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    beside = folder / f".{FILE}.{os.getpid()}"
    beside.write_text(json.dumps(asdict(plan), indent=1) + "\n", "utf-8")
    os.replace(beside, folder / FILE)


def read_plan(folder: Path) -> Plan:
    """The plan in a folder.

    Raises:
        UnreadablePlanError: there is none that can be read.
    """
    try:
        table = json.loads((folder / FILE).read_text("utf-8"))
        parts = tuple(Part(str(part["name"]), str(part["results"])) for part in table["parts"])
        texts = [str(table[key]) for key in ("item", "source", "out")]
        notes = tuple(map(str, table.get("notes", ())))
        return Plan(*texts, recipes=tuple(map(str, table["recipes"])), parts=parts, notes=notes)
    except FileNotFoundError:
        raise UnreadablePlanError(f"{folder}: nothing was started here; press Stylize") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UnreadablePlanError(f"{folder / FILE}: cannot be read ({error}); press Stylize to start anew") from None

"""What a run was started for, kept beside its results, so that it can be resumed after Blender was closed."""

from __future__ import annotations

import json
import os
import uuid
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
        identifier: of this run alone, which its object's scene keeps too; resuming it does not change that.
        scene: file of the scene that it was started in; empty if that was not saved.
        notes: what the artist should know of it, a line each: shots that are skipped, cameras that see no smoke.
    """

    item: str
    source: str
    out: str
    recipes: tuple[str, ...]
    parts: tuple[Part, ...]
    identifier: str
    scene: str = ""
    notes: tuple[str, ...] = ()

    @property
    def is_batch(self) -> bool:
        """Whether it is one of several recipes."""
        return bool(self.recipes)


def new_identifier() -> str:
    """One that no other run has."""
    return uuid.uuid4().hex


def require_in_place(plan: Plan, folder: Path) -> None:
    """Check that the results of a plan are where it says, in its own folder.

    Raises:
        CannotStylizeError: the folder was moved or copied since: a recipe and its run name files by whole paths.
    """
    before = Path(plan.out).parent
    if not folder.exists() or not before.exists() or not folder.samefile(before):
        raise CannotStylizeError(
            f"{folder}: was started as {before}, and cannot be resumed elsewhere; put it back there, or press Stylize"
        )


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
        texts = {key: str(table[key]) for key in ("item", "source", "out", "identifier", "scene")}
        return Plan(
            recipes=tuple(map(str, table["recipes"])), parts=parts, notes=tuple(map(str, table["notes"])), **texts
        )
    except FileNotFoundError:
        raise UnreadablePlanError(f"{folder}: nothing was started here; press Stylize") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UnreadablePlanError(f"{folder / FILE}: cannot be read ({error}); press Stylize to start anew") from None

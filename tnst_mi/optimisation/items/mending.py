"""What becomes of a working state in which an item is damaged: it goes, with all that cannot be made anew without it.

What is left is a state that a killed run could have left, so the run goes on from it to the same bits. Masks, inputs
and gains follow from the input. A step follows from the fields, as long as these have not taken it yet. Fields follow
from those with which the octave began, and these from the fields of the octave before, which are kept for it; from the
input, if they are lost too.
"""

from __future__ import annotations

from tnst_mi.optimisation.items.device_store import DeviceStore
from tnst_mi.optimisation.items.store import DamagedItemError
from tnst_mi.optimisation.plan import Plan


class Mending:
    """Mends the working state of a run.

    Args:
        plan: of the sequence.
        store: where the items are kept.
    """

    def __init__(self, plan: Plan, store: DeviceStore) -> None:
        self._plan, self._store = plan, store
        self._found: set[tuple[str | None, int, int]] = set()

    def mend(self, damage: DamagedItemError) -> None:
        """Remove what is damaged, and what can only be made anew together with it.

        Raises:
            DamagedItemError: the same item was damaged before: what is written does not stay as it was.
            OSError: it cannot be removed.
        """
        item = damage.group, damage.frame, damage.generation
        if item in self._found:
            raise damage
        self._found.add(item)
        self._store.finish()
        if damage.group is None:
            # The scales of the loss are those of fields that are no longer there.
            self._store.clear()
            self._store.backing.note("numbers.json was damaged; the run begins anew")
            return
        kind, _, level = damage.group.partition(".")
        fields, name = f"fields.{level}", self._plan.frames[damage.frame].name
        done = self._store.generation(fields, damage.frame)
        taken = kind == "step" and damage.generation <= done
        if kind == "fields" and self._plan.window == 1:
            self._store.discard(fields, damage.frame)
            lost = f"{name} begins octave {int(level) + 1} again"
        elif kind == "fields" or taken:
            # Frames of a window follow each other's steps. The steps go first: without fields, they would be those of
            # iterations to come.
            for group in (f"step.{level}", fields):
                self._store.remove(group)
            lost = f"octave {int(level) + 1} begins again"
        else:
            self._store.discard(damage.group, damage.frame, damage.generation)
            lost = "it is made anew"
        self._store.backing.note(f"{damage.group} of {name} was damaged; {lost}")

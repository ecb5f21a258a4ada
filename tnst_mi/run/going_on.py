"""`--from RUN`: a run that goes on from what an earlier one of the same input and goals has found.

Both are on the same way: octave by octave, iteration by iteration, from views that are drawn by these numbers. So what
the earlier run has done need not be done again, and where it is a draft or a preview of the same recipe, the later run
ends with the same bits as one that began anew.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.machine.gate import gate
from tnst_mi.machine.lock import require_unlocked
from tnst_mi.machine.terminal import one_line
from tnst_mi.network.download import file_hash
from tnst_mi.optimisation.items.store import DamagedItemError, FolderStore
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.optimisation.start import Start
from tnst_mi.recipe.recipe import KINDS, Recipe
from tnst_mi.recipe.sections import Reading, Resources
from tnst_mi.run.folder import DAMAGE, WORK
from tnst_mi.run.record import run_identity
from tnst_mi.run.resuming import recipe_of_run, require_run
from tnst_mi.run.states import read_state, state_file

#: Keys in which the two runs may differ: how much is done, how far smoke is moved, and what is named and written. The
#: input and the weights are compared by their contents.
FREE = (
    *("preset", "quality", "iterations", "views", "spp", "eta", "seed"),
    *("reach", "keep_silhouette", "strength", "blend"),
    *("colour_weight", "colour_eta", "colour_smoothness"),
    *(key for section in (Resources, Reading) for key in section.__annotations__),
)


def going_on(
    plan: Plan, record: dict[str, Any], run: Path | None, resumed: Mapping[str, Any] | None
) -> tuple[Plan, dict[str, Any]]:
    """The plan and the record of a run that begins where an earlier one has got to.

    Args:
        plan: of the run, beginning anew.
        record: the contents of its run.json.
        run: the folder of the earlier run; None to begin anew.
        resumed: the record of the run if it is resumed, which tells where it began.

    Raises:
        InputError: it cannot begin there, see `start_at`.
    """
    if resumed is None:
        if run is None:
            return plan, record
        start, origin = start_at(run, plan, record)
        return replace(plan, start=start), record | {"from": origin}
    begun = resumed.get("from")
    if begun is None or len(resumed["frames"]) == len(plan.frames):
        # The earlier run is no longer needed.
        return plan, record | ({} if begun is None else {"from": begun})
    start, origin = start_at(Path(begun["run"]), plan, record)
    if origin["states"] != begun["states"]:
        raise InputError(f"{begun['run']}: is not the run any more that this one went on from; use --overwrite")
    return replace(plan, start=start), record | {"from": begun}


def start_at(run: Path, plan: Plan, record: Mapping[str, Any]) -> tuple[Start, dict[str, Any]]:
    """The states of an earlier run, as the start of another one, and what the record of the later run says of them.

    Args:
        run: the folder of the earlier run, which has ended or was stopped.
        plan: of the later run.
        record: the contents of its run.json.

    Raises:
        InputError: the folder holds no run, or one that goes on; the runs differ in what must be the same; or the
            earlier run has gone further, or its states are not there.
    """
    require_run(run)
    require_unlocked(run)
    with gate(run, "the folder of a run"):
        earlier, recipe = _record_of(run), recipe_of_run(run)
        _require_same(run, recipe, earlier, plan.recipe, record)
        states = _left_behind(run, recipe, earlier, plan) or _stored(run, earlier, plan)
    start = _start_of(run, states, plan)
    done = [start.iterations[frame.name] for frame in plan.alive]
    digest = hashlib.sha256(json.dumps([state.digest for state in states]).encode("utf-8")).hexdigest()
    return start, {
        "run": str(run.absolute()),
        "quality": recipe.quality,
        "octave": start.octave,
        "iterations": min(done, default=0),
        "seconds": earlier.get("seconds"),
        "states": digest,
        "from": earlier.get("from"),
    }


@dataclass(frozen=True)
class _Found:
    """The state of a frame, which is read when it is needed; `digest` tells it from others."""

    name: str
    octave: int
    iterations: int
    scales: Mapping[str, float]
    fields: Callable[[], Mapping[str, np.ndarray]]
    digest: str


def _record_of(run: Path) -> dict[str, Any]:
    try:
        record = json.loads((run / "run.json").read_text("utf-8"))
        record["frames"] = [dict(frame) for frame in record["frames"]]
        record["inputs"], record["files"] = dict(record["inputs"]), dict(record["files"])
        record["weights"] = dict(record["weights"])
        return record
    except DAMAGE:
        raise InputError(f"{run / 'run.json'}: damaged, so no run can go on from there; leave out --from") from None


def _require_same(
    run: Path, recipe: Recipe, earlier: Mapping[str, Any], later_recipe: Recipe, later: Mapping[str, Any]
) -> None:
    """Check that two runs have the same way: input, goals, network, and all keys but those that are `FREE`."""
    for key in (*KINDS, "keyframes"):
        before, now = (_without_free(getattr(of_run, key), key) for of_run in (recipe, later_recipe))
        free = key in FREE or (key == "look" and later_recipe.gamma != "auto")
        # Whether the smoke keeps a colour shows in pictures alone; one that is optimised is a field of its own.
        free |= key == "colour" and "style" not in (before, now)
        if not free and before != now:
            raise InputError(
                one_line(
                    f"{run}: its run had {key} = {_spelled(before)}, this one has {_spelled(now)}; give the same to "
                    "go on from there, or begin anew without --from"
                )
            )
    if earlier["weights"].get("sha256") != later["weights"]["sha256"]:
        raise InputError(f"{run}: its run used other weights, expected the same ones to go on from there")
    if list(earlier["inputs"]) != list(later["inputs"]):
        raise InputError(f"{run}: its run had other frames than the input, expected the same ones to go on from there")
    for what in ("inputs", "files"):
        for name, digest in later[what].items():
            if earlier[what].get(name) != digest:
                raise InputError(one_line(f"{run}: its run had another {name}, expected the same to go on from there"))
    if earlier.get("shots") != later.get("shots"):
        raise InputError(
            f"{run}: its run saw the smoke from elsewhere than the camera does now; go on with the smoke and the "
            "camera where they were, or begin anew without --from"
        )
    if earlier.get("targets") != json.loads(json.dumps(later.get("targets"))):
        raise InputError(f"{run}: its run had other masks, or other smoke in them, expected the same to go on")


def _spelled(value: Any) -> str:
    """A value of a recipe, as people write it; files by their names."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_spelled, value))}]"
    return Path(value).name if isinstance(value, str) and os.sep in value else repr(value)


def _without_free(value: Any, key: str) -> Any:
    return {name: table for name, table in value.items() if name not in FREE} if key == "keyframes" else value


def _stored(run: Path, earlier: Mapping[str, Any], plan: Plan) -> list[_Found]:
    """The states that a run has written with its results."""
    records = {frame["name"]: frame.get("state") for frame in earlier["frames"]}
    return [_stored_state(run, frame.name, records.get(frame.name)) for frame in plan.alive]


def _stored_state(run: Path, name: str, recorded: Any) -> _Found:
    path = state_file(run, name)
    if not isinstance(recorded, dict) or not path.is_file():
        raise InputError(
            f"{run}: the state of {name} is gone, so no run can go on from it; make it again with --overwrite, or "
            "leave out --from"
        )

    def fields() -> Mapping[str, np.ndarray]:
        # Once more when they are read: meanwhile, the earlier run may have been replaced by another.
        _require_written(path, recorded)
        return read_state(path).fields

    _require_written(path, recorded)
    state = read_state(path, fields=False)
    return _Found(name, state.octave, state.iterations, state.scales, fields, recorded["sha256"])


def _require_written(path: Path, recorded: Mapping[str, Any]) -> None:
    if file_hash(path, "sha256") != recorded.get("sha256"):
        raise InputError(f"{path}: is not what the run wrote; make it again with --overwrite, or leave out --from")


def _left_behind(run: Path, recipe: Recipe, earlier: Mapping[str, Any], plan: Plan) -> list[_Found]:
    """The states of a run that was stopped, from its working state; none if it has ended."""
    if earlier.get("status") == "done" or not (run / WORK).is_dir():
        return []
    store = FolderStore(run / WORK, run_identity(recipe, earlier), read_only=True)
    alive, octaves = plan.alive, range(len(plan.octaves))

    def done(octave: int) -> list[int]:
        return [store.generation(f"fields.{octave}", frame.index) for frame in alive]

    # Frames of a window follow each other's steps, so they go on together.
    complete = [at for at in octaves if min(done(at)) >= 0 and (plan.window == 1 or len(set(done(at))) == 1)]
    if not alive or not complete:
        raise InputError(f"{run}: its run was stopped too early to go on from it; resume it with --resume")
    return [_left_state(run, store, complete[-1], frame) for frame in alive]


def _left_state(run: Path, store: FolderStore, octave: int, frame: FramePlan) -> _Found:
    group = f"fields.{octave}"
    try:
        digest = hashlib.sha256(b"".join(array.tobytes() for array in store.read(group, frame.index).values()))
        scales = store.numbers(f"scales.{octave}") or {}
    except DamagedItemError:
        raise InputError(f"{run}: its working state is damaged; mend it with --resume, or leave out --from") from None
    done = store.generation(group, frame.index)
    return _Found(frame.name, octave, done, scales, partial(store.read, group, frame.index), digest.hexdigest())


def _start_of(run: Path, states: Sequence[_Found], plan: Plan) -> Start:
    """The states of all frames together."""
    if not states:
        return Start(0, {}, {}, lambda name: {})
    if len({state.octave for state in states}) > 1:
        raise InputError(f"{run}: its frames are in different octaves; go on with it by --resume")
    by_name = {state.name: state for state in states}
    octave, most = states[0].octave, max(state.iterations for state in states)
    if octave >= len(plan.octaves) or most > plan.iterations(octave):
        raise InputError(
            f"{run}: its run has gone further (octave {octave + 1}, iteration {most}) than this one would; take a "
            "higher quality, or more iterations"
        )
    if most and not states[0].scales:
        raise InputError(f"{run}: the scales of its loss are gone; make it again with --overwrite, or leave out --from")

    def fields(name: str) -> Mapping[str, np.ndarray]:
        return _fitting(run, by_name[name], plan)

    return Start(octave, {state.name: state.iterations for state in states}, dict(states[0].scales), fields)


def _fitting(run: Path, state: _Found, plan: Plan) -> Mapping[str, np.ndarray]:
    """The fields of a state; of another grid, they would not be those of the run."""
    frame = next(frame for frame in plan.alive if frame.name == state.name)
    try:
        fields, shape = state.fields(), tuple(plan.octaves[state.octave].shape)
    except (*DAMAGE, DamagedItemError):
        raise InputError(f"{run}: the state of {state.name} is not what it was when this run began") from None
    for name, channels in frame.parameterisation.channels.items():
        expected = shape if channels == 1 else (*shape, channels)
        if name not in fields or fields[name].shape != expected:
            raise InputError(f"{run}: the state of {state.name} is of another grid; leave out --from")
    return fields

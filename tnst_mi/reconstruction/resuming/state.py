"""From where a reconstruction goes on after it was stopped: OUT/state.safetensors, which no pickle is needed for."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.machine.gate import opening
from tnst_mi.reconstruction.fitting.resumable import ResumableDescent
from tnst_mi.reconstruction.preparation import Preparation
from tnst_mi.reconstruction.resuming.records import require_sound_record
from tnst_mi.reconstruction.resuming.sources import digest, require_unchanged

#: What is written beside the tensors.
_TOLD = ("identity", "records", "level", "seconds", "sources", "errors")

#: Numbers that a record keeps of the errors on a grid, at most.
_KEPT_ERRORS = 50

#: What reading a file raises that is not what was written: RuntimeError is torch's.
_DAMAGED = (SafetensorError, OSError, ValueError, KeyError, TypeError, AttributeError, RuntimeError)

#: Adam's moments by torch's names of them.
_MOMENTS = ("exp_avg", "exp_avg_sq")


@dataclass
class ReconstructionState:
    """How far a reconstruction has got.

    Attributes:
        identity: of what is reconstructed.
        records: of the frames that are done, in their order.
        level: the grid of what is not, from 0: the next frame's density, or the velocity from the last one to it.
        seconds: that this has taken.
        sources: the digests of all files that have been read, by absolute path.
        errors: the root mean square difference of each step of it, grid by grid, in parts of the peak.
        tensors: of its descent, by name; empty before its first step.
    """

    identity: str
    records: list[dict[str, Any]] = field(default_factory=list)
    level: int = 0
    seconds: float = 0.0
    sources: dict[str, str] = field(default_factory=dict)
    errors: list[list[float]] = field(default_factory=list)
    tensors: Mapping[str, Tensor] = field(default_factory=dict)

    def note(self, files: Iterable[Path]) -> None:
        """Take note of the contents of files before they are read; those of some frames may be known already.

        Raises:
            InputError: one cannot be read.
        """
        for file in files:
            if (name := str(file.absolute())) not in self.sources:
                with opening(file, "an input"):
                    self.sources[name] = digest(file)

    def add_error(self, level: int, mean_square: float) -> None:
        """Take note of the error of one more step on a grid."""
        self.errors += [[] for _ in range(level + 1 - len(self.errors))]
        self.errors[level].append(mean_square**0.5)

    @property
    def convergence(self) -> list[dict[str, Any]]:
        """The steps of the frame on each grid, and how their errors fell: means over equally many steps each."""
        return [
            {
                "steps": len(errors),
                "rms": [float(part.mean()) for part in np.array_split(errors, _KEPT_ERRORS) if len(part)],
            }
            for errors in self.errors
        ]

    def after(self, record: dict[str, Any]) -> ReconstructionState:
        """How far it is when one more frame is done."""
        return ReconstructionState(self.identity, [*self.records, record], sources=self.sources)

    def write(self, path: Path, descent: ResumableDescent | None) -> None:
        """Write how far it is, with a descent that is not at its end."""
        told = {name: getattr(self, name) for name in _TOLD}
        tensors = {} if descent is None else _tensors(descent)
        with written_whole(path) as temporary:
            temporary.write_bytes(save(tensors, {"progress": json.dumps(told)}))

    @classmethod
    def read(cls, path: Path, prepared: Preparation) -> ReconstructionState:
        """Read how far an earlier reconstruction of the same got.

        Raises:
            InputError: there is none, it is damaged, it was of something else, or of files that were changed since.
        """
        if not path.is_file():
            raise InputError(f"{path.parent}: no reconstruction to resume there; leave out --resume to begin one")
        try:
            with safe_open(path, "pt") as file:
                told = json.loads(file.metadata()["progress"])
                tensors = {name: file.get_tensor(name) for name in file.keys()}
            progress = cls(**{name: told[name] for name in _TOLD}, tensors=tensors)
            ours = progress.identity == prepared.identity
            if ours:
                _require_sound(progress, prepared)
        except _DAMAGED:
            raise _damaged(path) from None
        if not ours:
            raise InputError(
                f"{path.parent}: was reconstructed with other settings, cameras or frames, other velocities or another "
                "format; give the same to go on, or begin anew with --overwrite"
            )
        for record in progress.records:
            if not (file := path.parent / record["density"]).is_file():
                raise InputError(
                    f"{file}: is gone, and was written before; put it back, or begin anew with --overwrite"
                )
        require_unchanged(progress.sources)
        return progress

    def restore(self, descent: ResumableDescent, path: Path) -> None:
        """Bring a descent to where the earlier one was.

        Raises:
            InputError: the file is of another grid, or holds what no descent comes to.
        """
        try:
            if not all(bool(tensor.isfinite().all()) for tensor in self.tensors.values()):
                raise ValueError("not finite")
            unknown = descent.unknown
            with torch.no_grad():
                unknown.copy_(_fitting(self.tensors["unknown"], unknown))
            moments = {name: _fitting(self.tensors[name], unknown) for name in _MOMENTS}
            descent.done = int(self.tensors["done"])
            if not 0 <= descent.done <= descent.steps:
                raise ValueError("another number of steps")
            descent.adam.state[unknown] = {"step": torch.tensor(float(descent.done)), **moments}
            descent.remember(self.tensors)
        except _DAMAGED:
            raise _damaged(path) from None


def _require_sound(progress: ReconstructionState, prepared: Preparation) -> None:
    """Check that what a file says is how far the reconstruction can have got.

    Raises:
        KeyError, TypeError, ValueError: it is not.
    """
    frames, levels, records = prepared.frames, prepared.levels, progress.records
    # JSON makes of True and of NaN what Python's numbers are.
    numbers = [progress.level, progress.seconds, *(error for errors in progress.errors for error in errors)]
    if not all(type(number) in (int, float) and math.isfinite(number) and number >= 0 for number in numbers):
        raise ValueError("not a number")
    if type(progress.level) is not int or progress.level >= len(levels) or len(progress.errors) > len(levels):
        raise ValueError("more grids than there are")
    if not isinstance(records, list) or len(records) > len(frames):
        raise ValueError("more frames than there are")
    judges = [view.name for view in prepared.views if view.held_out]
    for number, record in zip(frames, records, strict=False):
        require_sound_record(record, number, prepared.format, judges)
    if not all("velocity" in record for record in records[:-1]):
        raise ValueError("no velocity to the next frame")
    if not all(isinstance(text, str) for source in progress.sources.items() for text in source):
        raise ValueError("another type")


def _damaged(path: Path) -> InputError:
    return InputError(f"{path}: damaged, so nothing can go on from there; begin anew with --overwrite")


def _tensors(descent: ResumableDescent) -> dict[str, Tensor]:
    unknown, state = descent.unknown.detach(), descent.adam.state.get(descent.unknown) or {}
    tensors = {name: state.get(name, torch.zeros_like(unknown)) for name in _MOMENTS}
    tensors |= {"unknown": unknown, **descent.remembered}
    return {"done": torch.tensor(descent.done)} | {name: t.cpu().contiguous() for name, t in tensors.items()}


def _fitting(stored: Tensor, value: Tensor) -> Tensor:
    """A stored tensor that is as large as a parameter.

    Raises:
        ValueError: it is not.
    """
    if stored.shape != value.shape:
        raise ValueError("another size")
    return stored.to(value).clone()

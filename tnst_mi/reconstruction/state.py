"""From where a reconstruction goes on after it was stopped: OUT/state.safetensors, which no pickle is needed for."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.reconstruction.resumable import ResumableDescent

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
        tensors: of its descent, by name; empty before its first step.
    """

    identity: str
    records: list[dict[str, Any]] = field(default_factory=list)
    level: int = 0
    seconds: float = 0.0
    tensors: Mapping[str, Tensor] = field(default_factory=dict)

    def write(self, path: Path, descent: ResumableDescent | None) -> None:
        """Write how far it is, with a descent that is not at its end."""
        told = {"identity": self.identity, "records": self.records, "level": self.level, "seconds": self.seconds}
        tensors = {} if descent is None else _tensors(descent)
        with written_whole(path) as temporary:
            temporary.write_bytes(save(tensors, {"progress": json.dumps(told)}))

    @classmethod
    def read(cls, path: Path, identity: str) -> ReconstructionState:
        """Read how far an earlier reconstruction got.

        Raises:
            InputError: there is none, it is damaged, or it was of something else.
        """
        if not path.is_file():
            raise InputError(f"{path.parent}: no reconstruction to resume there; leave out --resume to begin one")
        try:
            with safe_open(path, "pt") as file:
                told = json.loads(file.metadata()["progress"])
                tensors = {name: file.get_tensor(name) for name in file.keys()}
            progress = cls(told["identity"], list(told["records"]), int(told["level"]), float(told["seconds"]), tensors)
            if not all(isinstance(record["density"], str) for record in progress.records):
                raise ValueError("a record")
        except (SafetensorError, OSError, ValueError, KeyError, TypeError):
            raise InputError(f"{path}: damaged, so nothing can go on from there; begin anew with --overwrite") from None
        if progress.identity != identity:
            raise InputError(
                f"{path.parent}: was reconstructed with other settings, cameras or frames; give the same to go on, or "
                "begin anew with --overwrite"
            )
        return progress

    def restore(self, descent: ResumableDescent, path: Path) -> None:
        """Bring a descent to where the earlier one was.

        Raises:
            InputError: the file is of another grid.
        """
        try:
            unknown = descent.unknown
            with torch.no_grad():
                unknown.copy_(_fitting(self.tensors["unknown"], unknown))
            moments = {name: _fitting(self.tensors[name], unknown) for name in _MOMENTS}
            descent.done = int(self.tensors["done"])
            descent.adam.state[unknown] = {"step": torch.tensor(float(descent.done)), **moments}
        except (KeyError, ValueError):
            raise InputError(f"{path}: damaged, so nothing can go on from there; begin anew with --overwrite") from None


def _tensors(descent: ResumableDescent) -> dict[str, Tensor]:
    unknown, state = descent.unknown.detach(), descent.adam.state.get(descent.unknown) or {}
    tensors = {name: state.get(name, torch.zeros_like(unknown)) for name in _MOMENTS}
    tensors["unknown"] = unknown
    return {"done": torch.tensor(descent.done)} | {name: t.cpu().contiguous() for name, t in tensors.items()}


def _fitting(stored: Tensor, value: Tensor) -> Tensor:
    """A stored tensor that is as large as a parameter.

    Raises:
        ValueError: it is not.
    """
    if stored.shape != value.shape:
        raise ValueError("another size")
    return stored.to(value).clone()

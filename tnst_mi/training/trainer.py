"""All updates of a training: what is shown when, the rate, and what becomes of smoke that is not shown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.realtime.potential_network import PotentialNetwork
from tnst_mi.realtime.prediction import predicted_fields
from tnst_mi.training.footage import Footage, Showing
from tnst_mi.training.learning import Neighbour, learn

#: Adam's rate at its highest, and the steps in which it rises to that.
RATE, RISING = 1.2e-3, 50

#: The length at which the gradient of all weights is cut off.
_LONGEST = 1.0

#: How much larger or smaller, thicker or thinner smoke is shown: up to these factors, in either direction.
_ZOOM, _THICKER = 1.4, 2.0

#: In how many updates λ is any, and not that of the recipe.
_OTHER_LAM = 0.2

#: How strongly potentials are turned towards those of neighbouring frames at the end of a training; in its course that
#: rises from 0 by its square. A network that is held steady before it has learned to draw learns to leave smoke alone.
STEADINESS = 0.5

#: How many frames of each input are judged at most.
_JUDGED = 3


@dataclass(frozen=True)
class Judgement:
    """How well smoke is stylized: mean losses in the fixed views, before and after."""

    before: float
    after: float


class Trainer:
    """The training of a network; the number of an update decides what it is shown.

    Args:
        network: to be trained.
        footage: what it learns from.
        held_out: what it is judged by.
        seed: of what is shown, and of the views.

    Attributes:
        updates: of the weights that are done.
    """

    def __init__(
        self, network: PotentialNetwork, footage: Sequence[Footage], held_out: Sequence[Footage], seed: int
    ) -> None:
        self._network, self._footage, self._seed = network, footage, seed
        self._optimiser = torch.optim.Adam(network.parameters(), lr=RATE, betas=(0.9, 0.99))
        self._judged = [
            (of_input, int(position))
            for of_input in held_out
            for position in np.unique(np.linspace(0, len(of_input) - 1, _JUDGED).round())
        ]
        self._before = [of_input.judged(position, of_input.zeros()) for of_input, position in self._judged]
        self.updates = self._steps = 0

    def update(self, done: float) -> float | None:
        """Learn from a frame; gives its loss, None if it has no smoke.

        `done` is the share of the training that lies behind it: the rate falls to 0 along a half cosine.
        """
        chance = np.random.default_rng((self._seed, self.updates))
        # Every input counts alike, however many frames it has.
        footage = self._footage[int(chance.integers(len(self._footage)))]
        position, showing = int(chance.integers(len(footage))), _showing(chance, footage)
        neighbour = _neighbour(footage, position, 1 if chance.integers(2) else -1, showing, STEADINESS * done**2)
        rate = RATE * min(1.0, (self.updates + 1) / RISING) * 0.5 * (1 + math.cos(math.pi * min(1.0, done)))
        for group in self._optimiser.param_groups:
            group["lr"] = rate
        self._optimiser.zero_grad()
        loss = learn(self._network, footage, footage.take(position, showing), (self._seed, self.updates), neighbour)
        if loss is not None:
            length = torch.nn.utils.clip_grad_norm_(self._network.parameters(), _LONGEST)
            if not torch.isfinite(length):
                # Weights would be lost for good.
                raise InputError(f"{footage.name}: the derivative of the loss is not finite in update {self.updates}")
            self._optimiser.step()
            self._steps += 1
        self.updates += 1
        return loss

    def judged(self) -> Judgement:
        """The network as it is, on what it does not learn from."""
        after = []
        for footage, position in self._judged:
            take = footage.take(position)
            fields = predicted_fields(self._network, take.plan, footage.problem.octave, take.density)
            after.append(footage.judged(position, fields))
        return Judgement(float(np.mean(self._before)), float(np.mean(after)))

    def write(self, path: Path, seconds: float) -> None:
        """Write what going on needs: weights, Adam's moments, the number of updates, and the seconds that they took."""
        tensors = {f"weight {name}": weight.detach() for name, weight in self._network.named_parameters()}
        for name, weight in self._network.named_parameters():
            tensors |= {f"{key} {name}": value for key, value in self._moments(weight).items()}
        tensors = {name: value.cpu().contiguous() for name, value in tensors.items()}
        tensors["progress"] = torch.tensor([self.updates, self._steps, seconds], dtype=torch.float64)
        with written_whole(path) as temporary:
            temporary.write_bytes(save(tensors))

    def read(self, path: Path) -> float:
        """Go on where an earlier training stopped; gives the seconds that it took.

        Raises:
            InputError: the file is not there or damaged, or of another network.
        """
        if not path.is_file():
            raise InputError(f"{path}: no such file, so no training can go on from there; leave out --resume")
        try:
            tensors = load_file(path)
            updates, steps, seconds = tensors.pop("progress").tolist()
            if not (0 <= steps <= updates < 2**53 and 0 <= seconds < math.inf):
                raise ValueError("no progress that there can be")
            expected = {f"{kind} {name}" for kind in _KINDS for name, _ in self._network.named_parameters()}
            if set(tensors) != expected:
                raise InputError(f"{path}: is of another network; leave out --resume")
            with torch.no_grad():
                for name, weight in self._network.named_parameters():
                    weight.copy_(_fitting(tensors[f"weight {name}"], weight))
                    moments = {kind: _fitting(tensors[f"{kind} {name}"], weight) for kind in _KINDS[1:]}
                    self._optimiser.state[weight] = {"step": torch.tensor(float(steps)), **moments}
        except InputError:
            raise
        except (SafetensorError, OSError, ValueError, KeyError, TypeError, RuntimeError):
            raise InputError(f"{path}: damaged, so no training can go on from there; leave out --resume") from None
        self.updates, self._steps = int(updates), int(steps)
        return float(seconds)

    def _moments(self, weight: Tensor) -> dict[str, Tensor]:
        state = self._optimiser.state.get(weight) or {}
        return {kind: state.get(kind, torch.zeros_like(weight)) for kind in _KINDS[1:]}


def _showing(chance: np.random.Generator, footage: Footage) -> Showing:
    """How the next frame is shown."""
    mirrored = bool(chance.integers(2)), bool(chance.integers(2))
    zoom, thicker = _ZOOM ** chance.uniform(-1, 1), _THICKER ** chance.uniform(-1, 1)
    if 1 in footage.problem.octave.shape:
        zoom = 1.0  # a plane would be as much thicker
    other = chance.uniform() < _OTHER_LAM
    lam = float(chance.uniform()) if other else None
    return Showing(mirrored, zoom, thicker, lam)


def _neighbour(footage: Footage, position: int, direction: int, showing: Showing, pull: float) -> Neighbour | None:
    """The frame before (direction −1) or after one (1), shown like that; None if there is none."""
    found = footage.carrying(position, direction, showing)
    return None if found is None else Neighbour(footage.take(found[0], showing), found[1], pull)


#: What is kept of every weight: itself, and Adam's moments by torch's names of them.
_KINDS = ("weight", "exp_avg", "exp_avg_sq")


def _fitting(stored: Tensor, weight: Tensor) -> Tensor:
    """A stored tensor that is as large as a weight, and finite.

    Raises:
        ValueError: it is not.
    """
    if stored.shape != weight.shape or not torch.isfinite(stored).all():
        raise ValueError("another size, or not finite")
    return stored.to(weight).clone()

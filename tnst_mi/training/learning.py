"""A step of learning: potentials by the network, smoke moved by them, seen at random, and the loss's derivative back.

Transport, renderer and their adjoints are the optimisation's own, in Dr.Jit; the network's are torch's. They meet at
the potentials: the derivative of the loss with respect to these is what torch propagates into the weights.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from tnst_mi.optimisation.parameterisation import LARGEST_DERIVATIVE, limited
from tnst_mi.realtime.potential_network import PotentialNetwork
from tnst_mi.realtime.prediction import Example, fields_of
from tnst_mi.training.footage import Footage, Take

#: How strongly potentials are drawn towards 0, relative to what the loss asks for: without that, those where no smoke
#: is grow without bound, and smoke is torn rather than moved.
PULL = 0.1


def learn(network: PotentialNetwork, footage: Footage, take: Take, seed: Sequence[int]) -> float | None:
    """Add a frame's derivative to those of the weights; gives its loss, None if it has no smoke.

    Derivatives of frames have one size whatever their smoke is, so that all of them count alike.

    Args:
        network: whose weights are learned.
        footage: that the frame is of.
        take: the frame.
        seed: of the views.
    """
    example = Example(take.density.numpy(), network)
    if example.box is None:
        return None
    # Half the digits cost a third of the time, and the noise of a step is far above that of rounding.
    with torch.autocast(example.density.device.type, torch.bfloat16):
        in_box = network(example.density)
    potentials = example.on_grid(in_box)
    h = footage.problem.octave.cell_size
    fields = fields_of(potentials.detach().cpu().numpy(), network.architecture, h)
    found = footage.problem.gradient(take.plan, fields, take.density, seed)
    (gradient,) = found.gradients
    parts = [limited(gradient[name], LARGEST_DERIVATIVE).numpy() for name in network.architecture.fields]
    derivative = np.concatenate([part if part.ndim == 4 else part[..., None] for part in parts], axis=-1)
    size = float(np.sqrt(np.square(derivative, dtype=np.float64).sum()))
    if size > 0:
        potentials.backward(torch.from_numpy(derivative / size).to(potentials) + PULL * _drawn(potentials))
    return float(found.loss) / take.plan.recipe.views


def _drawn(potentials: Tensor) -> Tensor:
    """The potentials, divided by the root of their number: of size 1 where all of them are."""
    return potentials.detach() / potentials.numel() ** 0.5

"""A step of learning: potentials by the network, smoke moved by them, seen at random, and the loss's derivative back.

Transport, renderer and their adjoints are the optimisation's own, in Dr.Jit; the network's are torch's. They meet at
the potentials: the derivative of the loss with respect to these is what torch propagates into the weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
import torch
from torch import Tensor

from tnst_mi.fields.advection import step
from tnst_mi.fields.grid import Octave
from tnst_mi.machine.backend import torch_device
from tnst_mi.optimisation.parameterisation import limited
from tnst_mi.realtime.potential_network import CHANNELS, PotentialNetwork
from tnst_mi.realtime.prediction import Example, channels_of, fields_of
from tnst_mi.training.footage import Footage, Take

#: How strongly potentials are drawn towards 0, relative to what the loss asks for: without that, those where no smoke
#: is grow without bound, and smoke is torn rather than moved.
PULL = 0.03


#: Cells of the coarsest convolutions along the shortest side of a box from which on half precision is safe.
_FEWEST_GROUPS = 3


@dataclass(frozen=True)
class Neighbour:
    """A frame next to one that is learned from.

    Attributes:
        take: the frame, shown as the other is.
        displacement: (D, H, W, 3), by which its smoke moves to the other frame, in full-resolution cells.
        pull: how strongly potentials are drawn, in the smoke, towards those that it has, carried along by the flow;
            relative to what the loss asks for.
    """

    take: Take
    displacement: mi.TensorXf
    pull: float


def learn(
    network: PotentialNetwork, footage: Footage, take: Take, seed: Sequence[int], neighbour: Neighbour | None = None
) -> float | None:
    """Add a frame's derivative to those of the weights; gives its loss, None if it has no smoke.

    Derivatives of frames have one size whatever their smoke is, so that all of them count alike.

    Args:
        network: whose weights are learned.
        footage: that the frame is of.
        take: the frame.
        seed: of the views.
        neighbour: the frame whose potentials those of this one should be like; they are not learned from.
    """
    octave, recipe = footage.problem.octave, take.plan.recipe
    example = Example(take.density.numpy(), recipe.extinction * octave.cell_size, recipe.lam, network)
    if example.box is None:
        return None
    with _half_precision(example):
        potentials = example.potentials(network)
    fields = fields_of(potentials.detach().cpu().numpy(), take.plan.parameterisation, octave.cell_size)
    found = footage.problem.gradient(take.plan, fields, take.density, seed)
    (gradient,) = found.gradients
    largest = take.plan.parameterisation.largest_derivative
    derivative = np.zeros(tuple(potentials.shape), np.float32)
    for name, part in channels_of(take.plan.parameterisation).items():
        field = gradient[name] if largest is None else limited(gradient[name], largest)
        derivative[..., part] = field.numpy()
    size = float(np.sqrt(np.square(derivative, dtype=np.float64).sum()))
    if size > 0:
        now = _known(potentials.detach(), take)
        whole = torch.from_numpy(derivative / size).to(now) + PULL * now / now.numel() ** 0.5
        if neighbour is not None:
            whole += neighbour.pull * _unsteady(network, now, take, neighbour, octave)
        potentials.backward(whole)
    return float(found.loss) / recipe.views


@torch.no_grad()
def _unsteady(network: PotentialNetwork, now: Tensor, take: Take, neighbour: Neighbour, octave: Octave) -> Tensor:
    """The derivative of how much potentials (D, H, W, C) differ in the smoke from a neighbour's, carried by the flow.

    The difference is 1 − cos of the angle between them: potentials turn towards each other, and are not weakened as
    their distance would weaken them. Its derivative by the direction of the potentials is at most of size 1.
    """
    recipe = take.plan.recipe
    example = Example(neighbour.take.density.numpy(), recipe.extinction * octave.cell_size, recipe.lam, network)
    if example.box is None:
        return torch.zeros_like(now)
    with _half_precision(example):
        before = example.potentials(network).cpu().numpy()
    channels = [mi.TensorXf(np.ascontiguousarray(channel)) for channel in np.moveaxis(before, -1, 0)]
    carried = [step(one, neighbour.displacement, "semi_lagrangian", octave.cell_size).numpy() for one in channels]
    smoke = torch.from_numpy(take.density.numpy()).clamp(max=1.0)[..., None].to(now)
    here = _unit(smoke * now)
    there = _unit(smoke * _known(torch.from_numpy(np.stack(carried, axis=-1)).to(now), take))
    return smoke * ((here * there).sum() * here - there)


def _half_precision(example: Example) -> torch.autocast:
    """Half the digits cost a third of the time, and the noise of a step is far above that of rounding.

    Not so for tiny boxes: the derivatives of convolutions of one or two cells, as oneDNN has them for CPUs, read memory
    that nothing has written, and are now and then NaN.
    """
    return torch.autocast(torch_device().type, torch.bfloat16, enabled=example.groups >= _FEWEST_GROUPS)


def _known(potentials: Tensor, take: Take) -> Tensor:
    """Potentials (D, H, W, C) without those that λ leaves out, of which nothing is known."""
    known = potentials.new_zeros(CHANNELS)
    for part in channels_of(take.plan.parameterisation).values():
        known[part] = 1
    return potentials * known


def _unit(field: Tensor) -> Tensor:
    """A field divided by its length; 0 if it is that."""
    return field / field.norm().clamp(min=torch.finfo(field.dtype).tiny)

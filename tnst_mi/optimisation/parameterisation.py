"""What is optimised: potentials whose velocity transports the smoke, or the density values themselves."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.advection import advect, step
from tnst_mi.fields.grid import Divisor, Octave, opaque, stored
from tnst_mi.fields.potentials import PotentialVelocity, velocity
from tnst_mi.fields.pyramid import gaussian, normalise
from tnst_mi.fields.resampling import resample_potential

#: Width of the blur of the gradient before it is normalised, in cells of the octave.
GRADIENT_SIGMA = 1.2


class Parameterisation:
    """A set of fields on the grid of an octave, and how a density follows from them.

    Attributes:
        fields: the fields by name, (D, H, W) or (D, H, W, 3) tensors; empty before the first octave.
        steps: what the next step takes off each field.
    """

    #: Channels of every field.
    channels: dict[str, int]

    def __init__(self) -> None:
        self.fields: dict[str, mi.TensorXf] = {}
        self.steps: dict[str, mi.TensorXf] = {}
        self.octave: Octave | None = None

    def enter(self, octave: Octave) -> None:
        """Carry the fields over to another octave; they start at zero."""
        for name, channels in self.channels.items():
            if self.octave is None:
                shape = octave.shape if channels == 1 else (*octave.shape, channels)
                values = np.zeros(shape, np.float32)
            else:
                values = resample_potential(
                    self.fields[name].numpy(), self.octave.cell_size, octave.shape, octave.cell_size
                )
            self.fields[name] = mi.TensorXf(values)
        self.octave = octave

    def arrays(self) -> dict[str, np.ndarray]:
        """The fields by name, to be kept."""
        return {name: tensor.numpy() for name, tensor in self.fields.items()}

    def restore(self, arrays: dict[str, np.ndarray], octave: Octave) -> None:
        """Take over fields that were kept, and the octave that they are of."""
        self.fields = {name: mi.TensorXf(arrays[name]) for name in self.channels}
        self.octave = octave

    def attach(self) -> None:
        """Make the fields fresh leaves of the AD graph."""
        for name, field in self.fields.items():
            field = dr.detach(field)
            dr.enable_grad(field)
            self.fields[name] = field

    def density(self, density: mi.TensorXf) -> mi.TensorXf:
        """The stylized density on the current octave, from the unstylized one; both (D, H, W)."""
        raise NotImplementedError

    def unit_step(self, rows: int) -> float:
        """Change of a field where η · mask · N(g) is 1; `rows` is H of the full grid."""
        raise NotImplementedError

    def find_steps(self, mask: mi.TensorXf, eta: float, rows: int, levels: int, sigma: float = GRADIENT_SIGMA) -> None:
        """Set each field's step to η · unit step · mask · N(g).

        N(g) is the gradient, blurred by `sigma` cells of the octave and with the bands of its Laplacian pyramid
        normalised, each field by itself. The gradients are used up: their memory is needed.
        """
        size = opaque(eta * self.unit_step(rows))
        for name, field in self.fields.items():
            direction = normalise(gaussian(_taken_gradient(field), sigma), levels)
            self.steps[name] = times(size * mask, direction)
            dr.eval(self.steps[name])

    def descend(self) -> None:
        """Take the steps: field ← field − step."""
        for name, change in self.steps.items():
            self.fields[name] = dr.detach(self.fields[name]) - change
        dr.eval(self.fields)


def _taken_gradient(field: mi.TensorXf) -> mi.TensorXf:
    """The gradient of a field, which loses it."""
    gradient = dr.grad(field)
    dr.clear_grad(field)
    return gradient


def times(weight: mi.TensorXf, field: mi.TensorXf) -> mi.TensorXf:
    """A field (D, H, W) or (D, H, W, 3) with every component multiplied by a scalar one (D, H, W)."""
    if len(field.shape) == 3:
        return weight * field
    cell, _ = Divisor(field.shape[3]).split(dr.arange(mi.UInt32, dr.width(field.array)))
    product = stored(dr.gather(mi.Float, weight.array, cell) * field.array)
    dr.eval(product)
    return mi.TensorXf(product, field.shape)


class Transport(Parameterisation):
    """Potentials Φ and Ψ; the density is the unstylized one, transported by their velocity (paper Eq. 3 and 4).

    Args:
        lam: share λ of the irrotational part; 1 leaves out Ψ and 0 leaves out Φ.
        substeps: sub-steps of the advection, or "auto".
        scalar: whether there is a Φ; where None, whether λ > 0.
        vector: whether there is a Ψ; where None, whether λ < 1.
    """

    def __init__(
        self, lam: float, substeps: int | str = 1, scalar: bool | None = None, vector: bool | None = None
    ) -> None:
        super().__init__()
        self.lam, self.substeps = lam, substeps
        scalar, vector = lam > 0 if scalar is None else scalar, lam < 1 if vector is None else vector
        self.channels = ({"phi": 1} if scalar else {}) | ({"psi": 3} if vector else {})

    def velocity(self) -> mi.TensorXf:
        """Velocity (D, H, W, 3) on the current octave, in full-resolution cells per frame."""
        return velocity(self.fields.get("phi"), self.fields.get("psi"), self.lam, self.octave.cell_size)

    def density(self, density: mi.TensorXf) -> mi.TensorXf:
        """MacCormack transport of the density by the potentials' velocity."""
        h = self.octave.cell_size
        if self.substeps == 1:
            v = PotentialVelocity(self.fields.get("phi"), self.fields.get("psi"), self.lam, h)
            return step(density, v, "maccormack", h, "zero")
        return advect(density, self.velocity(), "maccormack", h, "zero", self.substeps)

    def unit_step(self, rows: int) -> float:
        """(H/2) h: η counts in the octave's own cells, so that a recipe's η means the same at every size."""
        return rows / 2 * self.octave.cell_size


class DensityOffset(Parameterisation):
    """A change of every cell's density, the paper's value-based comparison: d* = max(0, d + offset)."""

    channels = {"offset": 1}  # noqa: RUF012

    def enter(self, octave: Octave) -> None:
        """Carry the offset over to another octave; in a plane, it thins out as the density does."""
        before = self.octave
        super().enter(octave)
        if before is not None:
            flat = sum(n == m == 1 for n, m in zip(before.shape, octave.shape, strict=True))
            self.fields["offset"] *= opaque((before.cell_size / octave.cell_size) ** flat)

    def density(self, density: mi.TensorXf) -> mi.TensorXf:
        """The density plus the offset, clamped to ≥ 0."""
        return mi.TensorXf(dr.maximum((density + self.fields["offset"]).array, mi.Float(0)), tuple(density.shape))

    def unit_step(self, rows: int) -> float:
        """1: η is a change of the density itself."""
        return 1.0

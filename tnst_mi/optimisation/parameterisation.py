"""What is optimised: potentials whose velocity transports the smoke, or the density values themselves."""

from __future__ import annotations

from abc import ABC, abstractmethod

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.advection import advect, flow, step
from tnst_mi.fields.flow_map import MOST_STAGES
from tnst_mi.fields.grid import Cells, Octave
from tnst_mi.fields.kernels import Divisor, opaque, stored
from tnst_mi.fields.potentials import PotentialVelocity, velocity
from tnst_mi.fields.pyramid import gaussian, normalise
from tnst_mi.fields.resampling import resample_potential

#: Where the flow stretches, a path can multiply its derivative by any factor, and a few such cells would then decide
#: the scale by which all are normalised, and move ever faster. So a derivative along the flow counts as at most this
#: many times the mean magnitude (docs/transport.md).
LARGEST_DERIVATIVE = 4.0

#: Width of the blur of the gradient before it is normalised, in cells of the octave.
GRADIENT_SIGMA = 1.2

#: By how much velocities of scaled potentials may differ from scaled velocities, relative to the fastest one: they are
#: differences of rounded values.
_ROUNDING = 1e-5

#: How often potentials are lowered around cells that are faster than they may be, before all are.
_LOWERED = 3


class Fields(dict[str, "mi.TensorXf"]):
    """What is optimised, by name: (D, H, W) or (D, H, W, 3) tensors on one grid. So are gradients and steps."""

    def __sub__(self, step: Fields) -> Fields:
        """The fields after a step."""
        after = Fields({name: field - step[name] for name, field in self.items()})
        dr.eval(list(after.values()))
        return after

    def __add__(self, other: Fields) -> Fields:
        """The sum of two steps; what one of them does not change follows the other."""
        return Fields({name: field + other[name] if name in other else field for name, field in self.items()})

    def times(self, factor: float) -> Fields:
        """The fields times a number."""
        return Fields({name: field * opaque(factor) for name, field in self.items()})

    def attached(self) -> Fields:
        """The same values as fresh leaves of the AD graph."""
        leaves = Fields({name: dr.detach(field) for name, field in self.items()})
        dr.enable_grad(list(leaves.values()))
        return leaves


class Parameterisation(ABC):
    """How a density depends on fields.

    Attributes:
        channels: number of channels of every field, by name.
        largest_derivative: what a step takes of a derivative at most, in means of all that are not 0; None takes all.
    """

    channels: dict[str, int]
    largest_derivative: float | None = None

    @property
    def of_density(self) -> Parameterisation:
        """What the density depends on: this, unless there is something else beside it."""
        return self

    def zeros(self, octave: Octave) -> Fields:
        """The fields before the first iteration."""
        shapes = {name: octave.shape if c == 1 else (*octave.shape, c) for name, c in self.channels.items()}
        return Fields({name: mi.TensorXf(np.zeros(shape, np.float32)) for name, shape in shapes.items()})

    def carried(self, fields: Fields, source: Octave, target: Octave) -> Fields:
        """Fields of one octave, resampled to the grid of another."""
        return Fields(
            {
                name: resample_potential(field, source.cell_size, target.shape, target.cell_size)
                for name, field in fields.items()
            }
        )

    def rescaled(self, fields: Fields, factor: float) -> Fields:
        """The fields that change densities times `factor` alike."""
        return fields

    def within(self, fields: Fields, reach: float | mi.TensorXf, h: float) -> Fields:
        """The fields, scaled down if they move smoke farther than `reach`, in full-resolution cells, anywhere.

        `reach` is the same for all cells, or a field (D, H, W) of values above 0.
        """
        return fields

    @abstractmethod
    def density(self, fields: Fields, density: mi.TensorXf, h: float) -> mi.TensorXf:
        """The stylized density from the unstylized one, both (D, H, W) with cells of size h."""

    @abstractmethod
    def unit_step(self, rows: int, h: float) -> float:
        """Change of a field where η · mask · N(g) is 1; `rows` is H of the full grid."""

    def step(
        self,
        gradient: Fields,
        mask: mi.TensorXf,
        eta: float,
        rows: int,
        h: float,
        levels: int,
        sigma: float = GRADIENT_SIGMA,
    ) -> Fields:
        """η · mask · N(g) in the unit of the fields, on cells of size h; see `normalised_step`."""
        return normalised_step(gradient, mask, eta * self.unit_step(rows, h), levels, sigma, self.largest_derivative)

    def density_with_pullback(self, fields: Fields, density: mi.TensorXf, h: float) -> tuple[mi.TensorXf, Pullback]:
        """The stylized density, detached, and the pull-back of derivatives with respect to it onto the fields."""
        leaves = fields.attached()
        stylized = self.density(leaves, density, h)
        return dr.detach(stylized), Pullback(leaves, stylized)


class Pullback:
    """The adjoint of the map from fields to a density, at one point: ∂L/∂d* → ∂L/∂fields.

    It can be called until the `last` call, which releases its memory.
    """

    def __init__(self, leaves: Fields, stylized: mi.TensorXf) -> None:
        self._leaves, self._stylized = leaves, stylized

    def __call__(self, gradient: mi.TensorXf, last: bool = True) -> Fields:
        """The derivative with respect to the fields."""
        dr.set_grad(self._stylized, gradient)
        dr.enqueue(dr.ADMode.Backward, self._stylized)
        dr.traverse(dr.ADMode.Backward, dr.ADFlag.Default if last else dr.ADFlag.ClearVertices)
        found = Fields({name: dr.grad(leaf) for name, leaf in self._leaves.items()})
        if not last:
            dr.clear_grad(list(self._leaves.values()))
            return found
        # Release the graph: its memory is needed.
        del self._leaves, self._stylized
        return found


def limited(field: mi.TensorXf, largest: float) -> mi.TensorXf:
    """A field with no value beyond `largest` times the mean magnitude of those that are not 0."""
    magnitude = dr.abs(field.array)
    count = dr.sum(dr.select(magnitude > 0, mi.Float(1), 0))
    bound = opaque(largest) * dr.sum(magnitude) / dr.maximum(count, 1)
    return mi.TensorXf(dr.clip(field.array, -bound, bound), field.shape)


def normalised_step(
    gradient: Fields,
    mask: mi.TensorXf,
    size: float,
    levels: int,
    sigma: float = GRADIENT_SIGMA,
    largest: float | None = None,
) -> Fields:
    """size · mask · N(g): the step to subtract from each field.

    N(g) is the gradient, blurred by `sigma` cells of the octave and normalised per band of its Laplacian pyramid, each
    field separately. The gradient is consumed, field by field, to free its memory.

    Args:
        gradient: of each field; empty afterwards.
        mask: (D, H, W) in [0, 1].
        size: η times the parameterisation's unit step.
        levels: bands of the pyramid.
        sigma: width of the blur in cells.
        largest: magnitude beyond which a value of the gradient counts as that, in means of all that are not 0; None
            takes it as it is.
    """
    steps, scaled = Fields(), opaque(size) * mask
    for name in list(gradient):
        raw = gradient.pop(name) if largest is None else limited(gradient.pop(name), largest)
        steps[name] = times(scaled, normalise(gaussian(raw, sigma), levels))
        del raw
        dr.eval(steps[name])
    return steps


def times(weight: mi.TensorXf, field: mi.TensorXf) -> mi.TensorXf:
    """A field (D, H, W) or (D, H, W, 3) with every component multiplied by a scalar field (D, H, W)."""
    if len(field.shape) == 3:
        return weight * field
    cell, _ = Divisor(field.shape[3]).split_first(dr.width(field.array))
    product = stored(dr.gather(mi.Float, weight.array, cell) * field.array)
    dr.eval(product)
    return mi.TensorXf(product, field.shape)


class Transport(Parameterisation):
    """Potentials Φ and Ψ; the density is the unstylized one, transported by their velocity (paper Eq. 3 and 4).

    Args:
        lam: share λ of the irrotational part; 1 leaves out Ψ and 0 leaves out Φ.
        substeps: sub-steps of the advection, or "auto".
        scalar: whether there is a Φ; if None, whether λ > 0.
        vector: whether there is a Ψ; if None, whether λ < 1.
        trace, stages, conservative: how the advection follows the velocity, as in `advect`.
    """

    def __init__(
        self,
        lam: float,
        substeps: int | str = 1,
        scalar: bool | None = None,
        vector: bool | None = None,
        trace: str = "step",
        stages: int | str = "auto",
        conservative: bool = False,
    ) -> None:
        self.lam, self.substeps = lam, substeps
        self.trace, self.stages, self.conservative = trace, stages, conservative
        self.largest_derivative = LARGEST_DERIVATIVE if trace == "flow" else None
        scalar, vector = lam > 0 if scalar is None else scalar, lam < 1 if vector is None else vector
        self.channels = ({"phi": 1} if scalar else {}) | ({"psi": 3} if vector else {})

    def velocity(self, fields: Fields, h: float) -> mi.TensorXf:
        """Velocity (D, H, W, 3) of the potentials, in full-resolution cells per frame."""
        return velocity(fields.get("phi"), fields.get("psi"), self.lam, h)

    def within(self, fields: Fields, reach: float | mi.TensorXf, h: float) -> Fields:
        """The potentials times the largest factor, 1 at most, with which no cell is faster than `reach`.

        No way of transport moves smoke farther than the fastest cell in one frame: interpolated velocities are means
        of those of cells, and every step and stage follows means of these. Scaled potentials have a velocity without
        divergence where they had one. If cells differ in how far they may be moved, those of a few must not decide for
        all: potentials are first lowered around those that are too fast.
        """
        if isinstance(reach, int | float):
            allowed = opaque(reach)
        else:
            allowed = reach.array
            for _ in range(_LOWERED):
                fields = self._lowered(fields, reach, h)
        excess = dr.max(self._speed(fields, h) / allowed)
        factor = dr.select(excess > 1, opaque(1 - _ROUNDING) / excess, mi.Float(1))
        return Fields({name: field * factor for name, field in fields.items()})

    def _lowered(self, fields: Fields, reach: mi.TensorXf, h: float) -> Fields:
        """The potentials times a soft-edged factor that is below 1 around cells that are faster than their `reach`."""
        excess = self._speed(fields, h) / reach.array
        factor = gaussian(mi.TensorXf(stored(dr.minimum(1, dr.rcp(excess))), reach.shape), GRADIENT_SIGMA, "nearest")
        fast = dr.max(excess) > 1
        factor = mi.TensorXf(dr.select(fast, factor.array, mi.Float(1)), reach.shape)
        return Fields({name: times(factor, field) for name, field in fields.items()})

    def _speed(self, fields: Fields, h: float) -> mi.Float:
        """|v| of every cell."""
        v = self._velocity(fields, h)
        return dr.norm(v.at(Cells.of(v.shape)))

    def _velocity(self, fields: Fields, h: float) -> PotentialVelocity:
        return PotentialVelocity(fields.get("phi"), fields.get("psi"), self.lam, h)

    def density(self, fields: Fields, density: mi.TensorXf, h: float) -> mi.TensorXf:
        """MacCormack transport of the density by the potentials' velocity."""
        return self._moved(fields, density, h, "zero", self.conservative)

    def colour(self, fields: Fields, colour: mi.TensorXf, h: float) -> mi.TensorXf:
        """The same of colours, (D, H, W, 3) or a component: pressed together they are not brighter; what comes in has
        that of the border.
        """
        return self._moved(fields, colour, h, "edge", conservative=False)

    def _moved(self, fields: Fields, field: mi.TensorXf, h: float, outside: str, conservative: bool) -> mi.TensorXf:
        v = self._velocity(fields, h)
        if self.trace == "flow":
            stages = self.stages if isinstance(self.stages, int) else None
            return flow(field, v, "maccormack", h, outside, None, stages, conservative)
        if self.substeps == 1:
            return step(field, v, "maccormack", h, outside)
        return advect(field, self.velocity(fields, h), "maccormack", h, outside, self.substeps)

    def around_solids(self, field: mi.TensorXf, v: mi.TensorXf, h: float, of_colour: bool = False) -> mi.TensorXf:
        """The same transport of a density, or colour, by a velocity (D, H, W, 3) that is 0 inside solids.

        Towards the centres of a solid's outermost cells, the interpolated velocity falls to 0 within one cell. The
        stages of "auto" may leap over that; the most stages do not, for any velocity of up to 44 cells per frame.
        """
        stages = MOST_STAGES if self.trace == "flow" and self.stages == "auto" else self.stages
        outside, conservative = ("edge", False) if of_colour else ("zero", self.conservative)
        return advect(field, v, "maccormack", h, outside, self.substeps, self.trace, stages, conservative)

    def unit_step(self, rows: int, h: float) -> float:
        """(H/2) h: η is in units of the octave's own cells, so that a recipe's η means the same at every size."""
        return rows / 2 * h


class DensityOffset(Parameterisation):
    """A change of every cell's density, the paper's value-based comparison: d* = max(0, d + offset)."""

    channels = {"offset": 1}  # noqa: RUF012

    def carried(self, fields: Fields, source: Octave, target: Octave) -> Fields:
        """The offset on another octave's grid; along axes of a single cell, it is scaled as the density is."""
        flat = sum(n == m == 1 for n, m in zip(source.shape, target.shape, strict=True))
        thinner = opaque((source.cell_size / target.cell_size) ** flat)
        return Fields({name: field * thinner for name, field in super().carried(fields, source, target).items()})

    def rescaled(self, fields: Fields, factor: float) -> Fields:
        """The offset in units of the densities."""
        return fields.times(factor)

    def density(self, fields: Fields, density: mi.TensorXf, h: float) -> mi.TensorXf:
        """The density plus the offset, clamped to ≥ 0."""
        return mi.TensorXf(dr.maximum((density + fields["offset"]).array, mi.Float(0)), tuple(density.shape))

    def unit_step(self, rows: int, h: float) -> float:
        """1: η is a change of the density itself."""
        return 1.0

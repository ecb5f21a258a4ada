"""How a frame's smoke moves in the end: its density, and in the same way every other grid that goes with it."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.kernels import opaque
from tnst_mi.frame import Frame
from tnst_mi.geometry.other_grids import OtherGrid
from tnst_mi.optimisation.parameterisation import Fields, Transport

#: Values are transported as they are scaled for the density, unless the largest is beyond these powers of two.
_SMALLEST, _LARGEST = -100, 100


class Movement:
    """The transport of a frame's grids by its potentials, at full resolution.

    Inside a solid everything stays as it is. Values are brought to about 1 by a power of two, which changes none of
    their bits, so that no product leaves the range of float32.

    Args:
        parameterisation: how the smoke follows the potentials.
        potentials: of the frame, on its full grid.
        h: size of a cell of this grid.
        frame: the frame.
        exponent: the power of two that brings its density to about 1.
        blend: share of what has moved in the result.
        shows_colours: whether grids called a colour are what the smoke is shown in, rather than grids like others.

    Attributes:
        shows_colours: likewise.
        velocity: v*, (D, H, W, 3).
    """

    def __init__(
        self,
        parameterisation: Transport,
        potentials: Fields,
        h: float,
        frame: Frame,
        exponent: int,
        blend: float,
        shows_colours: bool = False,
    ) -> None:
        self._parameterisation, self._potentials, self._h = parameterisation, potentials, h
        self.shows_colours = shows_colours
        self._name, self._shape, self._exponent, self._blend = frame.name, frame.density.shape, exponent, blend
        self._solid = None if frame.obstacle is None else mi.Bool(frame.obstacle.ravel())
        with dr.suspend_grad():
            self.velocity = parameterisation.velocity(potentials, h)
            if self._solid is not None:
                # Potentials do not change inside a solid, but those around it produce velocities one cell into it.
                components = dr.select(self._solid, mi.Vector3f(0), dr.unravel(mi.Vector3f, self.velocity.array))
                self.velocity = mi.TensorXf(dr.ravel(components), tuple(self.velocity.shape))

    def density(self, density: np.ndarray) -> np.ndarray:
        """A density (D, H, W) float32, moved."""
        return self._moved(density, self._exponent, floor=True)

    def carried(self, grid: OtherGrid, of_colour: bool = False) -> np.ndarray:
        """Another grid, moved as the density is; vectors by components, which keep their directions.

        What has a value other than 0 beyond the grid is moved relative to this. Results are computed in single
        precision; whole numbers are rounded, and stay exact where nothing has moved.

        Args:
            grid: the grid.
            of_colour: whether it has colours, which move as `Transport.colour` says, whatever is beyond the grid.

        Returns:
            The values, in the shape and type of the grid's.

        Raises:
            InputError: they are not finite.
        """
        if grid.stays:
            return grid.values
        values = grid.values if grid.values.ndim == 4 else grid.values[..., None]
        outside = np.broadcast_to(grid.outside, values.shape[3:]).astype(np.float32)
        carried = np.empty_like(values)
        for channel, beyond in enumerate(outside):
            own = values[..., channel]
            before = own.astype(np.float32)
            if of_colour:
                after = self._moved(before, self._power_of(before), floor=bool(before.min() >= 0), of_colour=True)
            else:
                after = self._relative_to(beyond, before)
            if not np.isfinite(after).all():
                raise InputError(f"{self._name}: a carried grid is not finite after its transport; try a smaller eta")
            carried[..., channel] = _typed(after, before, own)
        return carried.reshape(grid.values.shape)

    def _relative_to(self, beyond: np.float32, before: np.ndarray) -> np.ndarray:
        """A scalar grid, moved, with a value beyond it."""
        floor = bool(before.min() >= 0)
        if beyond == 0:
            return self._moved(before, self._power_of(before), floor)
        relative = before - beyond
        # Where nothing has changed, the value is the same to the bit.
        after = before + (self._moved(relative, self._power_of(relative), floor=False) - relative)
        return np.maximum(after, 0) if floor else after

    def _moved(self, values: np.ndarray, exponent: int, floor: bool, of_colour: bool = False) -> np.ndarray:
        before, transport = mi.TensorXf(np.ldexp(values, exponent)), self._parameterisation
        with dr.suspend_grad():
            if self._solid is None:
                move = transport.colour if of_colour else transport.density
                moved = move(self._potentials, before, self._h).array
            else:
                moved = transport.around_solids(before, self.velocity, self._h, of_colour).array
            blend, moved = opaque(self._blend), dr.maximum(moved, 0) if floor else moved
            # Where nothing has changed, as outside a mask, it stays so to the bit.
            blended = dr.select(moved == before.array, moved, (1 - blend) * before.array + blend * moved)
            if self._solid is not None:
                blended = dr.select(self._solid, before.array, blended)
        return np.ldexp(mi.TensorXf(blended, self._shape).numpy(), -exponent)

    def _power_of(self, values: np.ndarray) -> int:
        """The power of two for some values: that of the density where they stay in range with it, else their own."""
        own = math.frexp(float(np.abs(values).max()))[1]
        within = own == 0 or _SMALLEST <= own + self._exponent <= _LARGEST
        return self._exponent if within else -own


def _typed(after: np.ndarray, before: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Values in the type of a grid's own, which stay where they have not changed in single precision."""
    if own.dtype.kind == "b":
        return after > 0.5
    if own.dtype.kind == "f":
        return np.where(after == before, own, after.astype(own.dtype))
    most = np.iinfo(own.dtype)
    whole = np.clip(np.rint(after.astype(np.float64)), most.min, most.max)
    return np.where(after == before, own, whole.astype(own.dtype))

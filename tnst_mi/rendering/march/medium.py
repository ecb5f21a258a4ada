"""Media that can be marched: of a `heterogeneous` one the extinction tensor, and the map from world to cells.

Resolving them once lets the integrator gather from the tensor instead of calling the medium's virtual functions for
every sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.grid import Shape
from tnst_mi.rendering.march.occupancy import Occupancy


def _children(node: mi.Object) -> dict[str, mi.Object]:
    """The child objects of a Mitsuba object, by name."""
    objects: dict[str, mi.Object] = {}

    # Defined here, since its base class belongs to the active variant.
    class Children(mi.TraversalCallback):
        def put(self, name: str, value: object, *_: object) -> None:
            if isinstance(value, mi.Object):
                objects[name] = value

    node.traverse(Children())
    return objects


@dataclass(frozen=True)
class GridTransform:
    """The affine map from world space to the unit cube of a gridvolume: `local = 1/2 + matrix (p − centre)`.

    `matrix` is (3, 3) and `centre` (3,), both float64, axes (x, y, z); `centre` is the centre of the grid.
    """

    matrix: np.ndarray
    centre: np.ndarray

    def voxel_edges(self, shape: Shape) -> np.ndarray:
        """World lengths of a cell's edges along the grid's own x, y and z axes."""
        return np.linalg.norm(np.linalg.inv(self.matrix), axis=0) / np.array(shape[::-1])

    def diagonal(self) -> float:
        """Length in world space of the longest diagonal of the grid."""
        edges = np.linalg.inv(self.matrix)
        signs = np.array([[1, a, b] for a in (-1, 1) for b in (-1, 1)])
        return float(np.linalg.norm(signs @ edges.T, axis=1).max())


def probe_transform(volume: mi.Volume) -> GridTransform:
    """Recover the `to_world` of a gridvolume, which Mitsuba does not expose.

    The grid's centre is the centre of its bounding box. The rest is probed: temporarily, the volume holds 2×2×2 cells
    whose values rise along one axis, and the gradient of its interpolated value at the centre gives that axis' row of
    the matrix. After three probes, the volume's own data are restored.

    Raises:
        RuntimeError: the volume does not interpolate linearly, or repeats itself beyond its box.
    """
    box = volume.bbox()
    centre = np.array((box.min + box.max) * 0.5, dtype=np.float64).ravel().tolist()
    parameters = mi.traverse(volume)
    rows = []
    # Integrators suspend derivatives while they render: the volume's own data, if attached, would be restored detached.
    with dr.resume_grad():
        # A copy: the dictionary returns a reference, which the probes would overwrite.
        data = mi.TensorXf(parameters["data"])
        try:
            for axis in range(3):
                ramp = np.zeros((2, 2, 2, data.shape[3]), np.float32)
                np.moveaxis(ramp, 2 - axis, 0)[1] = 1.0
                parameters["data"] = mi.TensorXf(ramp)
                parameters.update()
                interaction = dr.zeros(mi.Interaction3f)
                interaction.p = mi.Point3f(*centre)
                dr.enable_grad(interaction.p)
                dr.backward(volume.eval(interaction)[0], flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)
                rows.append(np.array(dr.grad(interaction.p), dtype=np.float64).ravel())
            # Two cells span the unit interval: their values differ by 1 over a distance of 1/2.
            matrix = np.stack(rows) / 2
            if abs(np.linalg.det(matrix)) == 0:
                raise RuntimeError(
                    "emission_absorption: sigma_t does not vary with the position; "
                    'use a gridvolume with filter_type "trilinear" and an invertible to_world'
                )
            # The last ramp is 0 at low z: by the face there, only a grid that repeats itself is not 0.
            interaction.p = mi.Point3f(*(np.array(centre) - 0.48 * np.linalg.inv(matrix)[:, 2]).tolist())
            if dr.detach(volume.eval(interaction)[0]).numpy()[0] > 0.1:
                raise RuntimeError('emission_absorption: sigma_t repeats itself; use a gridvolume of wrap_mode "clamp"')
        finally:
            parameters["data"] = data
            parameters.update()
    return GridTransform(matrix, np.array(centre))


class GridMedium:
    """A heterogeneous medium, resolved to its extinction tensor; it fills the box of its grid.

    Attributes:
        medium: the Mitsuba medium.
        parameters: the medium's parameters, from `mi.traverse`.
        extinction: σ_t tensor (D, H, W, C) per world unit before `scale`, attached to the AD graph if the medium's is.
        scale: the medium's `scale`.
        transform: world space to the grid's unit cube.
        colour: of what the medium emits, a tensor (D, H, W, 3), possibly attached; None for white. The integrator or
            the renderer that marches through it sets it.

    Raises:
        RuntimeError: the medium is not `heterogeneous`, or its `sigma_t` is not a `gridvolume` that interpolates
            linearly.
    """

    def __init__(self, medium: mi.Medium) -> None:
        self.medium = medium
        self.parameters = mi.traverse(medium)
        self._occupancy: Occupancy | None = None
        self.colour: mi.TensorXf | None = None
        volume = _children(medium).get("sigma_t")
        if volume is None or "data" not in mi.traverse(volume):
            raise RuntimeError(
                "emission_absorption: a medium must be `homogeneous`, or `heterogeneous` with a `gridvolume` as sigma_t"
            )
        self.transform = probe_transform(volume)
        self.refresh()

    def refresh(self) -> None:
        """Update to the current extinction and scale, which `parameters.update()` may have replaced."""
        self.extinction = self.parameters["sigma_t.data"]
        self.scale = float(self.parameters["scale"])

    @property
    def channels(self) -> int:
        """Number of extinction values per cell: 1 (grey) or 3 (colour)."""
        return self.extinction.shape[3]

    @property
    def grid_shape(self) -> Shape:
        """(D, H, W) of the grid."""
        return tuple(self.extinction.shape[:3])

    @property
    def occupancy(self) -> Occupancy:
        """Where the extinction is not 0; computed once per array of values."""
        values = dr.detach(self.extinction).array
        # The occupancy keeps its values alive, so that no other array can reuse their index.
        if self._occupancy is None or self._occupancy.values.index != values.index:
            self._occupancy = Occupancy(values, self.grid_shape, self.channels)
        return self._occupancy


class HomogeneousMedium:
    """A medium of the same extinction everywhere."""

    def __init__(self, medium: mi.Medium) -> None:
        self.medium = medium

    def refresh(self) -> None:
        """Nothing: the extinction is not kept."""

    def extinction(self) -> mi.Spectrum:
        """The current extinction per world unit, attached to the AD graph if the medium's parameters are."""
        return self.medium.get_scattering_coefficients(dr.zeros(mi.MediumInteraction3f))[2]

"""Where transport folds space, and so tears smoke into pieces with hard edges, or into detail finer than cells."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.flow_map import FlowMap
from tnst_mi.fields.grid import Cells
from tnst_mi.fields.kernels import opaque
from tnst_mi.fields.potentials import AxisDifference


def folded_share(density: np.ndarray, velocity: np.ndarray, trace: str = "step", stages: int | None = None) -> float:
    """The share of the smoke that has come to places where transport by a velocity has folded space.

    Transport looks the density up where the smoke of each cell came from: at x − v(x) for a straight step, else where
    the path along the flow began. Where the determinant of the Jacobian of this map, by differences between cells, is 0
    or less, smoke comes out mirrored, or one piece of it in several copies, with hard edges between pieces that were
    not next to each other. It takes displacements that change by a cell and more from cell to cell: long ones of small
    motifs. The flow itself cannot fold; there, it is the share where it draws smoke out into detail that cells are too
    coarse for.

    Args:
        density: d* (D, H, W), the transported smoke, 0 or more.
        velocity: v (D, H, W, 3), components (x, y, z), in cells.
        trace: "step" or "flow".
        stages: along the flow, of every path; None takes as many as each needs.

    Returns:
        From 0 to 1; 0 without smoke.

    Example:
        >>> import numpy as np
        >>> v = np.zeros((4, 4, 4, 3), np.float32)
        >>> folded_share(np.ones((4, 4, 4), np.float32), v)
        0.0
        >>> v[..., 0] = 2 * np.arange(4)  # 2 cells more from cell to cell along x: x − v(x) runs backwards
        >>> folded_share(np.ones((4, 4, 4), np.float32), v)
        1.0
        >>> folded_share(np.ones((4, 4, 4), np.float32), v, "flow")
        0.0
    """
    depth, height, width = density.shape
    cells = Cells.of((depth, height, width))
    v, smoke = mi.Float(np.ascontiguousarray(velocity, np.float32).ravel()), mi.Float(density.ravel())
    if trace == "flow":
        flow = FlowMap(dr.unravel(mi.Vector3f, v), 1.0, cells.shape, with_volume=False)
        v = dr.ravel(-mi.Vector3f(*flow.trace(cells, -1, stages)[1]))
        dr.eval(v)
    axes = [AxisDifference(cells, axis, opaque(1.0)) for axis in range(3)]
    jacobian = mi.Matrix3f(*([float(i == j) - axes[j].apply(v, 3, i) for j in range(3)] for i in range(3)))
    folded, total = dr.sum(dr.select(dr.det(jacobian) <= 0, smoke, 0))[0], dr.sum(smoke)[0]
    return folded / total if total > 0 and math.isfinite(total) else 0.0

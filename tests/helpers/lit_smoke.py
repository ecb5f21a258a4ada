"""Scenes of a look with nothing left in them but the smoke and a uniform sky."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from tnst_mi.rendering.studio import Studio


def under_a_sky(scene: Studio, albedo: float, radiance: float = 1.0) -> Studio:
    """Leave nothing but the smoke and an environment of a radiance."""
    parameters = scene.parameters
    parameters["sky.data"] = mi.TensorXf(np.full(parameters["sky.data"].shape, radiance, np.float32))
    parameters["smoke.interior_medium.albedo.value.value"] = mi.Color3f(albedo)
    # Lights are black to what falls on them.
    for other in ("ground", "key", "rim"):
        del scene._front[f"{other}.to_world"]
        parameters[f"{other}.to_world"] = mi.Transform4f().translate([0, -1000, 0]) @ mi.Transform4f().scale(1e-3)
    parameters.update()
    return scene

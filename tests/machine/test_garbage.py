"""Python's garbage collector waits while Dr.Jit traces; why, and that it does."""

from __future__ import annotations

import gc
import subprocess
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from tnst_mi.compare.bench.renderers.parameters import SceneParameters
from tnst_mi.compare.bench.renderers.scene_file import scene_renderer
from tnst_mi.compare.bench.renderers.sides import side_of
from tnst_mi.compare.path_tracing import PathTracer
from tnst_mi.machine.garbage import collection_paused
from tnst_mi.recipe.paths import LIGHTS
from tnst_mi.rendering.scattering import Lighting, ScatteringRenderer

SLAB = Path(__file__).resolve().parents[2] / "scenes" / "known" / "slab.xml"

#: A scene is loaded and dropped, and collected when the derivative's kernel has been traced by half.
PROGRAM = f"""
import gc
import drjit as dr, mitsuba as mi
from tnst_mi.machine.backend import activate
activate("llvm_ad_rgb")
dropped, scene = [mi.load_file({str(SLAB)!r})], mi.load_file({str(SLAB)!r})
integrator = mi.load_dict({{"type": "prbvolpath"}})
parameters = mi.traverse(scene)
key = next(key for key in parameters.keys() if "sigma_t" in key)
dr.enable_grad(parameters[key])
parameters.update()
image = mi.render(scene, integrator=integrator, spp=4)
calls, sample = [], type(integrator).sample
def counted(*arguments, **named):
    calls.append(0)
    if len(calls) == 2:
        dropped.clear()
        gc.collect()
    return sample(*arguments, **named)
type(integrator).sample = counted
with dr.suspend_grad():
    integrator.render_backward(scene, parameters, dr.ones(mi.TensorXf, image.shape), scene.sensors()[0], spp=4)
dr.eval(dr.grad(parameters[key]))
"""


def test_a_scene_that_is_freed_while_another_is_traced_ends_the_process() -> None:
    """What the module guards against. If this fails, Dr.Jit has mended it, and the guard can go."""
    if not mi.variant().startswith("llvm"):
        pytest.skip("the fault was found with LLVM")
    ran = subprocess.run([sys.executable, "-c", PROGRAM], check=False, capture_output=True, text=True)
    assert ran.returncode != 0 and "invalid redefinition of function" in ran.stderr


@pytest.mark.parametrize("enabled", [True, False])
def test_the_collector_is_as_it_was_afterwards(enabled: bool) -> None:
    was = gc.isenabled()
    try:
        (gc.enable if enabled else gc.disable)()
        with pytest.raises(ValueError, match="stop"), collection_paused():
            assert not gc.isenabled()
            raise ValueError("stop")
        assert gc.isenabled() is enabled
    finally:
        (gc.enable if was else gc.disable)()


def test_nothing_is_collected_while_a_path_tracer_is_traced(monkeypatch: pytest.MonkeyPatch) -> None:
    traced: list[bool] = []
    for name in ("prbvolpath", "scattered_light"):
        integrator = type(mi.load_dict({"type": name}))

        def watched(*arguments, sample=integrator.sample, **named):
            traced.append(gc.isenabled())
            return sample(*arguments, **named)

        monkeypatch.setattr(integrator, "sample", watched)
    renderer = scene_renderer(SLAB, side_of("left", "prbvolpath"))
    renderer.images(1, 1, (1,), lambda paths: None)
    renderer.derivatives(SceneParameters(renderer.scene), "extinction", 1, 1, (2,), lambda paths: None)
    of_a_run = ScatteringRenderer((2, 3, 2), 0.1, 1.0, Lighting(0.5, 0.0, LIGHTS / "key.xml", 1))
    density = dr.ones(mi.TensorXf, (2, 3, 2))
    dr.enable_grad(density)
    dr.backward(dr.sum(of_a_run.render(density, [(0.0, 0.0)]), axis=None))
    compared = PathTracer(np.ones((2, 3, 2), np.float32), [(0.0, 0.0)], 0.1)
    compared.transmittance(1, 0)
    compared.gradient(np.ones((1, 3, 2)), 1, 0)
    assert len(traced) > 8 and not any(traced)

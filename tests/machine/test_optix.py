"""OptiX: asked of a GPU alone, and missed in one line before a scene is loaded."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from tnst_mi.compare.path_tracing import PathTracer
from tnst_mi.errors import InputError
from tnst_mi.machine import optix
from tnst_mi.recipe.paths import LIGHTS
from tnst_mi.rendering.scattering import Lighting, ScatteringRenderer
from tnst_mi.rendering.studio import Smoke, Studio

DENSITY = np.ones((2, 3, 4), np.float32)


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """A GPU variant seems to be active."""
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")


@pytest.fixture
def no_optix(monkeypatch: pytest.MonkeyPatch) -> None:
    """The driver's library seems to be missing."""
    monkeypatch.setattr(optix, "LIBRARY", "libnowhere.so.1")


def test_the_library_is_loaded_to_find_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(optix, "LIBRARY", "libc.so.6")
    assert optix.optix_answers()
    (tmp_path / "broken.so").write_bytes(b"no library")
    for name in ("libnowhere.so.1", str(tmp_path / "broken.so")):
        monkeypatch.setattr(optix, "LIBRARY", name)
        assert not optix.optix_answers()


def test_a_cpu_needs_none(no_optix: None, monkeypatch: pytest.MonkeyPatch) -> None:
    for variant in ("llvm_ad_rgb", None):
        monkeypatch.setattr(mi, "variant", lambda variant=variant: variant)
        optix.require_optix("this")


def test_a_gpu_needs_it(gpu: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(optix, "optix_answers", lambda: True)
    optix.require_optix("this")


@pytest.mark.parametrize(
    ("load", "what"),
    [
        (lambda: PathTracer(DENSITY, [(0.0, 0.0)], 0.1), "compare"),
        (
            lambda: ScatteringRenderer(DENSITY.shape, 1.0, 1.0, Lighting(0.9, 0.0, LIGHTS / "key.xml", 4)),
            "--integrator prbvolpath",
        ),
        (lambda: Studio("medium", "volpath", Smoke.of([DENSITY]), [(0.0, 0.0)], (8, 8)), "render --look"),
    ],
)
def test_scenes_are_refused_without_it(gpu: None, no_optix: None, load: object, what: str) -> None:
    with pytest.raises(InputError, match=rf"^{what}: traces paths, .* needs OptiX, and libnowhere\.so\.1 cannot be"):
        load()

"""Choosing the variant: bad choices, and how imports and switches behave."""

from __future__ import annotations

import os
import subprocess
import sys

import drjit as dr
import mitsuba as mi
import pytest
import torch

import tnst_mi
from tnst_mi.machine import backend

#: Defines `image()`: the plugin in a small scene, and `expected()`: the same by `tnst_mi.render`.
SCENE = """
import mitsuba as mi, numpy as np, tnst_mi
density = np.random.default_rng(0).random((4, 5, 6)).astype(np.float32)
def image():
    to_world = mi.ScalarTransform4f()
    return mi.render(mi.load_dict({
        "type": "scene",
        "integrator": {"type": "emission_absorption", "gamma": 0.5},
        "sensor": {
            "type": "orthographic_views", "distance": 50.0,
            "film": {"type": "hdrfilm", "width": 6, "height": 5, "pixel_format": "luminance",
                     "component_format": "float32", "rfilter": {"type": "box"}},
            "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
        },
        "smoke": {
            "type": "cube", "to_world": to_world.scale([3, 2.5, 2]), "bsdf": {"type": "null"},
            "interior": {"type": "heterogeneous", "sigma_t": {
                "type": "gridvolume", "grid": mi.VolumeGrid(0.5 * density[..., None]),
                "to_world": to_world.scale([6, 5, 4]).translate(-0.5),
            }},
        },
    })).numpy()[..., 0]
def expected():
    return tnst_mi.render(density, gamma=0.5)
"""


def run(program: str) -> list[str]:
    """The lines printed by a Python program in a process of its own, where no LLVM was chosen yet."""
    chosen = ("DRJIT_LIBLLVM_PATH", "_TNST_MI_LIBLLVM_PATH")
    environment = {name: value for name, value in os.environ.items() if name not in chosen}
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout.split("\n")[:-1]


# --------------------------------------------------------------------
# The variant
# --------------------------------------------------------------------


def test_activating_again_changes_nothing(variant: str) -> None:
    changes = []
    note = lambda old, new: changes.append(new)  # noqa: E731
    mi.detail.add_variant_callback(note)
    plugin = tnst_mi.rendering.march.integrator.EmissionAbsorption
    assert [tnst_mi.activate(), tnst_mi.activate(variant), tnst_mi.activate()] == [variant] * 3
    mi.detail.remove_variant_callback(note)
    assert mi.variant() == variant
    assert changes == []
    assert tnst_mi.rendering.march.integrator.EmissionAbsorption is plugin


@pytest.mark.parametrize("name", ["scalar_rgb", "llvm_ad_mono", "gpu", ""])
def test_an_unsupported_variant_is_named(variant: str, name: str) -> None:
    with pytest.raises(tnst_mi.InputError, match=rf"variant '{name}' .*expected one of cuda_ad_rgb, llvm_ad_rgb"):
        tnst_mi.activate(name)
    assert mi.variant() == variant


def test_a_gpu_variant_without_a_gpu_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    has_backend = dr.has_backend
    monkeypatch.setattr(dr, "has_backend", lambda kind: kind != dr.JitBackend.CUDA and has_backend(kind))
    monkeypatch.setattr(mi, "variant", lambda: "llvm_ad_rgb")
    with pytest.raises(tnst_mi.InputError, match=r"needs an NVIDIA GPU .*use llvm_ad_rgb"):
        tnst_mi.activate("cuda_ad_rgb")


def test_a_gpu_that_torch_cannot_use_is_named_once_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(dr, "has_backend", lambda kind: True)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    backend._announce_idle_gpu.cache_clear()
    assert [backend._preferred_variant() for _ in range(2)] == ["llvm_ad_rgb"] * 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"warning: there is a GPU, but torch {torch.__version__} cannot use it: the CPU computes.")
    assert "Install a CUDA build of torch" in line and "or choose the variant llvm_ad_rgb" in line


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="the system has no CPU affinity")
def test_all_allowed_cores_and_no_others_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    cores = len(os.sched_getaffinity(0))
    try:
        for allowed in ({0}, {0, 1, 2}):
            monkeypatch.setattr(os, "sched_getaffinity", lambda process, allowed=allowed: allowed)
            tnst_mi.activate()
            assert torch.get_num_threads() == len(allowed) and dr.thread_count() == max(2, len(allowed))
    finally:
        monkeypatch.undo()
        tnst_mi.activate()
    assert torch.get_num_threads() == cores and dr.thread_count() == max(2, cores)


def test_torch_shares_the_variant_s_memory(variant: str) -> None:
    assert backend.torch_device().type == ("cuda" if variant.startswith("cuda") else "cpu")


# --------------------------------------------------------------------
# Imports and switches, each in a process of its own
# --------------------------------------------------------------------


def test_importing_the_package_sets_no_variant_and_imports_no_torch() -> None:
    program = "import sys, tnst_mi, mitsuba as mi; print(mi.variant(), 'torch' in sys.modules, dir(tnst_mi))"
    assert run(program) == [f"None False {dir(tnst_mi)}"]


def test_numeric_functions_pick_a_variant_themselves() -> None:
    assert run(SCENE + "print(expected().shape, mi.variant()[-7:])") == ["(5, 6) _ad_rgb"]


def test_numeric_functions_work_without_torch_and_pick_a_variant_themselves() -> None:
    program = SCENE + "print(expected().shape, mi.variant()[-7:], 'torch' in __import__('sys').modules)"
    assert run(program) == ["(5, 6) _ad_rgb False"]


def test_the_plugins_need_no_torch() -> None:
    program = SCENE + "mi.set_variant('llvm_ad_rgb'); print(image().shape, 'torch' in __import__('sys').modules)"
    assert run(program) == ["(5, 6) False"]


def test_mitsuba_may_be_imported_first() -> None:
    """Dr.Jit has loaded the system's LLVM by then, whatever its version; it must end up with a usable one."""
    program = (
        "import mitsuba"
        + SCENE
        + (
            "import drjit as dr\n"
            "print(mi.variant())\n"
            "tnst_mi.activate('llvm_ad_rgb')\n"
            "print(dr.detail.llvm_version()[0] >= 16)\n"
            "print(dr.minimum(mi.Float(1, 2), mi.Float(2, 1)))\n"
            "print(abs(image() - expected()).max() < 1e-5)\n"
        )
    )
    assert run(program) == ["None", "True", "[1, 1]", "True"]


def test_a_variant_may_be_active_before_the_import_if_its_llvm_is_usable() -> None:
    """Else there is an error that says what to do, never an aborted process."""
    program = (
        "import mitsuba as mi, drjit as dr\n"
        "mi.set_variant('llvm_ad_rgb')\n"
        "usable = dr.detail.llvm_version()[0] >= 16\n"
        "try:\n"
        "    import tnst_mi\n"
        "    mi.load_dict({'type': 'emission_absorption'})\n"
        "    print(usable)\n"
        "except ValueError as error:\n"
        "    print(not usable and 'import tnst_mi before a variant is set' in str(error))\n"
    )
    assert run(program) == ["True"]


def test_the_plugins_follow_every_change_of_the_variant() -> None:
    program = SCENE + (
        "for variant in ('llvm_ad_rgb', 'llvm_ad_mono', 'scalar_rgb', 'llvm_ad_mono', 'llvm_ad_rgb'):\n"
        "    mi.set_variant(variant)\n"
        "    images = image() if 'ad' in variant else None\n"
        "    if variant == 'llvm_ad_rgb':\n"
        "        first = expected()\n"
        "    print(variant, images is None or bool(abs(images - first).max() < 1e-5))\n"
    )
    assert run(program) == [
        f"{variant} True" for variant in ("llvm_ad_rgb", "llvm_ad_mono", "scalar_rgb", "llvm_ad_mono", "llvm_ad_rgb")
    ]

"""The doctor: a sound machine passes, and everything that can be missing is reported with its remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from tnst_mi.cli import main
from tnst_mi.commands import examination as doctor
from tnst_mi.errors import InputError
from tnst_mi.machine import backend, environment
from tnst_mi.network import shipped
from tnst_mi.network.weights import ChosenWeights

GPU = {
    "name": "Some GPU",
    "driver": "550.54.15",
    "compute_capability": "9.0",
    "memory": "81559 MiB",
    "free_memory": "80000 MiB",
}


@pytest.fixture(autouse=True)
def sound_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Weights are at hand, memory is plenty, and there is no GPU, whatever the real machine is like."""
    monkeypatch.setattr("tnst_mi.network.weights.find_weights", lambda: ChosenWeights(Path("w.safetensors"), "bvlc"))
    monkeypatch.setattr(environment, "free_memory", lambda: 8 << 30)
    monkeypatch.setattr(environment, "gpus", lambda: [])


def checks() -> dict[str, doctor.Check]:
    return {check.name: check for check in doctor.examine()}


def test_a_sound_machine(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    library = backend.llvm_library()
    assert f"{library.path}: {library.reason}" in out
    for name in ("Python", "mitsuba", "drjit", "torch", "LLVM", "GPU", "variant", "weights", "memory"):
        assert any(line.split()[:2] == ["ok", name] for line in out.splitlines()), (name, out)
    assert "8.0 GiB free" in out
    assert out.endswith("The main job can run: tnst-mi demo\n")


def test_unusable_weights_stop_the_main_job(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> ChosenWeights:
        raise InputError("w.pb: wrong hash: delete it")

    monkeypatch.setattr("tnst_mi.network.weights.find_weights", fail)
    assert main(["doctor"]) == 1
    out = capsys.readouterr().out
    assert "missing weights   unusable\n" in out
    assert "→ w.pb: wrong hash: delete it\n" in out


@pytest.mark.parametrize(
    ("fallback", "told"),
    [(False, ""), (True, "; the paper's network: tnst-mi weights --download inception5h")],
)
def test_the_shipped_network_will_do(monkeypatch: pytest.MonkeyPatch, fallback: bool, told: str) -> None:
    monkeypatch.setattr(
        "tnst_mi.network.weights.find_weights", lambda: ChosenWeights(shipped.FILE, "patterns", fallback)
    )
    assert str(checks()["weights"]) == f"ok      weights   patterns (shipped){told}"


def test_a_variant_that_cannot_start_stops_the_main_job(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> str:
        raise InputError("no LLVM library: install one")

    monkeypatch.setattr(backend, "activate", fail)
    monkeypatch.setattr(backend, "llvm_library", lambda: None)
    found = checks()
    assert not found["variant"].ok and found["variant"].remedy == "no LLVM library: install one"
    assert "pip install karellen-llvm-core" in found["LLVM"].remedy
    assert not found["LLVM"].required  # a GPU would do


@pytest.mark.parametrize(
    ("changed", "torch_has_cuda", "remedy"),
    [
        ({}, True, ""),
        ({"compute_capability": "6.1"}, True, "compute capability 7.5"),
        ({"driver": "525.60"}, True, "driver R535"),
        ({}, False, "CUDA build of torch"),
    ],
)
def test_gpus(monkeypatch: pytest.MonkeyPatch, changed: dict[str, str], torch_has_cuda: bool, remedy: str) -> None:
    monkeypatch.setattr(environment, "gpus", lambda: [GPU | changed])
    monkeypatch.setattr("torch.cuda.is_available", lambda: torch_has_cuda)
    check = checks()["GPU"]
    assert "Some GPU" in check.found
    assert check.ok == (remedy == "") and remedy in check.remedy


def test_little_memory_is_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "free_memory", lambda: 1 << 30)
    check = checks()["memory"]
    assert str(check).startswith("note    memory    1.0 GiB free\n")
    assert not check.required


def test_the_driver_is_asked_and_understood(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.undo()
    answer = "echo 'NVIDIA H100 80GB HBM3, 550.54.15, 9.0, 81559 MiB, 81000 MiB'"
    (tmp_path / "nvidia-smi").write_text(f"#!/bin/sh\n{answer}\n")
    (tmp_path / "nvidia-smi").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    (gpu,) = environment.gpus()
    assert (gpu["name"], gpu["driver"], gpu["compute_capability"]) == (
        "NVIDIA H100 80GB HBM3",
        "550.54.15",
        "9.0",
    )
    (tmp_path / "nvidia-smi").unlink()
    assert environment.gpus() == []


def test_memory_is_told_in_bytes() -> None:
    free, peak = environment.free_memory(), environment.peak_memory()
    assert free is None or 1 << 20 < free < 1 << 50
    held = bytearray(200 << 20)
    held[:: 1 << 12] = b"1" * len(held[:: 1 << 12])
    assert peak is None or environment.peak_memory() >= max(peak, 200 << 20)

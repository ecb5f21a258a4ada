"""The doctor: a sound machine passes, and everything that can be missing is reported with its remedy."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import pytest

from tnst_mi.cli import main
from tnst_mi.commands import doctor
from tnst_mi.errors import InputError
from tnst_mi.machine import backend, environment, llvm, optix
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
    monkeypatch.setattr(doctor, "find_weights", lambda: ChosenWeights(Path("w.safetensors"), "bvlc"))
    monkeypatch.setattr(environment, "free_memory", lambda: 8 << 30)
    monkeypatch.setattr(environment, "gpus", lambda: [])


def requirements() -> dict[str, doctor.Requirement]:
    return {requirement.name: requirement for requirement in doctor.examine()}


def test_a_sound_machine(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    library = llvm.llvm_library()
    assert f"{library.path}: {library.reason}" in out
    for name in ("Python", "mitsuba", "drjit", "torch", "LLVM", "GPU", "variant", "OptiX", "weights", "memory"):
        assert any(line.split()[:2] == ["ok", name] for line in out.splitlines()), (name, out)
    assert "8.0 GiB free" in out
    assert out.endswith("The main job can run: tnst-mi demo\n")


def test_unusable_weights_stop_the_main_job(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> ChosenWeights:
        raise InputError("w.pb: wrong hash: delete it")

    monkeypatch.setattr(doctor, "find_weights", fail)
    assert main(["doctor"]) == 1
    out = capsys.readouterr().out
    assert "missing weights   unusable\n" in out
    assert "→ w.pb: wrong hash: delete it\n" in out


@pytest.mark.parametrize(
    ("fallback", "told"),
    [(False, ""), (True, "; the paper's network: tnst-mi weights --download inception5h")],
)
def test_the_shipped_network_will_do(monkeypatch: pytest.MonkeyPatch, fallback: bool, told: str) -> None:
    monkeypatch.setattr(doctor, "find_weights", lambda: ChosenWeights(shipped.FILE, "patterns", fallback))
    assert str(requirements()["weights"]) == f"ok      weights   patterns (shipped){told}"


def test_a_variant_that_cannot_start_stops_the_main_job(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> str:
        raise InputError("no LLVM library: install one")

    monkeypatch.setattr(backend, "activate", fail)
    monkeypatch.setattr(llvm, "llvm_library", lambda: None)
    found = requirements()
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
    gpu = requirements()["GPU"]
    assert "Some GPU" in gpu.found
    assert gpu.ok == (remedy == "") and remedy in gpu.remedy


def test_little_memory_is_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "free_memory", lambda: 1 << 30)
    memory = requirements()["memory"]
    assert str(memory).startswith("note    memory    1.0 GiB free\n")
    assert not memory.required


@pytest.mark.parametrize(("answers", "state"), [(True, "ok"), (False, "note")])
def test_optix_is_what_a_gpu_traces_paths_with(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], answers: bool, state: str
) -> None:
    assert requirements()["OptiX"].found.startswith("not needed")
    monkeypatch.setattr(backend, "activate", lambda: "cuda_ad_rgb")
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")
    monkeypatch.setattr(optix, "optix_answers", lambda: answers)
    assert main(["doctor"]) == 0  # the main job does without
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "OptiX" in line]
    assert line.startswith(f"{state:8}OptiX")
    for use in ("compare", "--integrator prbvolpath", "render --look", "scenes of your own"):
        assert use in line
    optix_found = requirements()["OptiX"]
    assert optix_found.ok == answers and ("NVIDIA_DRIVER_CAPABILITIES" in optix_found.remedy) != answers


def test_a_torch_that_cannot_be_imported_is_told(tmp_path: Path) -> None:
    (tmp_path / "torch.py").write_text("raise ImportError('libcudnn.so.9: cannot open shared object file')")
    program = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from tnst_mi.cli import main; sys.exit(main(['doctor']))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "")
    lines = done.stdout.splitlines()
    assert [line for line in lines if line.startswith("missing")] == [
        "missing torch     cannot be imported: libcudnn.so.9: cannot open shared object file"
    ]
    assert f"{'':18}→ pip install torch" in lines
    assert any(line.split()[:2] == ["ok", "LLVM"] for line in lines)

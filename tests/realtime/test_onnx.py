"""Models as ONNX: another runtime gives the same potentials, on grids of any size."""

import json

import numpy as np
import pytest
import torch

pytest.importorskip("onnx", reason="the onnx extra is not installed")
pytest.importorskip("onnxscript", reason="the onnx extra is not installed")
onnxruntime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

from tests.realtime.test_potential_network import network  # noqa: E402
from tnst_mi.cli import main  # noqa: E402
from tnst_mi.realtime.model import read_model, write_model  # noqa: E402


def test_another_runtime_gives_the_same(tmp_path, capsys):
    written, out = tmp_path / "model.safetensors", tmp_path / "model.onnx"
    write_model(written, network(octaves=2), {"style": ["spirals"]}, {})
    assert main(["convert", str(written), str(out)]) == 0
    assert capsys.readouterr().out == f"model     {out}\n"
    session = onnxruntime.InferenceSession(out, providers=["CPUExecutionProvider"])
    metadata = session.get_modelmeta().custom_metadata_map
    assert metadata["multiple"] == "8" and json.loads(metadata["fields"]) == {"phi": 1, "psi": 3}
    model = read_model(written)
    for shape in ((8, 8, 8), (16, 40, 24), (48, 24, 32)):
        smoke, lam = torch.rand((1, 1, *shape), generator=torch.Generator().manual_seed(1)), torch.tensor([0.4])
        with torch.no_grad():
            expected = model.network(smoke, lam).numpy()
        (found,) = session.run(["potentials"], {"smoke": smoke.numpy(), "lam": lam.numpy()})
        assert np.abs(expected).max() > 0.5
        assert np.abs(found - expected).max() <= 1e-4


def test_smoke_is_no_model(tmp_path, capsys):
    smoke = tmp_path / "smoke.npy"
    np.save(smoke, np.ones((8, 8, 8), np.float32))
    assert main(["convert", str(smoke), str(tmp_path / "smoke.onnx")]) == 2
    assert "smoke.npy: damaged, or no model that `tnst-mi train` has written" in capsys.readouterr().err
    assert not (tmp_path / "smoke.onnx").exists()

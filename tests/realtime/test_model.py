"""Files of models: what is written comes back, and what is no model is refused in one line."""

import json

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.torch import save

from tests.realtime.test_potential_network import SEEN, network, smoke
from tnst_mi.errors import InputError
from tnst_mi.realtime.model import read_model, write_model
from tnst_mi.realtime.prediction import predicted

RECIPE = {"style": ["spirals"], "octaves": 1, "views": 1}


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "model.safetensors"
    write_model(path, network(), RECIPE, {"loss": 1.0})
    return path


def test_a_model_comes_back(written):
    model = read_model(written)
    assert dict(model.recipe) == RECIPE and dict(model.trained) == {"loss": 1.0}
    density = smoke()
    found, expected = predicted(model.network, density, *SEEN), predicted(network(), density, *SEEN)
    # Weights are kept in half precision.
    assert 0 < np.abs(found - expected).max() < 0.02 * np.abs(expected).max()
    assert not [path for path in written.parent.iterdir() if path != written]


def test_files_that_are_no_models_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_model(tmp_path / "none.safetensors")
    other = tmp_path / "other.safetensors"
    other.write_bytes(save({"weight": torch.zeros(2)}))
    with pytest.raises(InputError, match="has no model of tnst-mi"):
        read_model(other)


@pytest.mark.parametrize(
    "change",
    [
        {"octaves": 10**9},
        {"octaves": -1},
        {"octaves": "2"},
        {"width": 10**9},
        {"width": 0},
        {"format": 1},
        {"format": 99},
        {"recipe": 3},
        {"width": 5},
    ],
)
def test_what_a_file_claims_is_not_trusted(written, change):
    from safetensors import safe_open

    with safe_open(written, "pt") as file:
        described = json.loads(file.metadata()["tnst_mi_model"]) | change
        weights = {name: file.get_tensor(name) for name in file.keys()}
    written.write_bytes(save(weights, {"tnst_mi_model": json.dumps(described)}))
    with pytest.raises(InputError) as refused:
        read_model(written)
    assert str(written) in str(refused.value) and "\n" not in str(refused.value)


def test_weights_that_are_not_finite_are_refused(tmp_path):
    broken = network()
    with torch.no_grad():
        broken.block.fine.weight[0, 0, 0, 0, 0] = torch.nan
    write_model(tmp_path / "broken.safetensors", broken, RECIPE, {})
    with pytest.raises(InputError, match=r"block\.fine\.weight has values that are not finite"):
        read_model(tmp_path / "broken.safetensors")


@given(cut=st.integers(0, 3000), changed=st.integers(0, 3000), by=st.integers(1, 255))
def test_damaged_files_end_in_one_line(tmp_path_factory, cut, changed, by):
    path = tmp_path_factory.mktemp("damaged") / "model.safetensors"
    write_model(path, network(octaves=1, width=1), RECIPE, {})
    data = bytearray(path.read_bytes())
    if changed < len(data):
        data[changed] = (data[changed] + by) % 256
    path.write_bytes(bytes(data[: len(data) - cut]))
    try:
        read_model(path)
    except InputError as refused:
        assert "\n" not in str(refused)

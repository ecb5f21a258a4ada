"""A state that is not what was written: one line, whatever is wrong in it, and nothing is changed."""

from __future__ import annotations

import json
import math
import re
import signal
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save

import tnst_mi
from tnst_mi.reconstruction.fitting.descent import Descent
from tnst_mi.reconstruction.reconstruct import reconstruct

KEYS = {"iterations": 2, "levels": 1, "batch": 3, "gamma": 0.3}


@pytest.fixture(scope="module")
def done(views, tmp_path_factory) -> Path:
    """A reconstruction that is at its end."""
    out = tmp_path_factory.mktemp("done")
    reconstruct(views, out, KEYS, progress=False, overwrite=True)
    return out


def rewritten(state: Path, change) -> None:
    """Write a state in which something else is told."""
    with safe_open(state, "pt") as file:
        told = json.loads(file.metadata()["progress"])
        tensors = {name: file.get_tensor(name) for name in file.keys()}
    change(told, tensors)
    state.write_bytes(save(tensors, {"progress": json.dumps(told)}))


def without(*keys):
    def change(told, tensors):
        at = told
        for key in keys[:-1]:
            at = at[key]
        del at[keys[-1]]

    return change


def having(value, *keys):
    def change(told, tensors):
        at = told
        for key in keys[:-1]:
            at = at[key]
        at[keys[-1]] = value

    return change


def three_times(told, tensors):
    told["records"] *= 3


CHANGES = {
    "level 7": having(7, "level"),
    "level -3": having(-3, "level"),
    "level true": having(True, "level"),
    "seconds nan": having(math.nan, "seconds"),
    "errors text": having([["a"]], "errors"),
    "too many grids": having([[0.1]] * 9, "errors"),
    "sources list": having([], "sources"),
    "records table": having({}, "records"),
    "too many records": three_times,
    "no gamma": without("records", 0, "gamma"),
    "gamma 0": having(0, "records", 0, "gamma"),
    "no convergence": without("records", 0, "convergence"),
    "psnr text": having("a", "records", 0, "psnr"),
    "another density": having("../../x.npz", "records", 0, "density"),
    "another name": having("../x", "records", 0, "name"),
    "another view": having({"../../x": 1.0}, "records", 0, "psnr_of_views"),
    "velocity": having({"source": "known"}, "records", 0, "velocity"),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_what_no_reconstruction_comes_to_is_damaged(views, done, change):
    state = done / "state.safetensors"
    kept = state.read_bytes()
    rewritten(state, change)
    try:
        with pytest.raises(tnst_mi.InputError, match=f"{re.escape(str(state))}: damaged, .* --overwrite"):
            reconstruct(views, done, KEYS, progress=False, resume=True)
    finally:
        state.write_bytes(kept)


def test_a_density_that_is_gone_is_named(views, done):
    density = done / "density" / "smoke.npz"
    kept = density.read_bytes()
    density.unlink()
    try:
        with pytest.raises(tnst_mi.InputError, match=f"{re.escape(str(density))}: is gone"):
            reconstruct(views, done, KEYS, progress=False, resume=True)
    finally:
        density.write_bytes(kept)


@pytest.mark.parametrize("name", ["unknown", "light", "done"])
def test_tensors_that_no_descent_has_are_damaged(views, tmp_path, monkeypatch, name):
    step = Descent.step

    def stopped(descent):
        loss = step(descent)
        signal.raise_signal(signal.SIGINT)
        return loss

    with monkeypatch.context() as patch:
        patch.setattr(Descent, "step", stopped)
        assert reconstruct(views, tmp_path, KEYS, progress=False).interrupted

    def change(told, tensors):
        tensors[name] = torch.tensor(99) if name == "done" else tensors[name] * math.nan

    state = tmp_path / "state.safetensors"
    rewritten(state, change)
    with pytest.raises(tnst_mi.InputError, match=f"{re.escape(str(state))}: damaged"):
        reconstruct(views, tmp_path, KEYS, progress=False, resume=True)

"""Grids and pictures that do not fit into the memory are refused in one line, before anything is done with them."""

from __future__ import annotations

import pytest

import tnst_mi
from tnst_mi.machine import environment
from tnst_mi.reconstruction.preparation import prepare


def test_what_does_not_fit_is_refused(views, monkeypatch):
    tnst_mi.activate()
    grey = 15 * 20 * 20 * 12
    monkeypatch.setattr(environment, "free_memory", lambda: 118 * 12 * 16 * 10)
    assert len(prepare(views, {}, None, None).photographs(None)) == 15
    with pytest.raises(tnst_mi.InputError, match=r"memory: 15360 cells need .* enough for 1920; take fewer --cells"):
        prepare(views, {"cells": 32}, None, None)
    prepared, coloured = prepare(views, {}, None, None), prepare(views, {"channel": "rgb"}, None, None)
    monkeypatch.setattr(environment, "free_memory", lambda: grey)
    prepared.photographs(None)
    with pytest.raises(tnst_mi.InputError, match=r"memory: 15 pictures of 20 × 20 pixels need .* make them smaller"):
        coloured.photographs(None)
    monkeypatch.setattr(environment, "free_memory", lambda: grey - 1)
    with pytest.raises(tnst_mi.InputError, match="memory: 15 pictures"):
        prepared.photographs(None)

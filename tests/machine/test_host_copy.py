"""Copies to the host hold what the device had when they were launched; torch and Dr.Jit follow each other's work."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import torch

from tnst_mi.machine.host_copy import HostCopy

COUNT = 1 << 20


def test_a_copy_holds_what_was_there_when_it_was_launched() -> None:
    numbers = [mi.TensorXf(dr.full(mi.Float, i, COUNT), (COUNT,)) for i in range(20)]
    copies = [HostCopy((number * 2).torch()) for number in numbers]
    for i, copy in enumerate(copies):
        assert copy.numpy().shape == (COUNT,) and (copy.numpy() == 2 * i).all()
        assert copy.ready


def test_half_precision_is_kept() -> None:
    half = mi.TensorXf16(mi.TensorXf(np.float32([0.1, 1e9])))
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(HostCopy(half.torch()).numpy(), np.float16([0.1, 1e9]))


def test_torch_and_drjit_follow_each_other_without_being_synchronised() -> None:
    """x → 2 (x + 1) in turns: each step reads what the other library has just been asked to compute."""
    x, expected = dr.zeros(mi.Float, COUNT), 0.0
    for _ in range(12):
        grown = (x + 1).torch() * 2
        x, expected = mi.Float(grown), 2 * (expected + 1)
    shares = torch.bincount((x.torch() == expected).long(), minlength=2)
    assert shares.tolist() == [0, COUNT]

"""Octave sizes, and the order of cells."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

import tnst_mi
from tnst_mi.fields.grid import Cells, octaves


def test_octave_sizes_are_those_of_the_paper() -> None:
    levels = octaves((200, 300, 200), 3)
    assert [level.shape for level in levels] == [(61, 92, 61), (111, 166, 111), (200, 300, 200)]
    assert [level.cell_size for level in levels] == [300 / 92, 300 / 166, 1.0]
    assert [level.shape for level in octaves((192, 256, 192), 3)][:2] == [(58, 78, 58), (106, 142, 106)]
    assert octaves((1, 5, 3), 4)[0].shape == (1, 1, 1)


@pytest.mark.parametrize(("count", "factor"), [(0, 1.8), (2, 1.0)])
def test_bad_octaves_are_named(count: int, factor: float) -> None:
    with pytest.raises(tnst_mi.InputError, match=f"count {count} and factor {factor}"):
        octaves((4, 4, 4), count, factor)


def test_cells_are_enumerated_in_storage_order() -> None:
    shape = (3, 5, 4)
    cells = Cells.of(shape)
    z, y, x = np.unravel_index(np.arange(60), shape)
    for ours, expected in ((cells.x, x), (cells.y, y), (cells.z, z)):
        np.testing.assert_array_equal(ours.numpy(), expected)
    np.testing.assert_array_equal(cells.index(cells.x, cells.y, cells.z).numpy(), np.arange(60))


def test_chosen_cells_and_their_own_values() -> None:
    shape = (3, 5, 4)
    chosen = np.array([0, 7, 31, 59], np.uint32)
    cells = Cells.of(shape, mi.UInt32(chosen))
    for ours, expected in zip((cells.z, cells.y, cells.x), np.unravel_index(chosen, shape), strict=True):
        np.testing.assert_array_equal(ours.numpy(), expected)
    values = np.random.default_rng(3).random((60, 3)).astype(np.float32)
    for c, own in enumerate(cells.own(mi.Float(values.ravel()), 3)):
        np.testing.assert_array_equal(own.numpy(), values[chosen, c])
    (own,) = Cells.of(shape).own(mi.Float(values[:, 0].copy()))
    np.testing.assert_array_equal(own.numpy(), values[:, 0])

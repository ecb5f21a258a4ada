"""Flicker against numpy, and in cases whose value is known by hand."""

from __future__ import annotations

import itertools
import weakref

import numpy as np
import pytest
from fields import blob, smooth_noise

from tnst_mi.errors import InputError
from tnst_mi.run.flicker import FlickerMeter, flicker, relative_change

SHAPE = (7, 9, 8)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def uniform(x: float, y: float, z: float) -> np.ndarray:
    return np.broadcast_to(np.float32([x, y, z]), (*SHAPE, 3)).copy()


def single_cell(z: int, y: int, x: int) -> np.ndarray:
    field = np.zeros(SHAPE, np.float32)
    field[z, y, x] = 0.7
    return field


def carried(field: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """The field at x − u(x), linear between the cells and constant beyond the border, in float64."""
    last = np.array(field.shape) - 1
    where = np.clip(np.indices(field.shape) - np.moveaxis(velocity[..., ::-1], -1, 0), 0, last[:, None, None, None])
    result = np.zeros(field.shape)
    for corner in itertools.product((0, 1), repeat=3):
        cell = [np.minimum(np.floor(p).astype(int) + c, n) for p, c, n in zip(where, corner, last, strict=True)]
        weight = np.prod([f if c else 1 - f for c, f in zip(corner, where % 1.0, strict=True)], axis=0)
        result += weight * field[tuple(cell)]
    return result


def test_the_formula(rng: np.random.Generator) -> None:
    change, following = smooth_noise(rng, *SHAPE), smooth_noise(rng, *SHAPE)
    velocity = 4 * smooth_noise(rng, *SHAPE, 3)
    difference = carried(change.astype(np.float64), velocity.astype(np.float64)) - following
    expected = np.linalg.norm(difference) / np.linalg.norm(following.astype(np.float64))
    assert flicker(change, following, velocity) == pytest.approx(expected, rel=1e-5)
    # Not symmetric: which of the two is carried matters.
    assert flicker(following, change, velocity) != pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("motion", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (-1, 1, 0)])
def test_a_change_that_moves_with_the_smoke_does_not_flicker(motion: tuple[int, int, int]) -> None:
    change = np.zeros(SHAPE, np.float32)
    change[2:-2, 2:-2, 2:-2] = blob(SHAPE, (4, 4, 3), 1.5)[2:-2, 2:-2, 2:-2]
    following = np.roll(change, motion[::-1], axis=(0, 1, 2))
    assert flicker(change, following, uniform(*motion)) == 0.0
    assert flicker(change, following, uniform(*(-component for component in motion))) > 0.5


def test_a_change_that_stays_behind_flickers() -> None:
    stays = single_cell(3, 4, 4)
    assert flicker(stays, stays, uniform(0, 0, 0)) == 0.0
    # Moved by a whole cell it is elsewhere: √(1 + 1). By half a cell, half of it is in each of two cells: √(¼ + ¼).
    assert flicker(stays, stays, uniform(1, 0, 0)) == pytest.approx(np.sqrt(2), rel=1e-6)
    assert flicker(stays, stays, uniform(0, 0.5, 0)) == pytest.approx(np.sqrt(0.5), rel=1e-6)
    assert flicker(np.zeros_like(stays), stays, uniform(1, 0, 0)) == 1.0
    assert flicker(-stays, stays, uniform(0, 0, 0)) == pytest.approx(2.0, rel=1e-6)


def test_smoke_that_enters_brings_the_change_at_the_border() -> None:
    everywhere = np.full(SHAPE, 0.3, np.float32)
    assert flicker(everywhere, everywhere, uniform(2.5, -3, 1)) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("scale", [2.0**-80, 2.0**80])
def test_flicker_does_not_depend_on_the_size_of_the_change(rng: np.random.Generator, scale: float) -> None:
    """The squares of such numbers are beyond float32."""
    change, following = smooth_noise(rng, *SHAPE), smooth_noise(rng, *SHAPE)
    velocity = smooth_noise(rng, *SHAPE, 3)
    scaled = [np.float32(scale) * field for field in (change, following)]
    assert flicker(*scaled, velocity) == pytest.approx(flicker(change, following, velocity), rel=1e-6)
    density = np.abs(smooth_noise(rng, *SHAPE))
    assert relative_change(np.float32(scale) * density, np.float32(scale) * (density + change)) == pytest.approx(
        relative_change(density, density + change), rel=1e-5
    )


def test_relative_change() -> None:
    assert relative_change(np.full(SHAPE, 0.4, np.float32), np.full(SHAPE, 0.3, np.float32)) == pytest.approx(0.25)
    assert relative_change(single_cell(1, 1, 1), single_cell(1, 1, 2)) == pytest.approx(np.sqrt(2))
    assert relative_change(single_cell(1, 1, 1), single_cell(1, 1, 1)) == 0.0


def test_where_there_is_no_figure() -> None:
    nothing, something = np.zeros(SHAPE, np.float32), single_cell(3, 4, 4)
    assert flicker(something, nothing, uniform(0, 0, 0)) is None
    assert flicker(nothing, nothing, uniform(0, 0, 0)) is None
    assert relative_change(nothing, something) is None
    with pytest.raises(InputError, match="expected"):
        flicker(something, something, np.zeros((2, 2, 2, 3), np.float32))


def test_the_meter_measures_every_pair_of_a_sequence(rng: np.random.Generator) -> None:
    befores = [np.abs(smooth_noise(rng, *SHAPE)) for _ in range(6)]
    afters = [before + smooth_noise(rng, *SHAPE) for before in befores]
    afters[4] = befores[4]
    velocities = [smooth_noise(rng, *SHAPE, 3) for _ in range(6)]
    velocities[1] = velocities[5] = None
    meter = FlickerMeter()
    assert (meter.pairs, meter.mean) == ([], None)
    for i in range(6):
        meter.add(f"f_{i}", befores[i], afters[i], velocities[i])
    changes = [after - before for before, after in zip(befores, afters, strict=True)]
    figures = {i: flicker(changes[i], changes[i + 1], velocities[i]) for i in (0, 2, 3, 4)}
    assert figures[3] is None
    assert meter.pairs == [{"from": f"f_{i}", "to": f"f_{i + 1}", "flicker": figure} for i, figure in figures.items()]
    assert meter.mean == pytest.approx((figures[0] + figures[2] + figures[4]) / 3)


def test_the_meter_keeps_only_the_last_frame() -> None:
    meter, seen = FlickerMeter(), []
    for i in range(5):
        density, velocity = single_cell(3, 4, i + 1), uniform(1, 0, 0)
        meter.add(f"f_{i}", np.zeros_like(density), density, velocity)
        seen += [weakref.ref(density), weakref.ref(velocity)]
        del density, velocity
        assert [reference() is not None for reference in seen] == [False] * (2 * i + 1) + [True]
    assert [pair["flicker"] for pair in meter.pairs] == [0.0] * 4

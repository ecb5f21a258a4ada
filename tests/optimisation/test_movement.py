"""Other grids move as the density does: held against shifted arrays, linear fields and the density itself."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from tnst_mi.frame import Frame
from tnst_mi.geometry.other_grids import OtherGrid
from tnst_mi.optimisation.movement import Movement
from tnst_mi.optimisation.parameterisation import Fields, Transport

SHAPE = (9, 10, 11)

#: Cells per frame (x, y, z) of a uniform velocity, whose potential is linear.
WHOLE, BROKEN = (2.0, -1.0, 3.0), (0.25, -0.5, 0.75)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def uniform(v: tuple[float, float, float], frame: Frame, blend: float = 1.0, **transport: object) -> Movement:
    z, y, x = np.indices(SHAPE, dtype=np.float32)
    phi = mi.TensorXf(v[0] * x + v[1] * y + v[2] * z)
    return Movement(Transport(1.0, **transport), Fields(phi=phi), 1.0, frame, exponent=3, blend=blend)


#: Cells whose way there and back ends inside the grid: elsewhere MacCormack's correction meets what is beyond it.
RETURNING = tuple(slice(max(-int(c), 0), n + min(-int(c), 0)) for c, n in zip(reversed(WHOLE), SHAPE, strict=True))


def shifted(values: np.ndarray, v: tuple[float, float, float], outside: float) -> np.ndarray:
    """Values that have moved by whole cells, and what comes in from beyond the grid."""
    result = np.full_like(values, outside)
    target, source = [], []
    for cells, size in zip(map(int, reversed(v)), SHAPE, strict=True):
        target.append(slice(max(cells, 0), size + min(cells, 0)))
        source.append(slice(max(-cells, 0), size + min(-cells, 0)))
    result[tuple(target)] = values[tuple(source)]
    return result


@pytest.mark.parametrize("trace", ["step", "flow"])
@pytest.mark.parametrize(
    "dtype", [np.float16, np.float32, np.float64, np.int8, np.uint8, np.int32, np.uint16, np.int64, bool]
)
def test_whole_cells_are_a_shift_in_every_type(dtype: type, trace: str, rng: np.random.Generator) -> None:
    values = (rng.random(SHAPE) * 2 if dtype is bool else rng.random(SHAPE) * 100).astype(dtype)
    movement = uniform(WHOLE, Frame(np.ones(SHAPE)), trace=trace)
    moved = movement.carried(OtherGrid(values))
    assert moved.dtype == dtype
    # Powers of two and whole cells: nothing is rounded but to single precision, along a flow by some ulps.
    expected = shifted(values.astype(np.float32), WHOLE, 0.0)
    moved, expected = moved[RETURNING].astype(np.float64), expected[RETURNING]
    np.testing.assert_allclose(moved, expected, rtol=2e-6 if trace == "flow" else 0, atol=1e-4)


def test_what_comes_in_is_what_is_beyond_the_grid(rng: np.random.Generator) -> None:
    """A temperature in kelvins brings ambient air, where the density brings none."""
    values = (290 + 10 * rng.random(SHAPE)).astype(np.float32)
    moved = uniform(WHOLE, Frame(np.ones(SHAPE))).carried(OtherGrid(values, np.array(290.0)))
    np.testing.assert_allclose(moved[RETURNING], shifted(values, WHOLE, 290.0)[RETURNING], rtol=1e-6)
    assert moved.min() > 285
    still = uniform((0.0, 0.0, 0.0), Frame(np.ones(SHAPE))).carried(OtherGrid(values, np.array(290.0)))
    np.testing.assert_array_equal(still, values)


def test_vectors_move_by_components_and_keep_their_directions(rng: np.random.Generator) -> None:
    values = rng.normal(size=(*SHAPE, 3)).astype(np.float32)
    outside = np.array([0.0, 5.0, -1.0])
    moved = uniform(WHOLE, Frame(np.ones(SHAPE))).carried(OtherGrid(values, outside))
    for c in range(3):
        expected = shifted(values[..., c], WHOLE, outside[c])
        np.testing.assert_allclose(moved[(*RETURNING, c)], expected[RETURNING], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("trace", ["step", "flow"])
def test_a_linear_field_is_read_where_it_comes_from(trace: str) -> None:
    """f(x − v) for f = 3x − 2y + 5z − 40, which is negative too, and is not clamped."""
    z, y, x = np.indices(SHAPE, dtype=np.float32)
    field = 3 * x - 2 * y + 5 * z - 40
    moved = uniform(BROKEN, Frame(np.ones(SHAPE)), trace=trace).carried(OtherGrid(field))
    inside = (slice(2, -2),) * 3
    expected = field - np.float32(3 * BROKEN[0] - 2 * BROKEN[1] + 5 * BROKEN[2])
    np.testing.assert_allclose(moved[inside], expected[inside], atol=2e-5)
    assert moved.min() < -20


@pytest.mark.parametrize("blend", [1.0, 0.3])
@pytest.mark.parametrize("solid", [False, True])
@pytest.mark.parametrize("keys", [{}, {"substeps": 2}, {"trace": "flow"}, {"trace": "flow", "conservative": True}])
def test_a_copy_of_the_density_moves_with_it_bit_for_bit(
    keys: dict[str, object], solid: bool, blend: float, rng: np.random.Generator
) -> None:
    density = np.maximum(rng.normal(size=SHAPE), 0).astype(np.float32)
    obstacle = np.zeros(SHAPE, bool)
    obstacle[3:6, 3:6, 3:6] = True
    frame = Frame(density, obstacle=obstacle if solid else None)
    phi = mi.TensorXf(rng.normal(size=SHAPE).astype(np.float32) * 3)
    movement = Movement(Transport(1.0, **keys), Fields(phi=phi), 1.0, frame, exponent=-2, blend=blend)
    moved = movement.density(density)
    assert (moved != density).mean() > 0.2
    np.testing.assert_array_equal(movement.carried(OtherGrid(density)), moved)
    vectors = movement.carried(OtherGrid(np.stack([density, 2 * density, -density], axis=-1)))
    np.testing.assert_array_equal(vectors, np.stack([moved, 2 * moved, -moved], axis=-1))
    if solid:
        np.testing.assert_array_equal(moved[obstacle], density[obstacle])


def test_large_whole_numbers_stay_exact_where_nothing_moves(rng: np.random.Generator) -> None:
    """Single precision holds whole numbers up to 2²⁴."""
    values = rng.integers(2**30, 2**31 - 1, SHAPE).astype(np.int32)
    still = uniform((0.0, 0.0, 0.0), Frame(np.ones(SHAPE)))
    np.testing.assert_array_equal(still.carried(OtherGrid(values)), values)


@pytest.mark.parametrize("scale", [1e-38, 1e-30, 1.0, 1e30, 3e37])
def test_values_of_any_size_move_alike(scale: float, rng: np.random.Generator) -> None:
    """The unit is that of the density, unless values would leave the range of single precision in it."""
    values = rng.random(SHAPE).astype(np.float32) + 0.5
    movement = uniform(BROKEN, Frame(np.ones(SHAPE)))
    reference, power = movement.carried(OtherGrid(values)), np.float32(2.0 ** round(np.log2(scale)))
    np.testing.assert_allclose(movement.carried(OtherGrid(values * power)), reference * power, rtol=1e-6)


def test_what_stays_is_not_touched() -> None:
    distances = np.linspace(-3, 3, num=np.prod(SHAPE), dtype=np.float32).reshape(SHAPE)
    grid = OtherGrid(distances, stays=True)
    assert uniform(WHOLE, Frame(np.ones(SHAPE))).carried(grid) is distances

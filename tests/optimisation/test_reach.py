"""How far smoke may be moved, and how strongly: bounds that hold in every cell, and a dial that is monotone."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from fields import blob, smooth_noise
from hypothesis import given, settings
from hypothesis import strategies as st

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.parameterisation import Fields, Transport
from tnst_mi.optimisation.result import Stylized
from tnst_mi.optimisation.single_frame import optimise
from tnst_mi.recipe.lengths import in_cells
from tnst_mi.recipe.recipe import Recipe

SHAPE = (16, 24, 16)
WAYS = [{}, {"trace": "flow"}, {"trace": "flow", "conservative": True}, {"substeps": 3}]


@pytest.fixture(scope="module")
def smoke() -> Frame:
    """A small lumpy cloud."""
    rng = np.random.default_rng(1)
    cloud = blob(SHAPE, (7.5, 11, 8), 4) * (1 + 2 * np.abs(smooth_noise(rng, *SHAPE)))
    return Frame(np.clip(cloud, 0, 1), name="cloud")


def recipe(**changes: object) -> Recipe:
    values = {"semantic": ("inception_3a/3x3:2",), "octaves": 2, "iterations": 3, "views": 2, "eta": 0.05}
    return Recipe(**values | changes)


def fastest(velocity: np.ndarray) -> float:
    return float(np.linalg.norm(velocity.astype(np.float64), axis=-1).max())


# ---------------------------------------------------------------- the bound


@given(
    st.sampled_from([0.0, 0.3, 1.0]), st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), st.sampled_from([1.0, 1.8]), st.data()
)
@settings(max_examples=40)
def test_no_cell_is_faster_than_the_bound(lam: float, size: float, reach: float, h: float, data: st.DataObject) -> None:
    transport, rng = Transport(lam), np.random.default_rng(data.draw(st.integers(0, 99)))
    shape = data.draw(st.tuples(*[st.integers(1, 12)] * 3))
    shapes = {name: shape if c == 1 else (*shape, c) for name, c in transport.channels.items()}
    fields = Fields({name: mi.TensorXf(np.float32(size * rng.standard_normal(s))) for name, s in shapes.items()})
    before, bounded = fastest(transport.velocity(fields, h).numpy()), transport.within(fields, reach, h)
    found = fastest(transport.velocity(bounded, h).numpy())
    assert found <= reach
    if before <= reach * (1 - 1e-5):
        for name, field in fields.items():
            np.testing.assert_array_equal(bounded[name].numpy(), field.numpy())
    elif before > reach * (1 + 1e-5):
        # As far as is allowed, and along the same lines.
        assert found == pytest.approx(reach, rel=1e-4)
        for name, field in fields.items():
            np.testing.assert_allclose(
                bounded[name].numpy(), field.numpy() * (reach / before), rtol=1e-4, atol=1e-6 * size * reach / before
            )


@pytest.mark.parametrize("keys", WAYS)
def test_smoke_stays_within_the_bound_whatever_the_transport(keys: dict) -> None:
    """A field that is 1 in one half of the grid shows how far any of it came: what moves d cells, arrives d beyond."""
    transport, rng, reach = Transport(0.4, **keys), np.random.default_rng(5), 3.0
    shape = (6, 6, 40)
    shapes = {"phi": shape, "psi": (*shape, 3)}
    fields = Fields({name: mi.TensorXf(40 * smooth_noise(rng, *s, passes=3)) for name, s in shapes.items()})
    bounded = transport.within(fields, reach, 1.0)
    assert fastest(transport.velocity(fields, 1.0).numpy()) > 2 * reach
    # Interpolation reads the next cell too, in every step.
    blur = 1 + transport.substeps
    for side in (0, 1):
        half = np.zeros(shape, np.float32)
        half[..., 20 * side : 20 * side + 20] = 1
        moved = transport.density(bounded, mi.TensorXf(half), 1.0).numpy()
        beyond = moved[..., 20:] if side == 0 else moved[..., :20][..., ::-1]
        assert beyond[..., :2].any() and not beyond[..., int(reach) + blur :].any()


def displacement(frame: Frame, network: GoogLeNet, **changes: object) -> float:
    return fastest(optimise(frame, recipe(**changes), network).velocity)


@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"lam": 1.0},
        {"lam": 0.5, "octaves": 3, "steps": 2},
        {"motif_size": 2.0},
        {"motif_size": 0.7, "lam": 0.0},
    ],
)
def test_a_run_moves_no_smoke_farther(keys: dict, network: GoogLeNet, smoke: Frame) -> None:
    free, bounded = (displacement(smoke, network, **keys, **more) for more in ({}, {"reach": "2%"}))
    assert bounded <= 0.02 * 24 < 0.5 * free
    assert bounded > 0.9 * 0.02 * 24, "as far as it may"
    assert displacement(smoke, network, **keys, reach=1000) == free


def test_windows_keep_the_bound(weights: Path, smoke: Frame) -> None:
    velocity = np.full((*SHAPE, 3), 0.4, np.float32)
    frames = [Frame(np.roll(smoke.density, i, axis=2), velocity, name=f"f{i}", number=i) for i in range(3)]
    keys = {"window": 3, "coherence": 1.0, "lam": 0.0, "transport": "flow", "weights": str(weights)}
    result = tnst_mi.stylize(frames, recipe(reach=0.5, **keys), progress=False)
    assert all(0.45 < fastest(velocity) <= 0.5 for velocity in result.velocities)


# ---------------------------------------------------------------- the dial


@pytest.mark.parametrize("keys", [{}, {"lam": 1.0}, {"parameterisation": "density"}, {"blend": 0.3}, {"reach": "3%"}])
def test_no_strength_leaves_the_input_bit_for_bit(keys: dict, network: GoogLeNet, smoke: Frame) -> None:
    result = optimise(smoke, recipe(strength=0.0, **keys), network)
    assert result.density.tobytes() == smoke.density.tobytes()
    assert not result.velocity.any()


@pytest.mark.parametrize("keys", [{}, {"lam": 1.0}])
def test_smoke_moves_in_proportion_to_the_strength(keys: dict, network: GoogLeNet, smoke: Frame) -> None:
    full = optimise(smoke, recipe(**keys), network)
    changes = []
    for strength in (0.25, 0.5, 0.75, 1.0):
        found: Stylized = optimise(smoke, recipe(strength=strength, **keys), network)
        np.testing.assert_allclose(found.velocity, strength * full.velocity, atol=1e-5 * fastest(full.velocity))
        changes.append(np.linalg.norm(found.density - smoke.density))
    assert np.all(np.diff([0.0, *changes]) > 0)


def test_full_strength_is_the_recipe_bit_for_bit(network: GoogLeNet, smoke: Frame) -> None:
    plain, full = (optimise(smoke, recipe(**keys), network) for keys in ({}, {"strength": 1.0, "reach": "off"}))
    assert plain.density.tobytes() == full.density.tobytes()


def test_strength_fades_in_over_the_frames(weights: Path, smoke: Frame) -> None:
    """Every frame of a sequence is found alike: what differs is how much of it is shown."""
    frames = [Frame(smoke.density, name=f"f{i}", number=i) for i in (4, 6, 8)]
    keys = {"weights": str(weights)}
    faded = tnst_mi.stylize(frames, recipe(strength={4: 0.0, 8: 1.0}, **keys), progress=False)
    full = tnst_mi.stylize(frames, recipe(**keys), progress=False)
    for share, part, whole in zip((0.0, 0.5, 1.0), faded.velocities, full.velocities, strict=True):
        np.testing.assert_allclose(part, share * whole, atol=1e-5 * fastest(whole))
    assert np.array_equal(faded.densities[0], smoke.density) and np.array_equal(faded.densities[2], full.densities[2])


# ---------------------------------------------------------------- the keys


@pytest.mark.parametrize("value", [0, -3, "0%", "101%", "five", "5 cells", True, float("inf"), None, "-5%"])
def test_other_lengths_are_refused_in_one_line(value: object) -> None:
    with pytest.raises(InputError, match=r"^recipe: reach = [^\n]*a share of the height such as 5% [^\n]*$"):
        Recipe(reach=value)


@pytest.mark.parametrize(("text", "cells"), [("5%", 4.8), ("12.5%", 12.0), ("7", 7.0), ("off", None), ("100%", 96.0)])
def test_lengths_as_flags_and_in_files(text: str, cells: float | None, tmp_path: Path) -> None:
    given = Recipe().updated_by_flags({"reach": text})
    assert in_cells(given.reach, 96) == (None if cells is None else pytest.approx(cells))
    (tmp_path / "r.toml").write_text(given.to_toml(), "utf-8")
    assert Recipe.from_toml(tmp_path / "r.toml").reach == given.reach


def test_strength_beyond_its_range_is_refused() -> None:
    with pytest.raises(InputError, match=r"strength = 1.5: expected a number from 0 to 1"):
        Recipe(strength=1.5)

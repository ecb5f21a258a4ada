"""Masks in each of their forms, against closed forms, a rendered picture, and motions that are known."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from moving_smoke import moving_smoke
from PIL import Image

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.geometry.placement import Placement
from tnst_mi.io.sequence import open_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.targets import targets_of
from tnst_mi.regions.measured_masks import measured_masks
from tnst_mi.regions.regions import Regions, regions_of
from tnst_mi.regions.shapes import shape_mask
from tnst_mi.run.prepare import prepare

SHAPE = (7, 9, 8)


def masks(frames: Any, mask: Any, **keys: Any) -> list[np.ndarray]:
    """The mask of a recipe in each frame."""
    regions = regions_for(frames, mask, **keys)
    return [regions.masks(index, frame)[0] for index, frame in enumerate(frames)]


def regions_for(frames: Any, mask: Any, **keys: Any) -> Regions:
    regions = regions_of(Recipe.from_dict({"mask": mask, **keys}), frames, [frame.number for frame in frames])
    assert regions is not None
    return regions


def frames(count: int = 1, shape: tuple[int, int, int] = SHAPE, **others: Any) -> list[Frame]:
    return [Frame(np.ones(shape), name=f"f_{i}", number=10 + i, **others) for i in range(count)]


# --- Shapes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("up", ["y", "z"])
def test_shapes_stand_in_the_scene(up: str) -> None:
    """Cell by cell; in a scene whose Z is up, our y is its Z and our z runs along its −Y."""
    placement = Placement(0.25, (1.0, -2.0, 0.5), up)
    sphere = {"centre": (1.6, -1.3, 1.1), "radius": 0.8, "edge": 0.3}
    box = {"low": (1.2, -1.8, 0.8), "high": (2.4, -0.9, 1.9), "edge": 0.4}
    found = [shape_mask(form, part, SHAPE, placement) for form, part in (("sphere", sphere), ("box", box))]
    ramp = shape_mask("height", {"height": (1.9, 0.6)}, SHAPE, placement)
    for (z, y, x), value in np.ndenumerate(found[0]):
        along = (x, y, z) if up == "y" else (x, SHAPE[0] - 1 - z, y)
        place = np.array(placement.corner) + 0.25 * np.array(along)
        distance = np.linalg.norm(place - sphere["centre"])
        assert value == pytest.approx(np.clip((0.8 - distance) / 0.3, 0, 1), abs=1e-6)
        depth = min(*(place - box["low"]), *(np.array(box["high"]) - place))
        assert found[1][z, y, x] == pytest.approx(np.clip(depth / 0.4, 0, 1), abs=1e-6)
        height = place[1] if up == "y" else place[2]
        assert ramp[z, y, x] == pytest.approx(np.clip((1.9 - height) / 1.3, 0, 1), abs=1e-6)
    assert all(0 < mask.mean() < 1 and mask.max() > 0.7 for mask in found)


def test_grids_without_a_placement_count_in_cells() -> None:
    (mask,) = masks(frames(), {"shape": "box", "low": [2, 3, 1], "high": [4, 5, 1]})
    expected = np.zeros(SHAPE)
    expected[1:2, 3:6, 2:5] = 1
    np.testing.assert_array_equal(mask, expected)


def test_every_number_may_have_keyframes_and_strength_fades() -> None:
    sphere = {"shape": "sphere", "centre": {10: [2, 4, 3], 14: [6, 4, 3]}, "radius": {10: 1, 14: 3}}
    for i, mask in enumerate(masks(frames(5), sphere | {"strength": {10: 0.0, 14: 1.0}})):
        z, y, x = np.indices(SHAPE)
        inside = np.sqrt((x - 2 - i) ** 2 + (y - 4) ** 2 + (z - 3) ** 2) <= 1 + i / 2
        np.testing.assert_allclose(mask, inside * i / 4, atol=1e-6)


def test_a_list_is_a_product_and_invert_turns_a_mask_around() -> None:
    ramp, box = {"height": [0, 8]}, {"shape": "box", "low": [0, 0, 0], "high": [3, 8, 6]}
    (product,) = masks(frames(), [ramp, box | {"invert": True}])
    (alone,), (inside,) = masks(frames(), ramp), masks(frames(), box)
    np.testing.assert_array_equal(product, alone * (1 - inside))


# --- Pictures ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("view", [(0.0, 0.0), (25.0, 10.0), (90.0, 0.0), (-160.0, -35.0)])
@pytest.mark.parametrize("scale", [1, 3])
def test_what_is_painted_over_a_rendered_cell_is_that_cell(
    view: tuple[float, float], scale: int, tmp_path: Path
) -> None:
    """At the resolution of our picture, or three times that."""
    smoke, cell = np.zeros((11, 13, 12), np.float32), (7, 4, 8)
    smoke[cell] = 1
    image = tnst_mi.render(smoke, view=view)
    row, column = np.unravel_index(image.argmax(), image.shape)
    rows, columns = np.indices(image.shape)
    painting = ((abs(rows - row) <= 1) & (abs(columns - column) <= 1)).repeat(scale, 0).repeat(scale, 1)
    Image.fromarray((255 * painting).astype(np.uint8)).save(tmp_path / "paint.png")
    mask = {"image": str(tmp_path / "paint.png"), "view": list(view)}
    (found,) = masks([Frame(smoke)], mask)
    assert found[cell] == 1
    assert 11 < found.sum() < 9 * 20, "a bar through the grid, three pixels wide"
    assert (found * tnst_mi.render(found, view=view).max() >= 0).all()
    seen = tnst_mi.render((found > 0).astype(np.float32), view=view)
    assert seen[abs(rows - row) > 4].max(initial=0) == 0


def test_a_painted_half_is_half_of_the_grid(tmp_path: Path) -> None:
    """A layer in any colour counts where it is opaque; a picture without transparency where it is white."""
    layer, plain = np.zeros((90, 80, 4), np.uint8), np.zeros((90, 80), np.uint8)
    layer[:, :40] = 90, 0, 0, 255
    plain[:, :40] = 255
    for name, pixels in (("layer", layer), ("plain", plain)):
        Image.fromarray(pixels).save(tmp_path / f"{name}.png")
        (mask,) = masks(frames(), {"image": str(tmp_path / f"{name}.png"), "view": [0, 0]})
        np.testing.assert_allclose(mask, np.broadcast_to(np.arange(8) < 4, SHAPE), atol=1e-6)
    Image.fromarray(plain[:60]).save(tmp_path / "cut.png")
    with pytest.raises(InputError, match=r"mask: .*80×60 pixels, expected the proportions of the view, 8×9"):
        masks(frames(), {"image": str(tmp_path / "cut.png"), "view": [0, 0]})


@pytest.mark.parametrize(
    ("paint", "said"),
    [
        ("white over our picture", True),
        ("opaque colour", True),
        ("thin opaque colour", True),
        ("a layer of its own", False),
        ("black and white", False),
        ("soft edges", False),
    ],
)
def test_a_picture_that_counts_by_its_grey_is_told(paint: str, said: bool, tmp_path: Path) -> None:
    """Where the smoke is white in our own picture, it counts as if it had been painted."""
    smoke = np.zeros((20, 32, 32), np.float32)
    smoke[8:12, 6:26, 6:26] = np.linspace(0.1, 1, 20)[:, None]
    picture = np.round(255 * (image := tnst_mi.render(smoke)) / image.max()).astype(np.uint8)
    stroke = np.zeros((32, 32), bool)
    stroke[4:14, 8:20] = True
    pixels = {
        "white over our picture": np.where(stroke, 255, picture),
        "opaque colour": np.where(stroke[..., None], (255, 0, 0), picture[..., None]),
        "thin opaque colour": np.where(stroke[..., None] & (np.arange(32) == 10)[:, None], (255, 0, 0), 0),
        "a layer of its own": np.where(stroke[..., None], (90, 10, 0, 255), 0),
        "black and white": np.where(stroke, 255, 0),
        "soft edges": np.where(stroke, 255, np.where(np.roll(stroke, 1, 0), 128, 0)),
    }[paint].astype(np.uint8)
    Image.fromarray(pixels).save(tmp_path / "paint.png")
    frame = Frame(smoke, number=1)
    regions = regions_for([frame], {"image": str(tmp_path / "paint.png"), "view": [0, 0]})
    regions.masks(0, frame)
    share = np.atleast_3d(pixels).mean() / 255
    expected = (
        f"mask: paint.png has no transparency, so that what is white counts, and .*: {share:.0%} of the picture; "
    )
    assert len(regions.notes) == said
    assert all(re.match(expected, note) and "transparent layer of its own" in note for note in regions.notes)


# --- Grids -------------------------------------------------------------------------------------------------


def stored(folder: Path, **grids: Any) -> Any:
    """Two frames with other grids, in npz files; what is callable gets the frame's number."""
    folder.mkdir()
    for number in (10, 11):
        values = {name: grid(number) if callable(grid) else grid for name, grid in grids.items()}
        np.savez(folder / f"s_{number:04d}.npz", density=np.ones(SHAPE, np.float32), **values)
    return open_frames(folder)


def test_a_grid_of_the_input_is_a_mask(tmp_path: Path) -> None:
    heat = np.random.default_rng(0).random(SHAPE).astype(np.float32)
    smoke = stored(
        tmp_path / "in", heat=lambda number: heat * (number - 9), marks=(255 * (heat > 0.5)).astype(np.uint8)
    )
    regions = regions_for(smoke, "heat")
    for index, frame in enumerate(smoke):
        np.testing.assert_array_equal(regions.masks(index, frame)[0], np.minimum(heat * (index + 1), 1))
    (note,) = regions.notes
    least, largest = heat.min(), 2 * heat.max()
    assert note == (
        f"mask: grid 'heat' has values up to {largest:.4g}; above 1 they count as 1; range = [{least:.4g}, "
        f"{largest:.4g}] maps what it has to 0 to 1"
    )
    for mask in masks(smoke, "marks"):
        np.testing.assert_array_equal(mask, heat > 0.5)
    with pytest.raises(
        InputError, match=r"mask: .*s_0010.npz: no array 'cold', those found are: density, heat, marks$"
    ):
        masks(smoke, "cold")


def test_a_grid_of_a_frame_in_memory_is_a_mask() -> None:
    heat = np.random.default_rng(0).random(SHAPE).astype(np.float32)
    (mask,) = masks([Frame(np.ones(SHAPE, np.float32), name="f", grids={"heat": heat})], "heat")
    np.testing.assert_array_equal(mask, heat)
    with pytest.raises(InputError, match="mask: f: has no grid 'cold'; those beside its density are 'heat'"):
        masks([Frame(np.ones(SHAPE, np.float32), name="f", grids={"heat": heat})], "cold")


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.dtype(">u2"), bool, np.float64], ids=str)
def test_types_of_numbers_count_in_memory_as_in_files(kind: Any, tmp_path: Path) -> None:
    """Unsigned integers of 8 and 16 bits as 0 to 1, as pictures have them, before any range; others as they are."""
    largest = {1: 255, 2: 65535}[np.dtype(kind).itemsize] if np.dtype(kind).kind == "u" else 1
    marks = np.random.default_rng(3).uniform(0, largest, SHAPE).round(0 if largest > 1 else 2).astype(kind)
    in_files = stored(tmp_path / "in", marks=marks)
    in_memory = [Frame(np.ones(SHAPE), name=f"f_{n}", number=n, grids={"marks": marks}) for n in (10, 11)]
    for smoke in (in_files, in_memory, list(in_files)):
        for mask, expected in (
            ("marks", marks.astype(np.float64) / largest),
            ({"grid": "marks", "range": [0.5, 1]}, np.clip(2 * marks.astype(np.float64) / largest - 1, 0, 1)),
        ):
            np.testing.assert_allclose(masks(smoke, mask)[0], expected, atol=1e-6)


def test_files_of_masks_are_for_all_frames_or_for_each(tmp_path: Path) -> None:
    values = np.random.default_rng(1).random(SHAPE).astype(np.float32)
    np.savez(tmp_path / "one.npz", density=values, region=1 - values)
    for mask in masks(frames(2), str(tmp_path / "one.npz")):
        np.testing.assert_array_equal(mask, values)
    for mask in masks(frames(2), {"file": str(tmp_path / "one.npz"), "grid": "region"}):
        np.testing.assert_array_equal(mask, 1 - values)
    (tmp_path / "each").mkdir()
    for number in (10, 11):
        np.savez(tmp_path / "each" / f"m_{number}.npz", density=values * (number - 10) / 2)
    for found in (
        masks(frames(2), str(tmp_path / "each")),
        masks(frames(2), {"file": str(tmp_path / "each/m_##.npz")}),
    ):
        for factor, mask in enumerate(found):
            np.testing.assert_array_equal(mask, values * factor / 2)
    with pytest.raises(InputError, match="has no mask for frame 12"):
        masks(frames(3), str(tmp_path / "each"))


def test_a_range_of_values_becomes_0_to_1(tmp_path: Path) -> None:
    """Linearly, clipped beyond; either end may be the larger one; with keyframes."""
    heat = np.random.default_rng(2).uniform(-100, 1200, SHAPE).astype(np.float32)
    smoke = stored(tmp_path / "in", heat=heat)
    rising = np.clip((heat - 300) / 600, 0, 1)
    for mask in masks(smoke, {"grid": "heat", "range": [300, 900]}):
        np.testing.assert_allclose(mask, rising, atol=1e-6)
    for mask in masks(smoke, {"grid": "heat", "range": [900, 300]}):
        np.testing.assert_allclose(mask, 1 - rising, atol=1e-6)
    file = {"file": str(tmp_path / "in/s_0010.npz"), "grid": "heat"}
    found = masks(smoke, file | {"range": {10: [300, 900], 12: [100, 500]}, "invert": True})
    np.testing.assert_allclose(found[0], 1 - rising, atol=1e-6)
    np.testing.assert_allclose(found[1], 1 - np.clip((heat - 200) / 500, 0, 1), atol=1e-6)
    regions = regions_for(smoke, {"grid": "heat", "range": [0, 2]})
    assert regions.masks(0, smoke[0])[0].max() == 1 and regions.notes == []
    with pytest.raises(InputError, match=r"negative values .*; range = \[-\S+, 1\d+\] maps what it has to 0 to 1"):
        masks(smoke, "heat")
    regions = regions_for(frames(grids={"five": np.full(SHAPE, 5.0)}), "five")
    regions.masks(0, frames()[0])
    assert regions.notes[0].endswith("; range = [0, 5] maps what it has to 0 to 1"), "the same everywhere"


@pytest.mark.parametrize(("key", "others"), [("range", {"grid": "heat"}), ("height", {})])
def test_a_ramp_that_turns_between_keyframes_has_a_frame_without_one(key: str, others: dict[str, Any]) -> None:
    smoke = frames(3, grids={"heat": np.ones(SHAPE)})
    turning = others | {key: {10: [0, 2], 12: [2, 0]}}
    with pytest.raises(InputError, match=rf"^mask: {key}: is \[1, 1\] between its keyframes, expected two different"):
        masks(smoke, turning)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.ones((7, 9, 9)), r"has shape \(7, 9, 9\), expected \(7, 9, 8\) like the density"),
        (-np.ones(SHAPE), "negative values .*, expected values from 0 to 1"),
        (np.full(SHAPE, np.nan), "504 values that are not finite"),
    ],
)
def test_grids_that_are_no_masks_are_refused(values: np.ndarray, said: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "m.npz", density=values)
    with pytest.raises(InputError, match=rf"^mask: .*m.npz: .*{said}"):
        masks(frames(), str(tmp_path / "m.npz"))


VECTORS = "Cd':? holds vectors, expected one number for each cell"


@pytest.mark.parametrize("format", ["npz", "vdb", "memory"])
@pytest.mark.parametrize("single", [True, False])
@pytest.mark.parametrize(("name", "said"), [("haet", "no (array|grid) 'haet'"), ("Cd", VECTORS)])
def test_names_of_grids_that_are_no_masks(format: str, single: bool, name: str, said: str, tmp_path: Path) -> None:
    """Messages speak of the grid that was asked for, not of the density and its flag, in a file and in a folder."""
    grids = {"heat": np.ones(SHAPE, np.float32), "Cd": np.ones((*SHAPE, 3), np.float32)}
    smoke: Any = frames(1 if single else 2, grids=grids)
    if format != "memory":
        tnst_mi.save_frames(tmp_path / "in", smoke, format=format)
        smoke = open_frames(tmp_path / "in" / f"f_0.{format}" if single else tmp_path / "in")
    for mask in (name, {"grid": name}):
        with pytest.raises(InputError, match=f"^mask: .*{said}") as caught:
            masks(smoke, mask)
        assert "--density" not in str(caught.value)


def test_files_without_the_grid_of_a_mask(tmp_path: Path) -> None:
    np.savez(tmp_path / "m.npz", a=np.ones(SHAPE), b=np.ones(SHAPE), Cd=np.ones((*SHAPE, 3)))
    for mask, said in (
        ({"grid": "nope"}, "m.npz: no array 'nope', those found are: a, b, Cd$"),
        ({"grid": "Cd"}, f"m.npz: array '{VECTORS}$"),
        ({}, r"m.npz: no array 'density' \(or 'x'\), the arrays found are: a, b, Cd; choose with grid = NAME$"),
    ):
        with pytest.raises(InputError, match=said):
            masks(frames(), {"file": str(tmp_path / "m.npz")} | mask)
    tnst_mi.save_frames(tmp_path / "vol", frames(), format="vol")
    with pytest.raises(InputError, match=r"no grid 'heat', since a .vol file holds one, without a name; give the file"):
        masks(open_frames(tmp_path / "vol"), "heat")


# --- Following ---------------------------------------------------------------------------------------------


def test_a_mask_that_follows_moves_with_a_uniform_wind_exactly() -> None:
    """One cell per frame along x, and back again for frames before the one that it is of."""
    wind = np.zeros((*SHAPE, 3), np.float32)
    wind[..., 0] = 1
    smoke = frames(4, velocity=wind)
    box = {"shape": "box", "low": [3, 2, 2], "high": [4, 5, 4], "edge": 2}
    (start, *_), moved = masks(smoke, box), masks(smoke, box | {"follow": 11})
    for i, mask in enumerate(moved):
        np.testing.assert_array_equal(mask, np.roll(start, i - 1, axis=2))
    still = masks(smoke, box)
    assert all((mask == start).all() for mask in still), "it stands in the scene unless it is bound to the smoke"


@pytest.mark.parametrize("numbers", [(1, 2, 6, 7), (1, 2, 2.5, 3), (9, 7, 6, 2), (3, 1, 2, 8)])
@pytest.mark.parametrize("first", [0, 1])
def test_a_mask_that_follows_moves_by_the_difference_of_numbers(
    numbers: tuple[float, ...], first: int, weights: Path
) -> None:
    """Two cells per frame along x: across gaps, sub-frames and in descending order, forwards and back; in runs too."""
    shape = (5, 7, 40)
    wind = np.zeros((*shape, 3), np.float32)
    wind[..., 0] = 2
    smoke = [Frame(np.ones(shape), wind, name=f"f_{n}", number=n) for n in numbers]
    box = {"shape": "box", "low": [18, 2, 1], "high": [23, 5, 3], "edge": 2}
    follow: Any = True if first == 0 else numbers[first]
    alone = regions_for(smoke, box | {"follow": follow})
    recipe = {"mask": box | {"follow": follow}, "semantic": ["inception_3a/3x3:0"], "weights": str(weights)}
    of_run = prepare(smoke, Recipe.from_dict(recipe), progress=False).plan.regions
    assert of_run is not None
    (start,) = masks(smoke[:1], box)
    for i in (0, 3, 1, 2, 0):
        expected = np.roll(start, round(2 * (numbers[i] - numbers[first])), axis=2)
        for regions in (alone, of_run):
            np.testing.assert_array_equal(regions.masks(i, smoke[i])[0], expected)


def test_the_velocity_of_the_earlier_frame_leads_to_the_later_one() -> None:
    """In descending order that is the one that comes after in the sequence; the earliest frame needs no other's."""
    wind = np.zeros((*SHAPE, 3), np.float32)
    wind[..., 0] = 1
    pair = [Frame(np.ones(SHAPE), name="f_8", number=8), Frame(np.ones(SHAPE), wind, name="f_7", number=7)]
    box = {"shape": "box", "low": [3, 2, 2], "high": [5, 5, 4], "follow": True}
    start, moved = masks(pair, box)
    np.testing.assert_array_equal(moved, np.roll(start, -1, axis=2))
    with pytest.raises(InputError, match="mask: f_7: has no velocity"):
        masks([pair[0], Frame(np.ones(SHAPE), name="f_7", number=7)], box)


def test_a_mask_that_follows_turns_with_a_vortex() -> None:
    """0.15 radians per frame about the axis of the grid; its strength is that of each frame."""
    shape, count = (12, 24, 24), 7
    smoke = moving_smoke(count, shape)
    part = {"shape": "sphere", "centre": [17.5, 11.5, 5.5], "radius": 4, "edge": 2, "follow": True}
    regions = regions_for(smoke, part | {"strength": {5: 1.0, 11: 0.5}})
    found = [regions.masks(i, smoke[i])[0] for i in (0, 3, 6, 2)]
    for i, mask in zip((0, 3, 6, 2), found, strict=True):
        y, x = np.indices(shape)[1:]
        place = np.array([(mask * axis).sum() for axis in (x, y)]) / mask.sum()
        # A straight step of 0.15 radians turns by its arctangent.
        angle = i * np.arctan(0.15)
        np.testing.assert_allclose(place, [11.5 + 6 * np.cos(angle), 11.5 + 6 * np.sin(angle)], atol=0.25)
        assert 0.9 * (1 - i / 12) < mask.max() <= 1 - i / 12 + 1e-6
        assert mask.min() == 0


def test_a_mask_cannot_follow_without_velocities_or_from_nowhere() -> None:
    part = {"shape": "sphere", "centre": [3, 4, 3], "radius": 2}
    with pytest.raises(InputError, match="mask: f_0: has no velocity, which a mask that follows the smoke needs"):
        masks(frames(2), part | {"follow": True})
    with pytest.raises(InputError, match="mask: follow = 99: there is no such frame"):
        masks(frames(2), part | {"follow": 99})
    unnumbered = [Frame(np.ones(SHAPE))]
    with pytest.raises(InputError, match="mask: radius: frames without numbers cannot be keyframed"):
        masks(unnumbered, part | {"radius": {1: 2.0, 5: 3.0}})


# --- What masks reach --------------------------------------------------------------------------------------


def shares(smoke: list[Frame], recipe: dict[str, Any]) -> list[list[float]]:
    made = Recipe.from_dict(recipe)
    regions = regions_of(made, smoke, [frame.number for frame in smoke])
    assert regions is not None
    return [mask.smoke_shares for mask in measured_masks(regions, targets_of(made), smoke)]


def test_the_smoke_in_each_mask_is_measured() -> None:
    recipe = {"target": [{"style": "net", "mask": {"height": [3.5, 3.6]}}, {"tag": "spiral"}]}
    assert shares(frames(2), recipe) == [[pytest.approx(5 / 9)] * 2, [1.0, 1.0]]


def test_masks_that_change_nothing_are_refused() -> None:
    far = {"shape": "sphere", "centre": [99, 0, 0], "radius": 2}
    with pytest.raises(InputError, match=r"^target 2: mask: is 0 everywhere in all frames"):
        shares(frames(2), {"target": [{"style": "net"}, {"style": "net", "mask": far}]})
    smoke = np.zeros(SHAPE)
    smoke[0, 0, 0] = 1
    with pytest.raises(InputError, match=r"^mask: has no smoke in it in any frame"):
        shares([Frame(smoke)], {"style": "net", "mask": {"height": [2, 4]}} | {"style": ["net"]})


@pytest.mark.parametrize("up", [None, "y", "z"])
def test_shapes_without_smoke_are_told_where_it_is(up: str | None) -> None:
    """In the coordinates of the mask, over all frames: a sphere there has smoke in it."""
    placement = None if up is None else Placement(0.5, (1.0, -2.0, 0.25), up)
    smoke = np.zeros((2, *SHAPE), np.float32)
    smoke[0, 1, 2, 3] = smoke[1, 4, 7, 5] = 1
    moving = [Frame(density, name=f"f_{i}", number=i, placement=placement) for i, density in enumerate(smoke)]
    cells = [np.array((3, 2, 1)), np.array((5, 7, 4))]
    if up == "z":  # our z runs along −Y of a scene whose Z is up
        cells = [np.array((3, SHAPE[0] - 1 - 4, 2)), np.array((5, SHAPE[0] - 1 - 1, 7))]
    low, high = ((cell if placement is None else placement.corner + 0.5 * cell).tolist() for cell in cells)
    where = f"the smoke is from [{', '.join(f'{c:g}' for c in low)}] to [{', '.join(f'{c:g}' for c in high)}] in the "
    far, beside = {"shape": "sphere", "centre": [99, 0, 0], "radius": 2}, {"height": [high[1 if up != "z" else 2], 99]}
    for mask, said in (
        (far, "is 0 everywhere in all frames"),
        (beside, "has no smoke in it in any frame"),
    ):
        with pytest.raises(InputError, match=f"^mask: {said}.*; {re.escape(where)}units of the mask; check its place"):
            shares(moving, {"style": ["net"], "mask": mask})
    assert any(shares(moving, {"style": ["net"], "mask": {"shape": "box", "low": low, "high": high}})[0])


def test_other_masks_that_hold_nothing_are_told_why(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((9, 8), np.uint8)).save(tmp_path / "black.png")
    Image.fromarray(np.zeros((9, 8, 4), np.uint8)).save(tmp_path / "clear.png")
    without = [Frame(np.zeros(SHAPE), grids={"cold": np.zeros(SHAPE)})]
    cold = frames(grids={"cold": np.zeros(SHAPE)})
    for smoke, mask, said in (
        (cold, {"image": str(tmp_path / "black.png"), "view": [0, 0]}, "nothing in black.png is white, which is what"),
        (cold, {"image": str(tmp_path / "clear.png"), "view": [0, 0]}, "alpha is 0 in every pixel"),
        (cold, "cold", "is 0 everywhere in all frames; check its values and its strength"),
        (without, {"height": [0, 1]}, "has no smoke in it in any frame.*; the input has no smoke at all"),
    ):
        with pytest.raises(InputError, match=f"^mask: .*{said}"):
            shares(smoke, {"style": ["net"], "mask": mask})


def test_boxes_have_their_low_below_their_high() -> None:
    """In every frame, keyframes included; one cell thick is allowed."""
    box = {"shape": "box", "low": [1, 3, 1], "high": {10: [4, 3, 3], 12: [4, 1, 3]}}
    said = r"^mask: low = \[1.0, 3.0, 1.0\] is above high = \[4.0, 2.0, 3.0\] along y, expected the lower first"
    assert masks(frames(1), box)[0].any()
    with pytest.raises(InputError, match=said):
        masks(frames(2), box)

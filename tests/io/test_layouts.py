"""Arrays in the layouts of many programs come out as one frame; what fits none is refused with its shape."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames, open_frames
from tnst_mi.io.formats import describe
from tnst_mi.io.interpretation.conventions import Conventions
from tnst_mi.io.interpretation.layouts import scalar_grid, solid_cells, velocity_grid, velocity_of_components
from tnst_mi.io.interpretation.roles import Wanted
from tnst_mi.io.interpretation.staggered import velocity_of_all_faces

SHAPE = (3, 5, 4)
RNG = np.random.default_rng(0)
DENSITY = RNG.random(SHAPE).astype(np.float32)
VELOCITY = RNG.normal(size=(*SHAPE, 3)).astype(np.float32)

shapes = st.tuples(*(st.integers(1, 5),) * 3)


def frame_of(path: Path, **arrays: np.ndarray) -> Frame:
    np.savez(path / "a.npz", **arrays)
    return load_frames(path / "a.npz")[0]


@pytest.mark.parametrize(
    "stored",
    [
        DENSITY[None],
        DENSITY[..., None],
        DENSITY[None, ..., None],
        DENSITY[None, None],
        np.asfortranarray(DENSITY),
        DENSITY.astype(">f8"),
    ],
)
def test_densities_in_every_layout(stored: np.ndarray, tmp_path: Path) -> None:
    for name in ("density", "Density", "arr_0", "x", "data"):
        np.testing.assert_array_equal(frame_of(tmp_path, **{name: stored}).density, DENSITY)
    np.save(tmp_path / "a.npy", stored)
    np.testing.assert_array_equal(load_frames(tmp_path / "a.npy")[0].density, DENSITY)


@given(shapes, st.booleans(), st.booleans())
def test_axes_of_one_entry_are_dropped(shape: tuple[int, int, int], batch: bool, channel: bool) -> None:
    grid = np.arange(np.prod(shape)).reshape(shape)
    stored = grid[None] if batch else grid
    read, words = scalar_grid(stored[..., None] if channel else stored, "density")
    np.testing.assert_array_equal(read.ravel(), grid.ravel())
    assert read.ndim == 3 and (words == "") == (not batch and not channel)


def test_a_plane_is_seen_face_on(tmp_path: Path) -> None:
    flow = VELOCITY[0, ..., :2]
    for velocity in (flow, flow[None], np.moveaxis(flow, -1, 0), VELOCITY[:1] * [1, 1, 0]):
        frame = frame_of(tmp_path, density=DENSITY[0], velocity=velocity.astype(np.float32))
        np.testing.assert_array_equal(frame.density, DENSITY[:1])
        np.testing.assert_array_equal(frame.velocity[..., :2], flow[None])
        assert not frame.velocity[..., 2].any() and "is a plane seen face-on" in frame.reading
    frame = frame_of(tmp_path, density=DENSITY[0], u=flow[..., 0], v=flow[..., 1])
    np.testing.assert_array_equal(frame.velocity[..., :2], flow[None])


@pytest.mark.parametrize(
    ("stored", "words"),
    [
        (VELOCITY, ""),
        (VELOCITY[None], "velocity (1, 3, 5, 4, 3) has axes of one entry"),
        (np.moveaxis(VELOCITY, -1, 0), "velocity (3, 3, 5, 4): components first"),
        (np.moveaxis(VELOCITY, -1, 0)[None], "velocity (1, 3, 3, 5, 4): components first"),
    ],
)
def test_velocities_at_centres_in_every_layout(stored: np.ndarray, words: str, tmp_path: Path) -> None:
    # Of (3, 3, 5, 4) only the shape of the density tells which axis holds the components.
    frame = frame_of(tmp_path, density=DENSITY, vel=stored)
    np.testing.assert_array_equal(frame.velocity, VELOCITY)
    assert "velocity at centres" in frame.reading and words in frame.reading


@given(shapes, st.booleans())
def test_faces_with_one_more_entry_than_cells(shape: tuple[int, int, int], first: bool) -> None:
    assume(not (first and shape == (2, 2, 2)))  # (3, 3, 3, 3) is read with its components last
    # Component c is c + 1 times the position of its face, so at a centre it is that of the centre.
    places = np.stack(np.meshgrid(*(np.arange(extent + 1.0) for extent in shape), indexing="ij"), axis=-1)
    faces = places[..., ::-1] * [1, 2, 3]
    read, words = velocity_grid(np.moveaxis(faces, -1, 0) if first else faces, shape)
    assert "faces" in words
    centres = (places[:-1, :-1, :-1, ::-1] + 0.5) * [1, 2, 3]
    np.testing.assert_allclose(velocity_of_all_faces(read), centres)


@pytest.mark.parametrize("own", [True, False])
def test_components_on_faces(own: bool, tmp_path: Path) -> None:
    depth, height, width = SHAPE
    grown = [
        (depth, height, width + 1) if own else (depth + 1, height + 1, width + 1),
        (depth, height + 1, width) if own else (depth + 1, height + 1, width + 1),
        (depth + 1, height, width) if own else (depth + 1, height + 1, width + 1),
    ]
    names, axes = ("vel_x", "vel_y", "vel_z"), (2, 1, 0)
    faces = {
        name: np.broadcast_to(np.moveaxis(np.arange(float(shape[axis])).reshape(-1, 1, 1), 0, axis), shape)
        for name, axis, shape in zip(names, axes, grown, strict=True)
    }
    frame = frame_of(tmp_path, density=DENSITY, **faces)
    z, y, x = np.meshgrid(*(np.arange(extent) + 0.5 for extent in SHAPE), indexing="ij")
    np.testing.assert_allclose(frame.velocity, np.stack([x, y, z], axis=-1))
    assert "velocity on faces" in frame.reading


def test_components_at_centres(tmp_path: Path) -> None:
    frame = frame_of(tmp_path, density=DENSITY, **{name: VELOCITY[..., c] for c, name in enumerate("uvw")})
    np.testing.assert_array_equal(frame.velocity, VELOCITY)
    named = Conventions(names=Wanted(velocity="w,v,u"))
    np.testing.assert_array_equal(open_frames(tmp_path / "a.npz", given=named)[0].velocity, VELOCITY[..., ::-1])


@pytest.mark.parametrize(("dtype", "largest"), [(np.uint8, 255), (">u2", 65535)])
def test_whole_numbers_of_pictures_are_shares_of_one(dtype: str, largest: int, tmp_path: Path) -> None:
    stored = (DENSITY * largest).astype(dtype)
    frame = frame_of(tmp_path, density=stored)
    np.testing.assert_allclose(frame.density, stored / largest, rtol=1e-6)
    assert (
        f"density times 1/{largest} ({np.dtype(dtype).newbyteorder('=').name}, as in pictures; --scale)"
        in frame.reading
    )
    scaled = open_frames(tmp_path / "a.npz", given=Conventions(scale=2.0))[0]
    np.testing.assert_allclose(scaled.density, 2.0 * stored, rtol=1e-6)


@pytest.mark.parametrize(
    ("values", "solid"),
    [
        ([0, 1, 1], [0, 1, 1]),
        ([0.0, 0.4, 0.6], [0, 0, 1]),
        (np.uint8([0, 255, 0]), [0, 1, 0]),
        ([0.0, 255.0, 0.0], [0, 1, 0]),
        (np.uint8([0, 100, 200]), [0, 0, 1]),
        (np.array([True, False, False]), [1, 0, 0]),
    ],
)
def test_obstacles(values: object, solid: list[int]) -> None:
    np.testing.assert_array_equal(solid_cells(np.asarray(values))[0], np.array(solid, bool))


def test_values_that_are_no_obstacle() -> None:
    for values in ([0, 2], [-1.0, 1.0], [np.nan, 1.0], [0.0, 100.0, 255.0]):
        with pytest.raises(InputError, match=r"obstacle has values from .* --obstacle none goes"):
            solid_cells(np.asarray(values))
    np.testing.assert_array_equal(
        solid_cells(np.array([0, 1, 2, 3, 18]), flags=True)[0], [False, False, True, True, True]
    )


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        (
            {"density": np.ones((2, *SHAPE))},
            r"density has shape \(2, 3, 5, 4\), expected \(D, H, W\), one frame a file",
        ),
        ({"density": np.ones(5)}, r"density has shape \(5,\), expected"),
        ({"density": DENSITY, "velocity": np.ones(SHAPE)}, r"velocity has shape \(3, 5, 4\), .* --velocity none goes"),
        (
            {"density": DENSITY, "vel": np.ones((2, 5, 4, 3))},
            r"velocity has shape \(2, 5, 4, 3\), expected \(3, 5, 4, 3\)",
        ),
        (
            {"density": DENSITY, "u": DENSITY, "v": DENSITY, "w": DENSITY[1:]},
            r"velocity components have shapes u \(3, 5, 4\), v \(3, 5, 4\), w \(2, 5, 4\), expected",
        ),
        ({"density": DENSITY, "obstacle": np.ones((5, 4))}, r"obstacle has shape \(5, 4\), expected \(3, 5, 4\)"),
        ({"density": np.array([{}], object)}, "array 'density' holds pickled objects, which are never unpickled"),
        ({"density": np.array([["a"]])}, "array 'density' holds <U1, expected numbers"),
        ({"arr_0": DENSITY, "arr_1": DENSITY}, "the arrays found are: arr_0, arr_1; choose with --density NAME"),
    ],
)
def test_what_fits_no_layout_is_refused(arrays: dict[str, np.ndarray], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"a\.npz: .*{message}") as error:
        frame_of(tmp_path, **arrays)
    assert len(str(error.value).removeprefix(str(tmp_path))) <= 300 and "\n" not in str(error.value)


def test_a_misfit_can_be_left_out(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", density=DENSITY, velocity=np.ones(SHAPE), obstacle=np.full(SHAPE, 7))
    without = Conventions(names=Wanted(velocity="none", obstacle="none"))
    frame = open_frames(tmp_path / "a.npz", given=without)[0]
    assert frame.velocity is None and frame.obstacle is None
    assert "not read: velocity, obstacle" in frame.reading


def test_components_that_do_not_fit() -> None:
    with pytest.raises(InputError, match="expected"):
        velocity_of_components([DENSITY, DENSITY, DENSITY[:, 1:]], "uvw", SHAPE)


def test_flags_that_are_no_flags() -> None:
    for values in ([np.nan, 1.0], [np.inf, 0.0], [1e20, 0.0]):
        with pytest.raises(InputError, match="obstacle has values from"):
            solid_cells(np.array(values), flags=True)
    assert solid_cells(np.empty((0, 3)))[0].shape == (0, 3)


def test_planes_do_not_make_planes_of_volumes(tmp_path: Path) -> None:
    """In a grid three cells thick, each component has the shape of vectors in a plane; a matrix says nothing."""
    density = DENSITY[..., :3]
    parts = {name: VELOCITY[..., :3, c] for c, name in enumerate("uvw")}
    frame = frame_of(tmp_path, density=density, matrix=np.eye(4), **parts)
    np.testing.assert_array_equal(frame.velocity, VELOCITY[..., :3, :])


def test_arrays_are_described_with_their_ranges(tmp_path: Path) -> None:
    arrays = {"density": DENSITY, "mask": DENSITY > 0.5, "flux": np.array([1.0, np.nan]), "name": np.array("smoke")}
    np.savez(tmp_path / "a.npz", **arrays, empty=np.empty((0, 3)))
    assert [f"  {contents}" for contents in describe(tmp_path / "a.npz")] == [
        f"  array 'density': float32, shape (3, 5, 4), {DENSITY.min():g} to {DENSITY.max():g}",
        "  array 'mask': bool, shape (3, 5, 4), 0 to 1",
        "  array 'flux': float64, shape (2,), 1 to 1, 1 NaN or infinite",
        "  array 'name': <U5, shape ()",
        "  array 'empty': float64, shape (0, 3)",
    ]


def test_members_that_numpy_does_not_write_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", density=DENSITY)
    with zipfile.ZipFile(tmp_path / "a.npz", "a", zipfile.ZIP_LZMA) as archive:
        archive.writestr("notes.npy", b"\x93NUMPY")
    with pytest.raises(InputError, match=r"a\.npz: array 'notes' is compressed in another way than numpy does"):
        describe(tmp_path / "a.npz")


def test_companions_are_laid_out_like_arrays_of_one_file(tmp_path: Path) -> None:
    for folder, save in (("npz", np.savez), ("npy", np.save)):
        (tmp_path / folder).mkdir()
        save(tmp_path / folder / f"density_0001.{folder}", DENSITY[None])
        save(tmp_path / folder / f"vel_0001.{folder}", np.moveaxis(VELOCITY, -1, 0))
        save(tmp_path / folder / f"obstacle_0001.{folder}", np.uint8(255 * (DENSITY > 0.5)))
        (frame,) = load_frames(tmp_path / folder)
        np.testing.assert_array_equal(frame.density, DENSITY)
        np.testing.assert_array_equal(frame.velocity, VELOCITY)
        np.testing.assert_array_equal(frame.obstacle, DENSITY > 0.5)
        assert f"velocity from vel_####.{folder}, obstacle from obstacle_####.{folder}" in frame.reading
        without = Conventions(names=Wanted(velocity="none", obstacle="none"))
        frame = open_frames(tmp_path / folder, given=without)[0]
        assert frame.velocity is None and frame.obstacle is None
        save(tmp_path / folder / f"vel_0001.{folder}", DENSITY[1:])
        with pytest.raises(InputError, match=rf"vel_0001\.{folder}: velocity has shape \(2, 5, 4\), expected"):
            load_frames(tmp_path / folder)

"""Faults that simulations leave in their files: rounding errors below 0, velocities that are no numbers, planes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames, open_frames
from tnst_mi.io.grids.uni import MAC, REAL, VECTOR, write_uni
from tnst_mi.io.interpretation.conventions import Conventions
from tnst_mi.io.interpretation.orientation import from_z_up
from tnst_mi.io.interpretation.roles import Wanted

SHAPE = (3, 5, 4)
RNG = np.random.default_rng(0)


@pytest.mark.parametrize("largest", [1e-8, 1.0, 1e30])
def test_negative_noise_is_taken_as_zero(largest: float) -> None:
    density = largest * RNG.random(SHAPE).astype(np.float32)
    density[0, 0, 0] = largest
    density[1, 2, 3] = -0.9e-6 * largest
    frame = Frame(density)
    np.testing.assert_array_equal(frame.density, np.maximum(density, 0.0))
    (note,) = frame.notes
    assert note.text == "negative noise in the density is taken as 0" and note.detail.startswith("1 cell down to -")
    density[1, 2, 3] = -1.1e-6 * largest
    with pytest.raises(InputError, match=r"1 negative values \(smallest .* at \(z, y, x\) = \(1, 2, 3\)\), expected"):
        Frame(density)


def test_noise_without_smoke_is_no_noise() -> None:
    with pytest.raises(InputError, match="1 negative values"):
        Frame(np.array([[[0.0, -1e-9]]]))


def test_velocities_that_are_no_numbers_do_not_matter_without_smoke() -> None:
    density = np.ones(SHAPE, np.float32)
    density[0], density[1, 0, 0] = 0.0, 1e-7
    velocity = RNG.normal(size=(*SHAPE, 3)).astype(np.float32)
    velocity[0, 1, 1], velocity[1, 0, 0, 2], velocity[0, 0, 0, 0] = np.nan, np.inf, -np.inf
    frame = Frame(density, velocity)
    expected = velocity.copy()
    expected[0, 1, 1] = expected[1, 0, 0] = expected[0, 0, 0] = 0.0
    np.testing.assert_array_equal(frame.velocity, expected)
    assert [(note.text, note.detail) for note in frame.notes] == [
        ("velocities without smoke that are no numbers are taken as 0", "3 cells")
    ]
    velocity[2, 3, 1, 0] = np.nan
    with pytest.raises(
        InputError, match=r"velocity has 1 NaN or infinite values \(the first at \(z, y, x\) = \(2, 3, 1\)"
    ):
        Frame(density, velocity)


def test_a_density_that_is_no_number_is_refused_with_its_cell() -> None:
    density = np.ones(SHAPE, np.float32)
    density[2, 4, 3] = density[1, 0, 2] = np.nan
    with pytest.raises(InputError, match=r"density has 2 NaN .* \(the first at \(z, y, x\) = \(1, 0, 2\)\)"):
        Frame(density)


def test_what_is_given_is_not_changed() -> None:
    density = np.array([[[1.0, -1e-9]]], np.float32)
    velocity = np.array([[[[1.0, 2.0, 3.0], [np.nan, 0.0, 0.0]]]], np.float32)
    Frame(density, velocity)
    assert density[0, 0, 1] < 0.0 and np.isnan(velocity[0, 0, 1, 0])


def test_a_plane_of_mantaflow_is_seen_face_on(tmp_path: Path) -> None:
    density = RNG.random((1, 6, 4)).astype(np.float32)
    x, y = np.meshgrid(np.arange(4.0), np.arange(6.0), indexing="xy")
    faces = np.stack([x, 10 * y, 0 * x], axis=-1)[None].astype(np.float32)
    write_uni(tmp_path / "density_0001.uni", density, REAL, "Mantaflow")
    write_uni(tmp_path / "vel_0001.uni", faces, VECTOR | MAC, "Mantaflow")
    (frame,) = load_frames(tmp_path)
    np.testing.assert_array_equal(frame.density, density)
    centres = np.stack([x + 0.5, 10 * (y + 0.5)], axis=-1)[:-1, :-1]
    np.testing.assert_allclose(frame.velocity[0, :-1, :-1, :2], 0.1 * centres, rtol=1e-6)
    assert not frame.velocity[..., 2].any() and "a plane, seen face-on" in frame.reading
    turned = open_frames(tmp_path, given=Conventions(up="z"))[0]
    np.testing.assert_array_equal(turned.density, from_z_up(density))


def test_the_duration_of_a_frame_follows_from_the_rate(tmp_path: Path) -> None:
    density, faces = np.ones((4, 6, 5), np.float32), np.ones((4, 6, 5, 3), np.float32)
    write_uni(tmp_path / "density_0001.uni", density, REAL, "Mantaflow")
    write_uni(tmp_path / "vel_0001.uni", faces, VECTOR, "Mantaflow")
    np.savez(tmp_path / "a.npz", density=density, velocity=faces)
    lengths = Conventions(velocity_units="length-per-time", voxel_size=0.5)
    for path, given, expected in (
        ("density_0001.uni", Conventions(fps=30.0), 0.1 * 25 / 30),
        ("density_0001.uni", Conventions(fps=30.0, dt=0.5), 0.5),
        ("a.npz", Conventions(fps=30.0), 1.0),  # cells per frame are what they are
        ("a.npz", Conventions("y", "", "length-per-time", None, 30.0, 0.5), 1 / 30 / 0.5),
        ("a.npz", lengths, 1 / 24 / 0.5),
    ):
        frame = open_frames(tmp_path / path, given=given)[0]
        np.testing.assert_allclose(np.abs(frame.velocity[..., 0]), expected, rtol=1e-6)


def test_places_move_with_the_origin_of_the_files(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", density=np.ones(SHAPE))
    frame = open_frames(tmp_path / "a.npz", given=Conventions(voxel_size=0.5, origin=(1.0, -2.0, 3.0)))[0]
    assert frame.placement.corner == (1.0, -2.0, 3.0)


def test_grids_in_files_of_their_own_are_named_by_words(tmp_path: Path) -> None:
    density, faces = RNG.random((4, 6, 5)).astype(np.float32), np.ones((4, 6, 5, 3), np.float32)
    write_uni(tmp_path / "f_0001.uni", density, REAL, "Mantaflow")
    write_uni(tmp_path / "f_wind_0001.uni", faces, VECTOR, "Mantaflow")
    write_uni(tmp_path / "f_vel_0001.uni", 2 * faces, VECTOR, "Mantaflow")
    file = tmp_path / "f_0001.uni"

    def read(**names: str) -> Frame:
        return open_frames(file, given=Conventions(velocity_units="cells-per-frame", names=Wanted(**names)))[0]

    assert np.abs(read().velocity).max() == 2.0 and np.abs(read(velocity="wind").velocity).max() == 1.0
    assert read(velocity="none").velocity is None
    with pytest.raises(InputError, match=r"f_0001\.uni: --velocity 'flow': no file f_flow_0001\.uni beside it"):
        read(velocity="flow")
    with pytest.raises(InputError, match=r"--density 'heat': a \.uni file holds one grid; give the density's as INPUT"):
        read(density="heat")

"""OpenVDB files of other programs: grids of one name, velocities in three grids, other names and types, up axes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames, open_frames, save_frames
from tnst_mi.io.grids.vdb import DenseGrid, read_vdb, write_vdb
from tnst_mi.io.grids.vdb.programs import program_of
from tnst_mi.io.interpretation.conventions import Boxing, Conventions
from tnst_mi.io.interpretation.orientation import from_z_up
from tnst_mi.io.interpretation.roles import Wanted

SHAPE = (3, 5, 4)
RNG = np.random.default_rng(0)
DENSITY = RNG.random(SHAPE).astype(np.float32) + 0.1
VELOCITY = RNG.normal(size=(*SHAPE, 3)).astype(np.float32)

#: Between the name of a grid and the number that makes it unique.
SEPARATOR = "\x1e"


def frame_of(path: Path, *grids: DenseGrid, given: Conventions | None = None) -> Frame:
    write_vdb(path / "a.vdb", grids, {})
    return open_frames(path / "a.vdb", given=given)[0]


def components(offset: float = 0.0) -> list[DenseGrid]:
    """vel.x, vel.y and vel.z, each placed lower along its own axis by a share of its voxels of 0.5."""
    places = -0.5 * offset * np.eye(3)
    return [
        DenseGrid(f"vel.{axis}", np.ascontiguousarray(VELOCITY[..., c]), (0, 0, 0), 0.5, tuple(places[c].tolist()))
        for c, axis in enumerate("xyz")
    ]


@pytest.mark.parametrize(
    "names", [("density", f"density{SEPARATOR}1"), ("density", "density"), ("density[0]", "density[1]")]
)
def test_grids_of_one_name_are_merged_where_they_do_not_overlap(names: tuple[str, str], tmp_path: Path) -> None:
    left, right = DENSITY.copy(), DENSITY.copy()
    left[..., 2:], right[..., :2] = 0.0, 0.0
    frame = frame_of(tmp_path, DenseGrid(names[0], left), DenseGrid(names[1], right))
    np.testing.assert_array_equal(frame.density, DENSITY)
    right[0, 0, 0] = 0.5
    with pytest.raises(InputError, match=r"a\.vdb: 2 grids are called .* and overlap in 1 voxels; choose one of them"):
        frame_of(tmp_path, DenseGrid(names[0], left), DenseGrid(names[1], right))
    second = Conventions(names=Wanted(density="density[1]"))
    frame = frame_of(tmp_path, DenseGrid(names[0], left), DenseGrid(names[1], right), given=second)
    assert frame.mass == pytest.approx(right.sum())


def test_the_flag_that_chooses_is_that_of_the_quantity(tmp_path: Path) -> None:
    density = DenseGrid("density", DENSITY, (0, 0, 0), 0.5)
    pair = [DenseGrid("vel", VELOCITY, (0, 0, 0), edge) for edge in (0.5, 0.5)]
    with pytest.raises(InputError, match=r"2 grids are called 'vel' and overlap .* such as with --velocity 'vel\[0\]'"):
        frame_of(tmp_path, density, *pair)
    with pytest.raises(InputError, match=r"2 grids are called 'vel' and have different .* --velocity 'vel\[0\]'"):
        frame_of(tmp_path, density, pair[0], DenseGrid("vel", VELOCITY, (0, 0, 0), 0.25))
    solid = [DenseGrid("solid", np.ones(SHAPE, np.float32), (0, 0, 0), 0.5)] * 2
    with pytest.raises(InputError, match=r"2 grids are called 'solid' and overlap .* --obstacle 'solid\[0\]'"):
        frame_of(tmp_path, density, *solid)


def test_grids_of_a_cluster_have_translations_of_their_own(tmp_path: Path) -> None:
    # The first voxel of the right half is (5, -5, -1) of its own grid, and (2, 0, 0) of the left one.
    whole = DenseGrid("density", DENSITY, (0, 0, 0), 0.5)
    moved, translation = (5, -5, -1), (-1.5, 2.5, 0.5)
    parts = []
    for name, array in (("density", DENSITY), ("vel", VELOCITY), ("solid", (DENSITY > 0.6).astype(np.float32))):
        left, right = np.ascontiguousarray(array[:, :, :2]), np.ascontiguousarray(array[:, :, 2:])
        parts += [DenseGrid(name, left, (0, 0, 0), 0.5), DenseGrid(name, right, moved, 0.5, translation)]
    frame = frame_of(tmp_path, *parts)
    velocity = DenseGrid("vel", VELOCITY, (0, 0, 0), 0.5)
    solid = DenseGrid("solid", (DENSITY > 0.6).astype(np.float32), (0, 0, 0), 0.5)
    expected = frame_of(tmp_path, whole, velocity, solid)
    np.testing.assert_array_equal(frame.density, expected.density)
    np.testing.assert_array_equal(frame.velocity, expected.velocity)
    np.testing.assert_array_equal(frame.obstacle, expected.obstacle)
    assert frame.placement == expected.placement
    # Cropping knows where the parts are.
    cropped = frame_of(tmp_path, *parts, given=Conventions(box=Boxing(crop=True)))
    np.testing.assert_array_equal(cropped.density, DENSITY)
    # Parts that overlap, or lie between each other's voxels, are asked about.
    over = DenseGrid("density", DENSITY, (5, -5, -1), 0.5, (-2.0, 2.5, 0.5))
    with pytest.raises(InputError, match="overlap in 45 voxels"):
        frame_of(tmp_path, whole, over)
    with pytest.raises(InputError, match="have different voxels"):
        frame_of(tmp_path, whole, DenseGrid("density", DENSITY, (9, 0, 0), 0.5, (0.1, 0.0, 0.0)))


def test_three_scalars_are_a_velocity_at_centres(tmp_path: Path) -> None:
    frame = frame_of(tmp_path, DenseGrid("density", DENSITY, (0, 0, 0), 0.5), *components()[::-1])
    np.testing.assert_allclose(frame.velocity, VELOCITY / (24 * 0.5), rtol=1e-6)
    assert "velocity at centres in length-per-time" in frame.reading
    assert "velocity from 'vel.x', 'vel.y', 'vel.z'" in frame.reading


def test_three_scalars_half_a_voxel_lower_lie_on_faces(tmp_path: Path) -> None:
    frame = frame_of(tmp_path, DenseGrid("density", DENSITY, (0, 0, 0), 0.5), *components(0.5))
    up = (VELOCITY[:, :-1, :, 1] + VELOCITY[:, 1:, :, 1]) / (2 * 24 * 0.5)
    np.testing.assert_allclose(frame.velocity[:, :-1, :, 1], up, rtol=1e-5, atol=1e-7)
    assert "velocity on faces" in frame.reading


def test_components_elsewhere_are_interpolated(tmp_path: Path) -> None:
    frame = frame_of(tmp_path, DenseGrid("density", DENSITY, (0, 0, 0), 0.5), *components(0.3))
    own = frame_of(tmp_path, DenseGrid("density", DENSITY, (0, 0, 0), 0.5), *components(0.0))
    assert frame.velocity is not None and own.velocity is not None
    inner = own.velocity[1:-1, 1:-1, 1:-1]
    assert np.abs(frame.velocity[1:-1, 1:-1, 1:-1] - inner).max() > 0.0


def test_a_lone_grid_is_taken_if_it_is_smoke_by_name(tmp_path: Path) -> None:
    assert "density from 'Smoke '" in frame_of(tmp_path, DenseGrid("Smoke ", DENSITY)).reading
    for name in ("temperature", ""):
        with pytest.raises(
            InputError, match=rf"no grid 'density', the grids found are: '{name}'; choose with --density"
        ):
            frame_of(tmp_path, DenseGrid(name, DENSITY))
        chosen = frame_of(tmp_path, DenseGrid(name, DENSITY), given=Conventions(names=Wanted(density=name)))
        np.testing.assert_array_equal(chosen.density, DENSITY)


def test_what_is_left_is_said(tmp_path: Path) -> None:
    grids = [DenseGrid(name, DENSITY) for name in ("density", "heat", "vel.x", "vel.y")]
    assert frame_of(tmp_path, *grids, DenseGrid("Cd", VELOCITY)).reading.endswith(
        "density from 'density', no velocity, no obstacle; other grids: 'heat', 'vel.x', 'vel.y', 'Cd'"
    )


def test_grids_of_other_types_are_named(tmp_path: Path) -> None:
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", DENSITY)], {})
    whole = (tmp_path / "a.vdb").read_bytes()
    (tmp_path / "a.vdb").write_bytes(whole.replace(b"Tree_float_5_4_3", b"Tree_int64_5_4_3"))
    with pytest.raises(InputError, match=r"a\.vdb: grid 'density' holds int64, expected numbers; export it as such"):
        load_frames(tmp_path / "a.vdb")
    with pytest.raises(
        InputError, match=r"grid 'velocity' holds float, expected vectors; --velocity none goes without"
    ):
        frame_of(tmp_path, DenseGrid("density", DENSITY), DenseGrid("velocity", DENSITY))
    with pytest.raises(InputError, match="grid 'density' holds vec3s, expected numbers"):
        frame_of(tmp_path, DenseGrid("density", VELOCITY))


@pytest.mark.parametrize(
    ("metadata", "up"),
    [
        ({}, "y"),
        ({"creator": ("string", "Houdini/GEO_VDBTranslator")}, "y"),
        ({"creator": ("string", "EmberGen 1.2")}, "z"),
        ({"JangaFX_version": ("int32", 3)}, "z"),
        ({"creator": ("string", "Blender/OpenVDB")}, "z"),
        ({"software": ("string", "LiquiGen")}, "z"),
        ({"Application": ("string", "JangaFX EmberGen 1.2 (build 7)")}, "z"),
        # Who wrote it comes first; what paths and comments mention tells nothing.
        ({"creator": ("string", "Houdini/GU_PrimVDB"), "software": ("string", "Blender 4.2")}, "y"),
        ({"creator": ("string", "OpenVDB"), "software": ("string", "Blender 4.2")}, "z"),
        ({"creator": ("string", "Houdini/GU_PrimVDB"), "export_path": ("string", "/proj/to_blender/a.vdb")}, "y"),
        ({"export_path": ("string", "/proj/blender/a.vdb"), "comment": ("string", "for Blender and EmberGen")}, "y"),
        ({"creator": ("string", "/opt/blender/to_vdb.py")}, "y"),
        ({"blender_export_path": ("string", "/proj/a.vdb")}, "y"),
        # What says the axis itself goes before programs.
        ({"creator": ("string", "Houdini/GU_PrimVDB"), "up_axis": ("string", "Z")}, "z"),
        ({"creator": ("string", "EmberGen 1.2"), "upAxis": ("string", "Y-up")}, "y"),
        ({"up": ("string", "+z")}, "z"),
        ({"up_vector": ("vec3s", (0.0, 0.0, 1.0))}, "z"),
        ({"tnst_mi_up": ("string", "z"), "up_axis": ("string", "y")}, "z"),
    ],
)
def test_the_axis_that_is_up_follows_from_metadata(
    metadata: dict[str, tuple[str, str | int | tuple[float, ...]]], up: str, tmp_path: Path
) -> None:
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", DENSITY)], metadata)
    (frame,) = load_frames(tmp_path / "a.vdb")
    np.testing.assert_array_equal(frame.density, from_z_up(DENSITY) if up == "z" else DENSITY)
    assert frame.placement.up == up and frame.reading.startswith(f"{up} up")
    assert "tnst_mi_up" in metadata or "; --up)" in frame.reading
    other = open_frames(tmp_path / "a.vdb", given=Conventions(up="z" if up == "y" else "y"))[0]
    np.testing.assert_array_equal(other.density, DENSITY if up == "z" else from_z_up(DENSITY))


@pytest.mark.parametrize(
    ("key", "value", "because"),
    [
        ("up_axis", "Z", "as its up_axis says"),
        ("up_axis", "-Z", "its up_axis is neither y nor z"),
        ("upAxis", "X", "its upAxis is neither y nor z"),
        ("updated", "Z", "no metadata say otherwise"),
    ],
)
def test_what_is_said_of_the_axis_is_true(key: str, value: str, because: str, tmp_path: Path) -> None:
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", DENSITY)], {key: ("string", value)})
    assert f"({because}; --up)" in load_frames(tmp_path / "a.vdb")[0].reading


def test_one_axis_is_up_in_a_sequence(tmp_path: Path) -> None:
    # Extents that differ once they are turned must not be named as the cause.
    for number, creator in enumerate(("EmberGen 1.2", "Houdini/GU_PrimVDB"), start=1):
        write_vdb(tmp_path / f"s_{number:04d}.vdb", [DenseGrid("density", DENSITY)], {"creator": ("string", creator)})
    expected = (
        r"s_0001.vdb has z up \(as EmberGen's metadata say\) and s_0002.vdb has y up \(as Houdini's metadata say\), "
        "expected one axis in all files of a sequence; give --up y or --up z"
    )
    with pytest.raises(InputError, match=expected):
        load_frames(tmp_path)
    for up, density in (("y", DENSITY), ("z", from_z_up(DENSITY))):
        for frame in open_frames(tmp_path, given=Conventions(up=up)):
            np.testing.assert_array_equal(frame.density, density)


def test_files_without_voxels_have_no_axis_of_their_own(tmp_path: Path) -> None:
    smoke, nothing = DenseGrid("density", DENSITY), DenseGrid("density", 0 * DENSITY)
    for number, grids in enumerate(([nothing], [], [smoke])):
        metadata = {"creator": ("string", "EmberGen 1.2")} if number == 2 else {}
        write_vdb(tmp_path / f"s_{number:04d}.vdb", grids, metadata)
    frames = load_frames(tmp_path)
    assert [frame.density.shape for frame in frames] == [from_z_up(DENSITY).shape] * 3
    assert all(frame.reading.startswith("z up (as EmberGen's metadata say") for frame in frames)


def test_metadata_of_any_grid_count(tmp_path: Path) -> None:
    write_vdb(tmp_path / "a.vdb", [DenseGrid("heat", DENSITY), DenseGrid("density", DENSITY)], {})
    file = read_vdb(tmp_path / "a.vdb")
    marked = replace(file.grids[0], stored={"embergen_version": ("string", b"0.5.5.2")})
    assert program_of(file, file.grids[1]).up == "y"
    assert program_of(replace(file, grids=[marked, file.grids[1]]), file.grids[1]).up == "z"


def test_obstacles_are_masks_shares_or_insides(tmp_path: Path) -> None:
    density, inside = DenseGrid("density", DENSITY), RNG.random(SHAPE).astype(np.float32)
    for stored, name in ((inside, "obstacle"), (np.where(inside > 0.5, 2.0, 1.0).astype(np.float32), "flags")):
        frame = frame_of(tmp_path, density, DenseGrid(name, stored))
        np.testing.assert_array_equal(frame.obstacle, inside > 0.5)
    with pytest.raises(InputError, match=r"a\.vdb: obstacle has values from .* expected a mask of 0 and 1; --obstacle"):
        frame_of(tmp_path, density, DenseGrid("collision", -inside))


def test_frames_of_a_sequence_may_be_empty_or_lack_their_density(tmp_path: Path) -> None:
    smoke = DenseGrid("density", DENSITY, (2, 1, 0))
    for number, grids in enumerate(([DenseGrid("density", 0 * DENSITY)], [smoke], [DenseGrid("heat", DENSITY)], [])):
        write_vdb(tmp_path / f"f_{number}.vdb", grids, {})
    frames = load_frames(tmp_path)
    assert [frame.density.shape for frame in frames] == [SHAPE] * 4
    assert [frame.mass > 0.0 for frame in frames] == [False, True, False, False]
    assert [note.text for frame in frames for note in frame.notes] == [
        "no smoke in it",
        "has no density, so it is taken as a frame without smoke",
        "has no density, so it is taken as a frame without smoke",
    ]
    assert "other grids: 'heat'" in frames[2].reading


def test_the_velocity_of_a_frame_without_density_is_kept(tmp_path: Path) -> None:
    save_frames(tmp_path, [Frame(DENSITY, VELOCITY, name=f"f_{number}", number=number) for number in (1, 2)], "vdb")
    write_vdb(tmp_path / "f_2.vdb", [DenseGrid("velocity", VELOCITY)], {})
    second = open_frames(tmp_path, given=Conventions(up="y", velocity_units="cells-per-frame"))[1]
    assert second.mass == 0.0 and second.velocity is not None


def test_only_frames_without_density_are_refused(tmp_path: Path) -> None:
    for number in (1, 2):
        write_vdb(tmp_path / f"f_{number}.vdb", [DenseGrid("velocity", VELOCITY)], {})
    with pytest.raises(InputError, match=r"f_1\.vdb: no grid 'density', the grids found are: 'velocity'"):
        load_frames(tmp_path)
    for number in (1, 2):
        write_vdb(tmp_path / f"f_{number}.vdb", [DenseGrid("density", 0 * DENSITY)], {})
    with pytest.raises(InputError, match=r"f_1\.vdb: no active voxel in it"):
        load_frames(tmp_path)

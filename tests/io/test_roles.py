"""Which grids of a file are taken for which role: usual names in any spelling, never anything else without a word."""

from __future__ import annotations

import itertools
import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tnst_mi.errors import InputError
from tnst_mi.io.interpretation.grid_names import component, listed
from tnst_mi.io.interpretation.roles import NONE, Entry, Roles, Wanted, chosen_roles


def scalars(*names: str) -> list[Entry]:
    return [Entry(name, True, False, "float") for name in names]


def vectors(*names: str) -> list[Entry]:
    return [Entry(name, False, True, "vec3s") for name in names]


def chosen(entries: list[Entry], wanted: Wanted | None = None, noun: str = "grid") -> tuple[list[str], ...]:
    """The names of the grids of each role, and those left."""
    roles = chosen_roles(entries, wanted or Wanted(), noun)
    return tuple(
        [entries[i].name for i in places] for places in (roles.density, roles.velocity, roles.obstacle, roles.left)
    )


@pytest.mark.parametrize(
    "name",
    [
        "density",
        "Density",
        "DENSITY",
        " density ",
        "density[0]",
        "density_01",
        "smokeDensity",
        "density_noise",
        "dens",
        "rho",
        "Rho",
        "rho_001",
        "d",
    ],
)
def test_densities_in_any_spelling(name: str) -> None:
    assert chosen(scalars("heat", name, "flame"))[0] == [name]


@pytest.mark.parametrize("name", ["smoke", "Smoke_001", "fog", "soot", "clouds", "steam"])
def test_smoke_by_another_name(name: str) -> None:
    assert chosen(scalars("temperature", name)) == ([name], [], [], ["temperature"])


@pytest.mark.parametrize(
    "names", [("temperature",), ("",), ("smoke_temperature",), ("density_gradient",), ("heat", "fuel")]
)
def test_what_is_not_smoke_by_name_is_not_taken(names: tuple[str, ...]) -> None:
    roles = chosen_roles(scalars(*names), Wanted())
    assert roles.density == () and "choose with --density NAME" in roles.lacking
    assert all(repr(name) in roles.lacking for name in names)


@pytest.mark.parametrize("name", ["vel.noise", "vel_x", "velocityY", "v_rest", "vel_curl", "velocity_source", "wind"])
def test_what_is_not_a_velocity_by_name_is_left(name: str) -> None:
    assert chosen([*scalars("density"), *vectors(name)]) == (["density"], [], [], [name])
    assert chosen([*scalars("density"), *vectors(name)], Wanted(velocity=name))[1] == [name]


@pytest.mark.parametrize("name", ["smoke_velocity", "vel_center", "velocity_field", "velocity[0]", "velocity_1"])
def test_a_lone_velocity_of_a_longer_name_is_taken(name: str) -> None:
    assert chosen([*scalars("density"), *vectors(name, "vel.noise")])[1] == [name]


def test_the_exact_name_comes_first_and_different_ones_are_asked_for() -> None:
    assert chosen(scalars("Density", "smoke", "density"))[0] == ["density"]
    for names in (("smoke", "fog"), ("Density", "DENSITY"), ("density_low", "density_high")):
        with pytest.raises(InputError, match=rf"several grids may be the density: '{names[0]}', '{names[1]}'; choose"):
            chosen_roles(scalars(*names), Wanted())


def test_grids_of_one_name_go_together() -> None:
    assert chosen_roles(scalars("density", "density"), Wanted()).density == (0, 1)
    assert chosen_roles(scalars("density[0]", "density[1]"), Wanted()).density == (0, 1)
    assert chosen_roles(scalars("density", "heat", "density"), Wanted(density="density[1]")) == Roles(
        (2,), (), (), (0, 1)
    )
    with pytest.raises(InputError, match="several arrays may be the density"):  # arrays have no active voxels to tell
        chosen_roles(scalars("Density ", "Density"), Wanted(), "array")


@pytest.mark.parametrize("name", ["velocity", "vel", "v", "Vel", "V", "velocity[0]", "smoke_vel", "u", "Velocities"])
def test_velocities_in_any_spelling(name: str) -> None:
    assert chosen([*scalars("density"), *vectors("Cd", name)])[1] == [name]


@pytest.mark.parametrize(
    "form", ["vel.{}", "velocity{}", "Velocity_{}", "vel {}", "V_{}", "v{}", "{}_velocity", "{}vel", "VEL:{}", "u{}"]
)
def test_velocities_in_three_scalars(form: str) -> None:
    for letters in ("xyz", "XYZ"):
        names = [form.format(letter) for letter in letters]
        for order in itertools.permutations(range(3)):
            entries = scalars("density", *(names[place] for place in order))
            assert chosen(entries)[1] == names, entries


@pytest.mark.parametrize(
    "names", [("u", "v", "w"), ("U", "V", "W"), ("vel[0]", "vel[1]", "vel[2]"), ("vel0", "vel1", "vel2")]
)
def test_velocities_in_three_scalars_by_other_axes(names: tuple[str, ...]) -> None:
    assert chosen(scalars("density", *names[::-1]))[1] == list(names)


@pytest.mark.parametrize("name", ["wind", "flow", "arr", "smoke_motion"])
def test_vectors_by_another_name_may_be_the_velocity(name: str) -> None:
    """They are not taken, but pointed out, unless there is a velocity, or the user has said something about it."""
    entries = [*scalars("density"), *vectors("Cd", "force", "vorticity", name)]
    assert chosen_roles(entries, Wanted()).like_velocity == (4,)
    assert chosen_roles([*entries, *vectors("vel")], Wanted()).like_velocity == ()
    assert chosen_roles(entries, Wanted(velocity=NONE)).like_velocity == ()
    assert chosen(entries, Wanted(velocity=name))[1] == [name]


def test_half_a_velocity_is_left() -> None:
    assert chosen(scalars("density", "vel.x", "vel.y")) == (["density"], [], [], ["vel.x", "vel.y"])
    plane = [Entry(name, True, False, "float32", plane=True) for name in ("density", "u", "v")]
    assert chosen(plane)[1] == ["u", "v"]
    assert component("Cd.x") is None and component("Cd.x", "Cd") == ("cd", 0)


def test_a_vector_is_preferred_to_components_and_other_vectors_are_left() -> None:
    entries = [*scalars("density", "u", "v", "w"), *vectors("vel", "Cd")]
    assert chosen(entries)[1:] == (["vel"], [], ["u", "v", "w", "Cd"])
    assert chosen([*scalars("density"), *vectors("Cd", "force")])[1] == []


def test_obstacles() -> None:
    assert chosen(scalars("density", "flags", "Obstacle"))[2] == ["Obstacle"]
    assert chosen(scalars("density", "flags", "phi_obstacle"))[2] == ["flags"]


def test_the_user_names_what_is_there() -> None:
    entries = [*scalars("density", "Temp ", "", "wind.x", "wind.y", "wind.z", "a", "b", "c"), *vectors("Cd", "vel")]
    assert chosen(entries, Wanted(density="Temp "))[0] == ["Temp "]
    assert chosen(entries, Wanted(density="temp"))[0] == ["Temp "]
    assert chosen(entries, Wanted(density=""))[0] == [""]
    assert chosen(entries, Wanted(velocity="Cd"))[1] == ["Cd"]
    assert chosen(entries, Wanted(velocity="wind"))[1] == ["wind.x", "wind.y", "wind.z"]
    assert chosen(entries, Wanted(velocity="c,a,b"))[1] == ["c", "a", "b"]
    assert chosen(entries, Wanted(velocity=NONE, obstacle=NONE))[1:3] == ([], [])
    assert chosen(entries, Wanted(obstacle="a"))[2] == ["a"]


def test_names_that_are_not_there_are_refused() -> None:
    entries = [*scalars("density"), *vectors("vel")]
    for role in ("velocity", "obstacle"):
        with pytest.raises(InputError, match=rf"--{role} 'wind': no such grid, those found are: 'density', 'vel'"):
            chosen_roles(entries, Wanted(**{role: "wind"}))
    # Without the density it is a frame without smoke, if other frames have one.
    assert chosen_roles(entries, Wanted("heat", "wind")).lacking.startswith("--density 'heat': no such grid")


def test_what_holds_no_numbers_is_refused_by_its_type_or_left() -> None:
    masks = [Entry(name, False, False, "bool") for name in ("density", "obstacle", "velocity")]
    message = "grid 'density' holds bool, expected numbers; export it as such, or choose another with --density NAME"
    with pytest.raises(InputError, match=message):
        chosen_roles(masks, Wanted())
    assert chosen([*scalars("density"), masks[1]]) == (["density"], [], [], ["obstacle"])
    with pytest.raises(InputError, match=r"grid 'obstacle' holds bool, .* or go without it with --obstacle none"):
        chosen_roles([*scalars("density"), masks[1]], Wanted(obstacle="obstacle"))


def test_lone_arrays_without_a_name() -> None:
    for name in ("arr_0", "x", "data"):
        assert chosen(scalars(name), noun="array")[0] == [name]
        assert chosen(scalars(name))[0] == []
    assert chosen([*scalars("arr_0"), *vectors("arr_1")], noun="array")[:2] == (["arr_0"], ["arr_1"])
    assert chosen(scalars("arr_0", "arr_1"), noun="array")[0] == []


@given(st.lists(st.text(max_size=40), max_size=12), st.booleans())
@example(["\U000e0001" * 30 + str(number) for number in range(12)], True)
def test_any_names_are_chosen_once_or_refused_in_one_line(names: list[str], quoted: bool) -> None:
    entries = [Entry(name, True, index % 3 == 0, "float") for index, name in enumerate(names)]
    try:
        roles = chosen_roles(entries, Wanted())
    except InputError as error:
        assert re.match(r"several grids may be|grid .* holds", str(error)) and len(str(error)) < 400
    else:
        assert {*roles.density, *roles.velocity, *roles.obstacle, *roles.left} == set(range(len(names)))
        assert bool(roles.density) != bool(roles.lacking) and len(roles.lacking) < 400
    assert len(listed(names, quoted)) < 1000

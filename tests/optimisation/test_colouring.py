"""Colours that are optimised: the gradient, steps within bounds, and what follows which part of a loss."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import torch
from networks import random_googlenet
from PIL import Image

from tnst_mi.fields import advection
from tnst_mi.fields.advection import advect
from tnst_mi.fields.pyramid import gaussian
from tnst_mi.frame import Frame
from tnst_mi.geometry.other_grids import OtherGrid
from tnst_mi.losses.images import PIXELS
from tnst_mi.losses.palette import Palette, _directions
from tnst_mi.losses.pictures import GreyImage
from tnst_mi.losses.terms import Semantic
from tnst_mi.machine.backend import torch_device
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.colouring import COLOUR, Coloured, Colours, colour_step, final_colour, mean_colour
from tnst_mi.optimisation.gradient import OctaveProblem, problem_of
from tnst_mi.optimisation.movement import Movement
from tnst_mi.optimisation.parameterisation import Fields, Transport
from tnst_mi.optimisation.plan import Plan, plan_of
from tnst_mi.recipe.recipe import Recipe

SHAPE = (10, 14, 12)
START = np.float32([0.5, 0.4, 0.3])


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> GoogLeNet:
    path = tmp_path_factory.mktemp("weights") / "random.safetensors"
    random_googlenet(path, narrow=8)
    return GoogLeNet.load(path).to(torch_device())


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("pictures") / "colours.png"
    pixels = np.random.default_rng(5).integers(0, 256, (24, 24, 3)).astype(np.uint8)
    pixels[:, :12, 2] //= 4
    Image.fromarray(pixels).save(path)
    return str(path)


def smoke() -> np.ndarray:
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
    return np.exp(-4 * (x**2 + y**2 + z**2)).astype(np.float32)


def setting(
    network: GoogLeNet, picture: str, own: tuple[str | None, ...] = (), **keys: object
) -> tuple[Plan, OctaveProblem, Fields]:
    """A plan of one frame, perhaps with a grid of its `own` colours, its only octave, and fields that are not 0."""
    fixed = {"octaves": 1, "views": 2, "style_layers": {"conv2/3x3": 1.0}, "loss_scaling": "none", "gamma": 0.2}
    recipe = Recipe.from_dict({"style": [picture], "colour": "style"} | fixed | keys)
    plan = plan_of(recipe, ["f"], [0], [1.0], [1.0], SHAPE, colour_names=own)
    rng = np.random.default_rng(1)
    zeros = plan.frames[0].parameterisation.zeros(plan.octaves[0])
    sizes = {"psi": 0.5, "phi": 0.5, COLOUR: 0.1}
    fields = {k: sizes[k] * rng.normal(size=field.shape).astype(np.float32) for k, field in zeros.items()}
    return plan, problem_of(plan, plan.octaves[0], network), Fields({k: mi.TensorXf(f) for k, f in fields.items()})


def waves() -> np.ndarray:
    """Smooth colours (D, H, W, 3) within [0.2, 0.8]."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
    return (0.5 + 0.3 * np.sin(np.stack([4 * x, 5 * y, 3 * z + x], axis=-1))).astype(np.float32)


def unlimited(transport: Callable[..., mi.TensorXf]) -> Callable[..., mi.TensorXf]:
    """The same transport without the limiter."""
    return lambda field, v, method, *rest: transport(field, v, "maccormack_unlimited", *rest)


def start() -> mi.TensorXf:
    return mi.TensorXf(np.broadcast_to(START, (*SHAPE, 3)).copy())


@pytest.mark.parametrize(("palette", "step"), [(1.0, 0.03), (0.0, 0.001)], ids=["palette", "strokes"])
def test_the_gradient_of_colours_is_that_of_the_loss(
    network: GoogLeNet, picture: str, palette: float, step: float
) -> None:
    """By central differences; the network's have many kinks, between which only short steps are."""
    plan, problem, fields = setting(network, picture, style_weight=1.0 - palette, colour_weight=palette)
    density, frame = mi.TensorXf(smoke()), plan.frames[0]

    def loss(colour: np.ndarray) -> float:
        at = Fields({**fields, COLOUR: mi.TensorXf(colour.astype(np.float32))})
        return float(problem.gradient(frame, at, density, (3,), (), start()).loss.double())

    found = problem.gradient(frame, fields, density, (3,), (), start()).gradients[0][COLOUR].numpy().astype(float)
    colour = fields[COLOUR].numpy()
    direction = found / np.linalg.norm(found)
    slope = (loss(colour + step * direction) - loss(colour - step * direction)) / (2 * step)
    assert slope == pytest.approx((found * direction).sum(), rel=1e-3)


@pytest.mark.parametrize("transport", ["flow", "step"])
def test_what_moves_colours_follows_the_images_that_they_change(
    network: GoogLeNet, picture: str, transport: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By central differences, without the limiter, which is a switch."""
    for name in ("flow", "step"):
        monkeypatch.setattr(f"tnst_mi.optimisation.parameterisation.{name}", unlimited(getattr(advection, name)))
    keys = {"colour_weight": 0.0, "style_layers": {"conv1/7x7_s2": 1.0}, "transport": transport}
    plan, problem, fields = setting(network, picture, ("Cd",), **keys)
    fields = Fields({**fields, "psi": gaussian(fields["psi"] * 10, 1.5), COLOUR: fields[COLOUR] * 0.5})
    density, frame, own = mi.TensorXf(smoke()), plan.frames[0], mi.TensorXf(waves())

    def loss(psi: np.ndarray) -> float:
        at = Fields({**fields, "psi": mi.TensorXf(psi.astype(np.float32))})
        return float(problem.gradient(frame, at, density, (3,), (), own).loss.double())

    found = problem.gradient(frame, fields, density, (3,), (), own).gradients[0]["psi"].numpy().astype(float)
    direction, psi = found / np.linalg.norm(found), fields["psi"].numpy()
    slope = (loss(psi + 0.01 * direction) - loss(psi - 0.01 * direction)) / 0.02
    assert slope == pytest.approx((found * direction).sum(), rel=1e-3)


@pytest.mark.parametrize("own", [(), ("Cd",)], ids=["mean", "own colours"])
def test_the_density_does_not_follow_a_palette(network: GoogLeNet, picture: str, own: tuple[str, ...]) -> None:
    """Its gradient is that of the strokes alone, to the bit; without strokes it is 0."""
    found, begun = {}, mi.TensorXf(waves())
    for weight in (0.0, 1.0):
        plan, problem, fields = setting(network, picture, own, colour_weight=weight)
        (found[weight],) = problem.gradient(plan.frames[0], fields, mi.TensorXf(smoke()), (3,), (), begun).gradients
    np.testing.assert_array_equal(found[0.0]["psi"].numpy(), found[1.0]["psi"].numpy())
    assert (found[0.0][COLOUR].numpy() != found[1.0][COLOUR].numpy()).mean() > 0.5
    plan, problem, fields = setting(network, picture, own, style_weight=0.0)
    (palette,) = problem.gradient(plan.frames[0], fields, mi.TensorXf(smoke()), (3,), (), begun).gradients
    assert not palette["psi"].numpy().any() and palette[COLOUR].numpy().any()


def test_the_brightness_of_images_does_not_pull_at_their_colours(network: GoogLeNet, picture: str) -> None:
    """With sigma = "loss" each view's loss is multiplied by the sum of its pixels, which black colours would lower."""
    plan, problem, fields = setting(network, picture, sigma="loss", colour_weight=0.0, views=1)
    frame, density = plan.frames[0], mi.TensorXf(smoke())
    weighed = problem.gradient(frame, fields, density, (3,), (), start())
    plan, problem, _ = setting(network, picture, colour_weight=0.0, views=1)
    plain = problem.gradient(plan.frames[0], fields, density, (3,), (), start())
    brightness = float(weighed.loss) / float(plain.loss)
    expected = brightness * plain.gradients[0][COLOUR].numpy()
    np.testing.assert_allclose(
        weighed.gradients[0][COLOUR].numpy(), expected, rtol=1e-3, atol=1e-5 * np.abs(expected).max()
    )


def test_white_smoke_has_the_loss_of_a_grey_picture_in_grey(network: GoogLeNet, tmp_path: Path) -> None:
    """Strokes in colour are those in grey where nothing has a colour."""
    path = tmp_path / "grey.png"
    Image.fromarray(np.random.default_rng(2).integers(0, 256, (20, 20), np.uint8)).save(path)
    density, losses = mi.TensorXf(smoke()), []
    for colour in ("off", "style"):
        plan, problem, fields = setting(network, str(path), colour=colour, colour_weight=0.0)
        white = mi.TensorXf(np.ones((*SHAPE, 3), np.float32)) - fields[COLOUR] if colour == "style" else None
        losses.append(float(problem.gradient(plan.frames[0], fields, density, (3,), (), white).loss))
    assert losses[0] == pytest.approx(losses[1], rel=1e-5)


def fifth_turn(axis: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) of a fifth of a turn about a unit vector."""
    across = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(2 * np.pi / 5) * across + (1 - np.cos(2 * np.pi / 5)) * across @ across


def test_directions_prefer_none() -> None:
    """31 axes of symmetry of an icosahedron: turns of it take them to each other; second and fourth moments are those
    of the sphere.
    """
    lines = _directions().numpy()
    assert len(lines) == 31
    np.testing.assert_allclose(lines.T @ lines, 31 / 3 * np.eye(3), atol=1e-12)
    # A fifth of a turn about a corner, and half of one about an axis of the cube.
    corner = np.array([0, (1 + np.sqrt(5)) / 2, 1]) / np.sqrt((5 + np.sqrt(5)) / 2)
    for turn in (fifth_turn(corner), np.diag([-1.0, -1.0, 1.0])):
        alike = np.abs(lines @ turn @ lines.T)
        np.testing.assert_allclose(alike.max(axis=1), 1, atol=1e-12)
    others = np.random.default_rng(0).normal(size=(8, 3))
    others /= np.linalg.norm(others, axis=1, keepdims=True)
    np.testing.assert_allclose(((lines @ others.T) ** 4).sum(0), 31 / 5, atol=1e-12)


def test_a_grey_palette_draws_grey_smoke_to_no_colour(network: GoogLeNet) -> None:
    rng = np.random.default_rng(3)
    bound = Palette(GreyImage("grey", rng.random((16, 16)).astype(np.float32))).bind(network, 16, 16)
    images = torch.from_numpy(rng.random((1, 16, 16, 1)).astype(np.float32)).repeat(1, 1, 1, 3).requires_grad_()
    bound(images.to(torch_device())).backward()
    gradient = images.grad.numpy()
    assert np.abs(gradient).max() > 0
    np.testing.assert_allclose(gradient, gradient.mean(-1, keepdims=True).repeat(3, -1), atol=1e-5 * gradient.max())


def test_the_palette_of_a_picture_is_its_own(network: GoogLeNet) -> None:
    """Shuffled pixels have no distance; shifted ones the square of the shift over that of the picture."""
    rng = np.random.default_rng(4)
    rgb = rng.random((12, 12, 3)).astype(np.float32) * 0.5
    bound = Palette(GreyImage("picture", rgb.mean(-1), rgb=rgb)).bind(network, 12, 12)
    shuffled = rng.permutation(rgb.reshape(-1, 3)).reshape(1, 12, 12, 3)
    shift = np.float32([0.1, -0.05, 0.2])
    assert float(bound(torch.from_numpy(shuffled).to(torch_device()))) < 1e-10
    expected = (shift.astype(float) ** 2).sum() / (rgb.astype(float) ** 2).sum(-1).mean()
    assert float(bound(torch.from_numpy(shuffled + shift).to(torch_device()))) == pytest.approx(expected, rel=1e-5)


def test_steps_are_bounded_and_downhill() -> None:
    rng = np.random.default_rng(6)
    gradient = rng.normal(size=(*SHAPE, 3)).astype(np.float32) * 10.0 ** rng.integers(-9, 3, (*SHAPE, 1))
    gradient[0] = 0
    found = colour_step(mi.TensorXf(gradient.astype(np.float32)), None, 0.03, 0.0).numpy().astype(float)
    length = np.linalg.norm(gradient.astype(float), axis=-1, keepdims=True)
    expected = 0.03 * gradient / (length + length[length > 0].mean())
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-12)
    assert np.linalg.norm(found, axis=-1).max() < 0.03 and not found[0].any()
    half = np.full(SHAPE, 0.5, np.float32)
    masked = colour_step(mi.TensorXf(gradient.astype(np.float32)), mi.TensorXf(half), 0.03, 0.0).numpy()
    np.testing.assert_allclose(masked, found / 2, rtol=1e-5, atol=1e-12)
    assert not colour_step(mi.TensorXf(np.zeros((*SHAPE, 3), np.float32)), None, 0.03, 1.2).numpy().any()


def test_colours_stay_display_values() -> None:
    rng = np.random.default_rng(7)
    change = mi.TensorXf(rng.normal(size=(*SHAPE, 3)).astype(np.float32))
    fields = Coloured(Transport(0.0)).in_gamut(Fields({"psi": change, COLOUR: change}), start(), 1.0)
    colours = START + fields[COLOUR].numpy()
    assert colours.min() >= -1e-7 and colours.max() <= 1 + 1e-7 and fields["psi"] is change


def test_changes_of_colours_that_move_end_where_display_values_do(network: GoogLeNet, picture: str) -> None:
    """No step is wasted on what is cut off: a change that has come to the end goes back at once."""
    plan, _, fields = setting(network, picture, ("Cd",))
    frame, own = plan.frames[0], mi.TensorXf(waves())
    moved = frame.parameterisation.of_density.colour(fields, own, 1.0).numpy()
    assert np.abs(moved - own.numpy()).max() > 0.1
    far = frame.in_gamut(Fields({**fields, COLOUR: fields[COLOUR] * 100}), own, 1.0)
    ends = moved + far[COLOUR].numpy()
    assert ends.min() >= -1e-6 and ends.max() <= 1 + 1e-6
    assert (ends < 1e-6).mean() > 0.3 and (ends > 1 - 1e-6).mean() > 0.3
    ones = mi.TensorXf(np.ones((*SHAPE, 3), np.float32))
    _, pull_back = frame.coloured(far, own, 1.0)
    assert (pull_back(ones, None)[COLOUR].numpy() == 1).all()


def test_colours_beyond_display_values_are_cut_and_have_no_derivative(network: GoogLeNet, picture: str) -> None:
    plan, _, fields = setting(network, picture, ("Cd",))
    frame, own = plan.frames[0], mi.TensorXf(waves())
    wild = Fields({**fields, COLOUR: fields[COLOUR] * 20})
    colour, pull_back = frame.coloured(wild, own, 1.0)
    free = frame.parameterisation.of_density.colour(fields, own, 1.0).numpy() + wild[COLOUR].numpy()
    np.testing.assert_allclose(colour.numpy(), np.clip(free, 0, 1), atol=1e-6)
    ones = mi.TensorXf(np.ones((*SHAPE, 3), np.float32))
    inside = (free > -1e-6) & (free < 1 + 1e-6)
    np.testing.assert_array_equal(pull_back(ones, None)[COLOUR].numpy(), inside)
    assert 0.1 < inside.mean() < 0.9


def test_a_result_is_between_the_smoke_as_it_was_and_its_colours() -> None:
    """white + share (start − white) + blend change, where the change is that of the strength; solids stay."""
    rng = np.random.default_rng(9)
    change, white = 0.1 * rng.normal(size=(*SHAPE, 3)).astype(np.float32), np.ones((*SHAPE, 3), np.float32)
    solid = np.zeros(SHAPE, bool)
    solid[2:4] = True
    final = final_colour(white, start().numpy(), mi.TensorXf(change), 0.4 * 0.5, 0.5, solid)
    np.testing.assert_array_equal(final[2:4], white[2:4])
    expected = np.clip(1 + 0.2 * (START - 1) + 0.5 * change, 0, 1)
    np.testing.assert_allclose(final[4:], expected[4:], atol=1e-6)


def test_colours_of_the_input_move_with_the_smoke() -> None:
    """Along its paths, channel by channel, from the border on; the mean of pictures stays where it is."""
    rng, plain = np.random.default_rng(10), Transport(0.0, trace="flow")
    psi = mi.TensorXf(3 * rng.normal(size=(*SHAPE, 3)).astype(np.float32))
    own = 0.2 + 0.6 * rng.random((*SHAPE, 3)).astype(np.float32)
    fields, v = Fields({"psi": psi, COLOUR: dr.zeros(mi.TensorXf, (*SHAPE, 3))}), plain.velocity(Fields(psi=psi), 1.0)
    moved, _ = Coloured(plain, moves=True).colour_with_pullback(fields, mi.TensorXf(own), 1.0)
    for channel in range(3):
        alone = advect(np.ascontiguousarray(own[..., channel]), v.numpy(), outside="edge", trace="flow")
        np.testing.assert_allclose(moved.numpy()[..., channel], alone, atol=1e-5)
    still, _ = Coloured(plain).colour_with_pullback(fields, mi.TensorXf(own), 1.0)
    np.testing.assert_array_equal(still.numpy(), own)


@pytest.mark.parametrize("trace", ["step", "flow"])
def test_smoke_that_is_pressed_together_or_comes_from_beyond_the_grid_keeps_its_colour(trace: str) -> None:
    """On octaves and in results alike: one colour stays one, where a density is multiplied by 20."""
    z, y, x = np.meshgrid(*(np.arange(n) - n / 2 for n in SHAPE), indexing="ij")
    phi = mi.TensorXf((0.25 * (x**2 + y**2 + z**2)).astype(np.float32))
    transport = Transport(1.0, trace=trace, conservative=trace == "flow")
    moved = transport.colour(Fields(phi=phi), start(), 1.0).numpy()
    np.testing.assert_allclose(moved, np.broadcast_to(START, moved.shape), rtol=1e-5)
    solid = np.zeros(SHAPE, bool)
    solid[4:6, 4:6, 4:6] = True
    for obstacle in (None, solid):
        movement = Movement(
            transport, Fields(phi=-phi), 1.0, Frame(smoke(), obstacle=obstacle, name="f"), exponent=0, blend=1.0
        )
        for values in (start().numpy(), np.full((*SHAPE, 3), 200, np.uint8)):
            found = movement.carried(OtherGrid(values), of_colour=True)
            np.testing.assert_allclose(found, values, rtol=1e-5)
        if trace == "flow":
            ones = movement.carried(OtherGrid(np.ones(SHAPE, np.float32)))
            assert ones.max() > 2


def test_what_moves_the_smoke_does_so_as_without_colours() -> None:
    plain, rng = Transport(0.0, trace="flow"), np.random.default_rng(8)
    coloured = Coloured(plain)
    psi = mi.TensorXf(rng.normal(size=(*SHAPE, 3)).astype(np.float32))
    fields, density = Fields({"psi": psi, COLOUR: psi}), mi.TensorXf(smoke())
    for of_both, of_one in (
        (coloured.density(fields, density, 1.0), plain.density(Fields(psi=psi), density, 1.0)),
        (coloured.within(fields, 0.3, 1.0)["psi"], plain.within(Fields(psi=psi), 0.3, 1.0)["psi"]),
    ):
        np.testing.assert_array_equal(of_both.numpy(), of_one.numpy())
    assert coloured.channels == {"psi": 3, COLOUR: 3} and coloured.of_density is plain
    assert dr.all(coloured.within(fields, 0.3, 1.0)[COLOUR].array == psi.array)


def test_white_smoke_begins_with_the_means_of_the_targets_in_their_regions() -> None:
    means = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    colours, frame = Colours(frozenset(), "Cd", (means,)), Frame(smoke(), name="f")
    upper, lower = np.zeros(SHAPE, np.float32), np.zeros(SHAPE, np.float32)
    upper[:, :4], lower[:, 4:8] = 1, 1
    upper[:, 4], lower[:, 4] = 0.25, 0.25
    found = colours.start(0, frame, (upper, lower))
    np.testing.assert_allclose(found[:, 0], np.broadcast_to([1, 0, 0], found[:, 0].shape), atol=1e-6)
    np.testing.assert_allclose(found[:, 6], np.broadcast_to([0, 0, 1], found[:, 6].shape), atol=1e-6)
    np.testing.assert_array_equal(found[:, 8:], np.ones_like(found[:, 8:]))
    # A quarter of both: white but for a quarter, which is half of each.
    np.testing.assert_allclose(found[:, 4], np.broadcast_to([0.875, 0.75, 0.875], found[:, 4].shape), atol=1e-6)


def test_a_start_without_a_grid_is_the_mean_of_the_part_of_the_picture_that_is_used() -> None:
    rgb = np.zeros((10, 40, 3), np.float32)
    rgb[..., 2], rgb[:, 15:25] = 1, (1, 0, 0)
    wide = Palette(GreyImage("wide", rgb.mean(-1), rgb=rgb))
    np.testing.assert_allclose(mean_colour(wide, [0.0], (8, 8)), [1, 0, 0], atol=2e-2)
    assert mean_colour(Semantic("conv2/3x3", (1,)), [1.0], (8, 8)) == (1.0, 1.0, 1.0)


def test_a_start_without_a_grid_is_the_mean_of_the_pictures(network: GoogLeNet, picture: str) -> None:
    plan, _, _ = setting(network, picture)
    pixels = np.asarray(Image.open(picture), float) / 255
    used = pixels[:, round(12 - 12 * SHAPE[2] / SHAPE[1]) : round(12 + 12 * SHAPE[2] / SHAPE[1])].mean((0, 1))
    assert plan.colours is not None
    colours = plan.colours.start(0, Frame(smoke(), name="f"))
    np.testing.assert_allclose(colours, np.broadcast_to(used, colours.shape), atol=2e-2)


def test_the_distance_of_a_palette_is_one_of_display_values(network: GoogLeNet, tmp_path: Path) -> None:
    """White and red are (0, 1, 1) apart, of which the mean square along a line is 2/3, whatever is transparent."""
    pixels = np.full((8, 8, 4), (255, 0, 0, 255), np.uint8)
    pixels[:4] = (0, 255, 0, 0)
    Image.fromarray(pixels).save(tmp_path / "red.png")
    palette = Palette(tmp_path / "red.png")
    (loss,) = palette.bind_term(network, 8, 8).loss({PIXELS: torch.ones(1, 3, 8, 8)}, None)
    assert float(loss) * palette.mean_square(8, 8) / 3 == pytest.approx(2 / 3, rel=1e-5)

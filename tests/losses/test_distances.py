"""The distances of features that a style can have, against closed forms and sums written in numpy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from small_network import HEIGHT, WIDTH, SmallNetwork, features, picture, value, views
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from tnst_mi.choices import STYLE_LOSSES
from tnst_mi.losses import nearest
from tnst_mi.losses.gram import gram_distance, paper_distance
from tnst_mi.losses.guided import Guide, Guides, LayerLoss, LayerTarget
from tnst_mi.losses.nearest import nearest_distance
from tnst_mi.losses.pictures import GreyImage
from tnst_mi.losses.sliced import directions, sliced_distance
from tnst_mi.losses.sorting import order_of
from tnst_mi.losses.style import Style
from tnst_mi.losses.terms import Content, Semantic

#: The distances of a layer, by the target.
LOSSES: dict[str, Callable[[LayerTarget], LayerLoss]] = {
    "gram": lambda target: gram_distance(target, 1.0),
    "paper": lambda target: paper_distance(target, 1.0),
    "swd": lambda target: sliced_distance(target, 1.0, directions(target, (3,))),
    "axes": lambda target: sliced_distance(target, 1.0, None),
    "nnfm": lambda target: nearest_distance(target, 1.0),
}


def random_features(channels: int = 5, rows: int = 6, columns: int = 4, seed: int = 0, n: int = 1) -> Tensor:
    """(n, channels, rows, columns), as after a ReLU: half of them are 0."""
    values = np.random.default_rng(seed).normal(size=(n, channels, rows, columns))
    return torch.from_numpy(np.maximum(values, 0))


def target_of(values: Tensor, weights: np.ndarray | None = None) -> LayerTarget:
    """A target with equal weights, or with weights (rows, columns)."""
    return LayerTarget(values, None if weights is None else Guide(torch.from_numpy(weights)[None]))


def on_a_line(numbers: Any) -> Tensor:
    """Features of one channel, in one row."""
    return torch.as_tensor(numbers, dtype=torch.float64)[None, None, None]


def wasserstein(image: Any, wanted: Any, weights: Any = None, wanted_weights: Any = None) -> float:
    """What `sliced_distance` says of two sets of numbers, without its divisor, the mean square of the target."""
    given = None if wanted_weights is None else np.asarray(wanted_weights, float)[None]
    target = target_of(on_a_line(wanted), given)
    guide = None if weights is None else Guide(torch.as_tensor(weights, dtype=torch.float64)[None, None])
    found = sliced_distance(target, 1.0, torch.ones(1, 1, dtype=torch.float64))(on_a_line(image), guide)
    return found.item() * float(np.average(np.square(wanted), weights=wanted_weights))


# ---- All of them -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LOSSES)
def test_features_with_the_distribution_of_the_target_have_no_loss(name: str) -> None:
    values = random_features() + 0.01
    moved = values.flatten(2)[..., np.random.default_rng(1).permutation(24)].reshape(values.shape)
    for same in (values, moved, torch.cat([values, values], 3)):
        assert LOSSES[name](target_of(values))(same, None).item() < 1e-15
    assert LOSSES[name](target_of(values))(random_features(seed=2), None).item() > 1e-3


@pytest.mark.parametrize("name", LOSSES)
def test_where_things_are_in_the_target_or_the_image_changes_nothing(name: str) -> None:
    values, image = random_features(), random_features(seed=1)
    order = np.random.default_rng(2).permutation(24)
    moved, moved_image = (v.flatten(2)[..., order].reshape(v.shape) for v in (values, image))
    expected = LOSSES[name](target_of(values))(image, None).item()
    assert LOSSES[name](target_of(moved))(image, None).item() == pytest.approx(expected, rel=1e-12)
    assert LOSSES[name](target_of(values))(moved_image, None).item() == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.parametrize("guided", [False, True])
def test_derivatives_are_those_of_central_differences(name: str, guided: bool) -> None:
    target = target_of(random_features(seed=1), np.random.default_rng(4).random((6, 4)) if guided else None)
    guide = Guide(torch.from_numpy(np.random.default_rng(5).random((2, 6, 4)))) if guided else None
    loss, generator = LOSSES[name](target), torch.Generator().manual_seed(7)
    # Without equal features, which sorts may put in any order.
    image = (random_features(n=2) + torch.rand(2, 5, 6, 4, generator=generator, dtype=torch.float64)).requires_grad_()
    (derivative,) = torch.autograd.grad(loss(image, guide).sum(), image)
    for seed in range(3):
        direction = torch.from_numpy(np.random.default_rng(seed).normal(size=image.shape))
        ends = [loss(image.detach() + sign * 1e-7 * direction, guide).sum().item() for sign in (1, -1)]
        assert (derivative * direction).sum().item() == pytest.approx((ends[0] - ends[1]) / 2e-7, rel=1e-5)


@pytest.mark.parametrize("name", LOSSES)
def test_positions_without_weight_do_not_matter_at_all(name: str) -> None:
    """Neither to the value, nor to the derivative, to the bit; and they have none."""
    weights = np.random.default_rng(3).random((6, 4))
    weights[:, ::2] = 0
    guide, unseen = Guide(torch.from_numpy(weights)[None]), torch.from_numpy(weights == 0)
    found = []
    for other in (0.0, 7.0, -2.0):
        wanted, image = (torch.where(unseen, other, random_features(seed=seed)) for seed in (1, 2))
        image.requires_grad_()
        loss = LOSSES[name](target_of(wanted, weights))(image, guide)
        found.append((loss.item(), torch.autograd.grad(loss.sum(), image)[0]))
    assert found[0][0] > 1e-3 and not found[0][1][..., unseen].any() and found[0][1].any()
    for value_found, derivative in found[1:]:
        assert value_found == found[0][0] and torch.equal(derivative, found[0][1])


@pytest.mark.parametrize("name", LOSSES)
def test_equal_weights_are_no_weights(name: str) -> None:
    values, image = random_features(), random_features(seed=1, n=3)
    even = np.full((6, 4), 0.25)
    plain = LOSSES[name](target_of(values))(image, None)
    weighted = LOSSES[name](target_of(values, even))(image, Guide(torch.from_numpy(even).expand(3, -1, -1)))
    torch.testing.assert_close(weighted, plain, rtol=1e-12, atol=0)


@pytest.mark.parametrize("name", LOSSES)
def test_views_are_independent_and_one_without_smoke_is_finite(name: str) -> None:
    image = random_features(seed=1, n=3).requires_grad_()
    weights = torch.from_numpy(np.random.default_rng(3).random((3, 6, 4)))
    weights[1] = 0
    loss = LOSSES[name](target_of(random_features()))
    together = loss(image, Guide(weights))
    for i in (0, 2):
        alone = loss(image[i : i + 1], Guide(weights[i : i + 1]))
        torch.testing.assert_close(together[i : i + 1], alone, rtol=1e-12, atol=0)
    (derivative,) = torch.autograd.grad(together[::2].sum(), image)
    assert torch.isfinite(derivative).all() and not derivative[1].any()


@pytest.mark.parametrize("name", ["gram", "swd", "axes"])
def test_black_images_are_at_distance_1(name: str) -> None:
    """So is the mean over all directions, of which 200 are drawn: their mean has a standard deviation of about 0.05."""
    target = target_of(random_features(seed=4))
    losses = [LOSSES[name](target)]
    if name == "swd":
        losses = [sliced_distance(target, 1.0, directions(target, (seed,))) for seed in range(40)]
    found = np.mean([loss(torch.zeros_like(target.values), None).item() for loss in losses])
    assert found == pytest.approx(1, rel=0.1 if name == "swd" else 1e-12)


# ---- Sliced Wasserstein -----------------------------------------------------------------------------------


@pytest.mark.parametrize("shift", [0.0, 0.25, -3.0])
def test_shifted_numbers_are_the_square_of_the_shift_apart(shift: float) -> None:
    numbers = np.random.default_rng(0).normal(size=17)
    shuffled = np.random.default_rng(1).permutation(numbers + shift)
    assert wasserstein(shuffled, numbers) == pytest.approx(shift**2, rel=1e-12, abs=1e-25)


def test_sets_of_other_sizes_are_compared_by_quantiles() -> None:
    assert wasserstein([0.0, 4.0], [1.0, 1.0, 2.0, 2.0]) == pytest.approx((1**2 + 2**2) / 2)
    assert wasserstein([5.0, 0.0, 0.0, 5.0], [1.0, 3.0]) == pytest.approx((1 + 1 + 4 + 4) / 4)
    assert wasserstein([2.0], [1.0, 3.0, 4.0]) == pytest.approx(1.0), "the median"


def test_a_weight_is_a_number_of_copies() -> None:
    numbers, wanted = [3.0, -1.0, 2.0], [0.5, 4.0]
    expected = wasserstein(np.repeat(numbers, [1, 2, 3]), np.repeat(wanted, [2, 4]))
    copies = wasserstein(np.repeat(numbers, [1, 2, 3]), wanted, wanted_weights=[1, 2])
    assert copies == pytest.approx(expected, rel=1e-12)
    # −1, −1, 2, 2, 2, 3 beside 0.5, 0.5, 4, 4, 4, 4.
    assert expected == pytest.approx((2 * 1.5**2 + 3 * 2**2 + 1) / 6)
    assert wasserstein(numbers, wanted, [1, 2, 3], [2, 4]) == pytest.approx(expected, rel=1e-12)


def test_random_directions_against_sums_in_numpy() -> None:
    values, image = random_features(seed=1), random_features(seed=2, n=2)
    lines = directions(target_of(values), (5, 1)).numpy()
    np.testing.assert_allclose(np.linalg.norm(lines, axis=1), 1, rtol=1e-12)
    wanted = values.numpy().reshape(5, 24)
    expected = []
    for view in image.numpy().reshape(2, 5, 24):
        squares = [np.mean((np.sort(line @ view) - np.sort(line @ wanted)) ** 2) for line in lines]
        expected.append(5 * np.mean(squares) / (wanted**2).sum(0).mean())
    found = sliced_distance(target_of(values), 1.0, torch.from_numpy(lines))(image, None)
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-12)


def test_gaussians_on_a_line_are_their_moments_apart() -> None:
    """W² of N(a, s²) and N(b, r²) is (a − b)² + (s − r)²."""
    normal = np.random.default_rng(0).normal(size=(2, 40_000))
    assert wasserstein(1 + 2 * normal[0], 3 + 0.5 * normal[1]) == pytest.approx(4 + 2.25, rel=0.02)


def test_it_sees_what_gram_matrices_and_means_do_not() -> None:
    """Two sets of equal first and second moments: ±1 as often, and 0 at three quarters beside ±2."""
    wanted, image = on_a_line([1.0, -1.0] * 4), on_a_line([2.0, -2.0] + [0.0] * 6)
    assert gram_distance(target_of(wanted), 1.0)(image, None).item() == pytest.approx(0, abs=1e-25)
    assert wasserstein(image.ravel().numpy(), wanted.ravel().numpy()) == pytest.approx(1.0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("shape", [(7,), (3, 300), (2, 4, 1), (2, 3, 1000)])
def test_the_order_is_that_of_a_stable_sort(shape: tuple[int, ...], dtype: torch.dtype) -> None:
    """Of numbers of either sign and any size, half of which occur several times."""
    rng = np.random.default_rng(0)
    numbers = rng.normal(size=shape) * 10.0 ** rng.integers(-30, 30, shape)
    numbers = np.where(rng.random(shape) < 0.5, rng.choice([-np.inf, -2.5, 0.0, 1e-45, 1.0, np.inf], shape), numbers)
    values = torch.from_numpy(numbers).to(dtype)
    kept = values.clone()
    assert order_of(values).tolist() == np.argsort(values.numpy(), axis=-1, kind="stable").tolist()
    assert torch.equal(values, kept)


# ---- Nearest neighbours -----------------------------------------------------------------------------------


def nearest_in_numpy(image: np.ndarray, wanted: np.ndarray) -> float:
    """Oracle: the mean over the points (P, C) of the least cosine distance to one of the points (Q, C)."""
    distances = [
        min(1 - point @ other / (np.linalg.norm(point) * np.linalg.norm(other)) for other in wanted) for point in image
    ]
    return float(np.mean(distances))


@pytest.mark.parametrize("budget", [1, 24 * 8 * 5, 1 << 25])
def test_every_pair_is_looked_at_whatever_the_chunks(budget: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nearest, "LARGEST_SIMILARITIES", budget)
    wanted, image = random_features(seed=1) + 0.01, random_features(rows=7, seed=2, n=2) + 0.01
    found = nearest_distance(target_of(wanted), 1.0)(image, None)
    points = wanted[0].flatten(1).T.numpy()
    expected = [nearest_in_numpy(view.flatten(1).T.numpy(), points) for view in image]
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-12)


class Largest(TorchDispatchMode):
    """Records the size in bytes of the largest tensor that any operation makes."""

    size = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        for tensor in result if isinstance(result, tuple | list) else (result,):
            if isinstance(tensor, Tensor):
                self.size = max(self.size, tensor.numel() * tensor.element_size())
        return result


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """All pairs of 1600 positions would take 20 MB; features have 64 kB."""
    monkeypatch.setattr(nearest, "LARGEST_SIMILARITIES", 1 << 20)
    loss = nearest_distance(target_of(random_features(rows=40, columns=40)), 1.0)
    image = random_features(rows=40, columns=40, seed=1).requires_grad_()
    with Largest() as largest:
        loss(image, None).sum().backward()
    assert (1 << 19) < largest.size <= (1 << 20)


def test_positions_that_are_hardly_opaque_are_not_matched() -> None:
    wanted = torch.eye(4, dtype=torch.float64).reshape(1, 4, 1, 4)
    weights = np.array([[1.0, 0.6, 0.4, 0.0]])
    found = nearest_distance(target_of(wanted, weights), 1.0)(wanted, None).item()
    assert found == pytest.approx(2 / 4)


def test_features_without_direction_have_a_bounded_derivative() -> None:
    image = 1e-9 * random_features(seed=2)
    image.requires_grad_()
    wanted = random_features(seed=1)
    nearest_distance(target_of(wanted), 1.0)(image, None).sum().backward()
    assert image.grad is not None
    assert image.grad.abs().max() <= 1e3 / wanted[0].flatten(1).norm(dim=0).mean() / 24 * (1 + 1e-6)


# ---- As terms ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("distance", STYLE_LOSSES)
def test_an_image_equal_to_the_picture_has_no_loss(distance: str) -> None:
    net, term = SmallNetwork(), Style(picture(), {"shallow": 1.0, "deep": 1.0}, distance)
    same = torch.from_numpy(picture().grey).double()[None]
    assert value(term, net, same) < 1e-12 < 1e-5 < value(term, net, views(1))


def test_histogram_is_gram_and_the_sorted_channels() -> None:
    net, layers = SmallNetwork(), {"shallow": 2.0, "deep": 0.5}
    same = torch.from_numpy(picture().grey).double()[None]
    expected = value(Style(picture(), layers), net, views())
    for layer, weight in layers.items():
        wanted = features(net, same, layer)[0]
        for view in features(net, views(), layer):
            sorts = [np.sort(f.reshape(len(f), -1), axis=1) for f in (view, wanted)]
            expected += weight * np.square(sorts[0] - sorts[1]).sum() / np.square(wanted).sum()
    assert value(Style(picture(), layers, "histogram"), net, views()) == pytest.approx(expected, rel=1e-12)


def test_directions_are_those_of_the_seed_and_of_nothing_else() -> None:
    bound = Style(picture(), {"shallow": 1.0, "deep": 1.0}, "swd").bind(SmallNetwork(), HEIGHT, WIDTH)
    expected = [bound.drawn((1, 2, seed))(views()).item() for seed in range(3)]
    assert len(set(expected)) == 3
    torch.rand(3)
    assert [bound.drawn((1, 2, seed))(views()).item() for seed in range(3)] == expected
    others = Style(picture(), {"deep": 1.0}).bind(SmallNetwork(), HEIGHT, WIDTH)
    assert others.drawn((1,)) is others, "nothing is drawn, and recordings go on"


def smoke(n: int = 3) -> Tensor:
    """Opacities of views, with a background in the lower half."""
    opacity = torch.from_numpy(np.random.default_rng(8).random((n, HEIGHT, WIDTH)))
    opacity[:, HEIGHT // 2 :] = 0
    return opacity


@pytest.mark.parametrize("distance", STYLE_LOSSES)
def test_statistics_of_the_smoke_leave_the_background_out(distance: str) -> None:
    """What is there changes them no more than the kernels reach; those of the image it does."""
    net = SmallNetwork()
    other = views()
    other[:, HEIGHT // 2 + 1 :] = 0.3
    guides = Guides(None, Guide(smoke()))
    found = {}
    for statistics in ("image", "smoke"):
        bound = Style(picture(), {"shallow": 1.0}, distance, statistics).bind(net, HEIGHT, WIDTH)
        assert bound.of_smoke == (statistics == "smoke")
        found[statistics] = [bound.evaluate(images, guides)[0].item() for images in (views(), other)]
    assert found["smoke"][0] == found["smoke"][1]
    assert abs(found["image"][0] / found["image"][1] - 1) > 1e-3


def test_only_terms_that_ask_take_statistics_of_the_smoke() -> None:
    net, guides = SmallNetwork(), Guides(None, Guide(smoke()))
    for term in (Content(picture(), "deep"), Semantic("deep", (1,)), Style(picture(), {"deep": 1.0})):
        bound = term.bind(net, HEIGHT, WIDTH)
        assert bound.evaluate(views(), guides)[0].item() == bound(views()).item()
    both = Style(picture(), {"deep": 1.0}, "gram", "smoke") + Content(picture(), "deep")
    terms = both.bind(net, HEIGHT, WIDTH).evaluate(views(), guides)[1]
    apart = both.bind(net, HEIGHT, WIDTH).evaluate(views(), Guides(guides.smoke))[1]
    assert terms["style picture"].item() == pytest.approx(apart["style picture"].item(), rel=1e-12)
    assert terms["content picture deep"].item() != pytest.approx(apart["content picture deep"].item(), rel=1e-3)


def test_gram_matrices_of_the_smoke_against_sums_over_positions() -> None:
    net = SmallNetwork()
    alpha = np.random.default_rng(3).random((HEIGHT, WIDTH)).astype(np.float32)
    image = GreyImage("masked", picture().grey, alpha)
    wanted = features(net, torch.from_numpy(image.grey).double()[None], "shallow")[0]

    def gram(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return np.einsum("ahw,bhw,hw->ab", values, values, weights) / weights.sum()

    target = gram(wanted, alpha.astype(float))
    expected = sum(
        np.square(gram(view, opacity) - target).sum() / np.square(target).sum()
        for view, opacity in zip(features(net, views(), "shallow"), smoke().numpy(), strict=True)
    )
    bound = Style(image, {"shallow": 1.0}, "gram", "smoke").bind(net, HEIGHT, WIDTH)
    found = bound.evaluate(views(), Guides(None, Guide(smoke())))[0].item()
    assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("distance", STYLE_LOSSES)
def test_a_view_without_smoke_has_no_loss_and_no_derivative(distance: str) -> None:
    opacity = smoke()
    opacity[1] = 0
    bound = Style(picture(), {"shallow": 1.0, "deep": 1.0}, distance, "smoke").bind(SmallNetwork(), HEIGHT, WIDTH)
    images = views().requires_grad_()
    loss = bound.evaluate(images, Guides(None, Guide(opacity)))[0]
    (derivative,) = torch.autograd.grad(loss, images)
    assert not derivative[1].any() and derivative[0].any() and torch.isfinite(derivative).all()
    others = bound.evaluate(views()[[0, 2]], Guides(None, Guide(opacity[[0, 2]])))[0]
    assert loss.item() == pytest.approx(others.item(), rel=1e-12)


def test_weighted_distances_do_not_jump_where_numbers_change_places() -> None:
    for small in (1e-9, -1e-9):
        found = [
            wasserstein([0.5 + sign * small, 0.5, 0.1], [0.0, 0.2, 0.9], weights=[0.6, 0.1, 0.3]) for sign in (-1, 1)
        ]
        assert found[0] == pytest.approx(found[1], abs=1e-8)


def test_the_derivative_of_weighted_distances_is_that_of_central_differences() -> None:
    """Of many numbers with weights of any size, some of them 0, at steps in which some change places."""
    rng = np.random.default_rng(12)
    target = target_of(random_features(3, 9, 7, seed=1), rng.random((9, 7)))
    weights = rng.random((1, 20, 20)) ** 8 * (rng.random((1, 20, 20)) > 0.3)
    loss, guide = sliced_distance(target, 1.0, directions(target, (3,))), Guide(torch.from_numpy(weights))
    values, along = random_features(3, 20, 20, seed=2) + 0.1, torch.from_numpy(rng.normal(size=(1, 3, 20, 20)))
    values.requires_grad_()
    loss(values, guide).sum().backward()
    assert values.grad is not None
    slope = float((values.grad * along).sum())
    with torch.no_grad():
        for step in (1e-3, 1e-5):
            ends = [float(loss(values + sign * step * along, guide)) for sign in (1, -1)]
            assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(slope, rel=2e-3)


def test_a_weighted_distance_is_that_of_numbers_that_occur_as_often() -> None:
    values, repeated = [0.3, -0.2, 1.0], [0.3, 0.3, -0.2, 1.0, 1.0, 1.0]
    wanted = [0.0, 0.1, 0.2, 0.5, 0.7, 0.9]
    assert wasserstein(values, wanted, weights=[2, 1, 3]) == pytest.approx(wasserstein(repeated, wanted), rel=1e-12)

"""Objectives: their gradients and symmetries for every term, their algebra, names and scales."""

from __future__ import annotations

import gc

import numpy as np
import pytest
import torch
from small_network import HEIGHT, TERMS, WIDTH, SmallNetwork, gradient, picture, value, views

from tnst_mi.errors import InputError
from tnst_mi.losses.scales import SMALLEST_SCALE, rms_scales
from tnst_mi.losses.style import Style
from tnst_mi.losses.terms import ClassTag, Content, Semantic


@pytest.fixture
def net() -> SmallNetwork:
    return SmallNetwork()


def test_measuring_what_is_saved_keeps_nothing(net: SmallNetwork) -> None:
    """tanh saves its own result: kept by a hook as it is, that would hold the graph for ever, in each run anew."""

    def alive() -> int:
        gc.collect()
        return sum(issubclass(type(kept), torch.Tensor) for kept in gc.get_objects())

    def measured() -> int:
        return TERMS["style"].bind(net, HEIGHT, WIDTH).saved_bytes

    expected, before = measured(), alive()
    assert [measured() for _ in range(3)] == [expected] * 3
    assert alive() == before and expected > 0


# ---- gradients and symmetries ----------------------------------------------------------------------------


#: Of the differences: small enough that no two features change places, which sorts would notice.
STEP = 1e-7


@pytest.mark.parametrize("kind", TERMS)
def test_gradients_agree_with_central_differences(net: SmallNetwork, kind: str) -> None:
    bound = TERMS[kind].bind(net, HEIGHT, WIDTH).calibrated(views())
    images = views().requires_grad_()
    (analytic,) = torch.autograd.grad(bound(images), images)
    step = STEP
    generator = torch.Generator().manual_seed(1)
    for _ in range(8):
        direction = torch.randn(images.shape, generator=generator, dtype=torch.float64)
        with torch.no_grad():
            difference = (bound(images + step * direction) - bound(images - step * direction)) / (2 * step)
        assert difference.item() == pytest.approx((analytic * direction).sum().item(), rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("kind", TERMS)
def test_views_are_summed_whatever_their_order(net: SmallNetwork, kind: str) -> None:
    images, order = views(4), [2, 0, 3, 1]
    together = gradient(TERMS[kind], net, images)
    torch.testing.assert_close(gradient(TERMS[kind], net, images[order]), together[order])
    singles = [gradient(TERMS[kind], net, image[None]) for image in images]
    torch.testing.assert_close(torch.cat(singles), together)
    assert value(TERMS[kind], net, images) == pytest.approx(sum(value(TERMS[kind], net, i[None]) for i in images))


@pytest.mark.parametrize("kind", TERMS)
def test_evaluation_changes_neither_its_input_nor_its_answer(net: SmallNetwork, kind: str) -> None:
    bound = TERMS[kind].bind(net, HEIGHT, WIDTH)
    images = views()
    first = bound(images)
    bound.gradient_square_sum(images)
    assert torch.equal(images, views()) and not images.requires_grad
    assert torch.equal(bound(images), first)


# ---- sigma -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", TERMS)
def test_sigma_is_the_sum_of_the_pixels_of_each_view(net: SmallNetwork, kind: str) -> None:
    """Eq. 2, view by view: the value, and the derivative with that of σ, Lᵢ ∂σ + σ ∂Lᵢ."""
    images = views(4) * torch.tensor([1.0, 0.1, 3.0, 0.5], dtype=torch.float64)[:, None, None]
    plain = [value(TERMS[kind], net, image[None]) for image in images]
    derivatives = [gradient(TERMS[kind], net, image[None])[0] for image in images]
    sums = [float(image.sum()) for image in images]
    leaf = images.clone().requires_grad_()
    bound = TERMS[kind].bind(net, HEIGHT, WIDTH, sigma=True)
    total = bound(leaf)
    assert total.item() == pytest.approx(np.dot(sums, plain), rel=1e-12)
    (found,) = torch.autograd.grad(total, leaf)
    expected = [loss + sigma * by for loss, sigma, by in zip(plain, sums, derivatives, strict=True)]
    torch.testing.assert_close(found, torch.stack(expected))


@pytest.mark.parametrize("kind", TERMS)
def test_gradients_with_sigma_agree_with_central_differences(net: SmallNetwork, kind: str) -> None:
    bound = TERMS[kind].bind(net, HEIGHT, WIDTH, sigma=True).calibrated(views())
    images = views().requires_grad_()
    (analytic,) = torch.autograd.grad(bound(images), images)
    generator, step = torch.Generator().manual_seed(1), STEP
    for _ in range(4):
        direction = torch.randn(images.shape, generator=generator, dtype=torch.float64)
        with torch.no_grad():
            difference = (bound(images + step * direction) - bound(images - step * direction)) / (2 * step)
        assert difference.item() == pytest.approx((analytic * direction).sum().item(), rel=1e-6, abs=1e-7)


def test_a_batch_with_sigma_is_the_same_as_its_views(net: SmallNetwork, monkeypatch: pytest.MonkeyPatch) -> None:
    """All views through the network together, as on a GPU."""
    bound = TERMS["sum"].bind(net, HEIGHT, WIDTH, sigma=True)
    images = views(5)
    single, square_sums = [bound.evaluate(images), bound.evaluate(images.clone().requires_grad_())], {}
    for image in images:
        for name, (square_sum, count) in bound.gradient_square_sum(image[None]).items():
            before = square_sums.get(name, (0.0, 0))
            square_sums[name] = (before[0] + square_sum, before[1] + count)
    monkeypatch.setattr(bound, "_parts", lambda images: [slice(0, len(images))])
    for (value_by_view, terms_by_view), leaf in zip(single, (images, images.clone().requires_grad_()), strict=True):
        together, terms = bound.evaluate(leaf)
        torch.testing.assert_close(together, value_by_view)
        assert {name: term.item() for name, term in terms.items()} == pytest.approx(
            {name: term.item() for name, term in terms_by_view.items()}
        )
    for name, (square_sum, count) in bound.gradient_square_sum(images).items():
        assert (square_sum, count) == (pytest.approx(square_sums[name][0]), square_sums[name][1])


# ---- algebra and scales ----------------------------------------------------------------------------------


def test_objectives_add_and_scale(net: SmallNetwork) -> None:
    a, b, c = Semantic("deep", (1,)), Style(picture(), {"deep": 1.0}), ClassTag("dog")
    values = [value(term, net, views()) for term in (a, b, c)]
    combined = 2 * (a + 0.5 * b) + -c * np.float32(3)
    assert value(combined, net, views()) == pytest.approx(np.dot([2, 1, -3], values), rel=1e-12)
    assert value(-(a + b), net, views()) == pytest.approx(-value(a + b, net, views()), rel=1e-12)
    with pytest.raises(TypeError):
        a + 1
    with pytest.raises(TypeError):
        a * b


def test_names_are_readable_and_unique(net: SmallNetwork) -> None:
    image = picture(name="fire.png")
    objective = (
        Style(image, {"deep": 1.0})
        + Style(image, {"shallow": 1.0})
        + Semantic("deep", (1, 4))
        + Content(image, "deep")
        + ClassTag("dog")
    )
    names = ["style fire.png", "style fire.png #2", "semantic deep:1,4", "content fire.png deep", "tag dog"]
    assert objective.names == names
    assert list(objective.bind(net, HEIGHT, WIDTH).evaluate(views())[1]) == names


def test_terms_are_the_raw_values(net: SmallNetwork) -> None:
    a, b = Semantic("deep", (1,)), Style(picture(), {"deep": 1.0})
    bound = (3 * a + 0.1 * b).bind(net, HEIGHT, WIDTH).calibrated(views())
    for images in (views(), views().requires_grad_()):
        _, terms = bound.evaluate(images)
        for term in (a, b):
            raw = terms[term.name]
            assert not raw.requires_grad and raw.item() == pytest.approx(value(term, net, views()), rel=1e-12)


def test_calibration_gives_each_term_a_gradient_of_rms_one_times_its_weight(net: SmallNetwork) -> None:
    terms = [1e6 * Semantic("deep", (1,)), 0.02 * Style(picture(), {"deep": 1e-4}), -ClassTag("dog")]
    for objective, weight in zip(terms, (1e6, 0.02, 1.0), strict=True):
        bound = objective.bind(net, HEIGHT, WIDTH).calibrated(views())
        images = views().requires_grad_()
        (g,) = torch.autograd.grad(bound(images), images)
        assert g.square().mean().sqrt().item() == pytest.approx(weight, rel=1e-10)
    together = (terms[0] + terms[1] + terms[2]).bind(net, HEIGHT, WIDTH).calibrated(views())
    for term in terms:
        single = term.bind(net, HEIGHT, WIDTH).calibrated(views())
        assert together.scales[term.names[0]] == pytest.approx(single.scales[term.names[0]], rel=1e-12)


def test_scales_pool_over_batches_like_one_batch_and_go_through_a_checkpoint(net: SmallNetwork) -> None:
    objective = Semantic("deep", (1,)) + Style(picture(), {"deep": 1.0})
    bound = objective.bind(net, HEIGHT, WIDTH)
    pooled = rms_scales(bound.gradient_square_sum(batch) for batch in (views(5)[:1], views(5)[1:]))
    bound = bound.calibrated(views(5))
    assert pooled == pytest.approx(bound.scales, rel=1e-12)
    assert all(type(scale) is float for scale in bound.scales.values())
    restored = objective.bind(net, HEIGHT, WIDTH).scaled(dict(reversed(bound.scales.items())))
    assert torch.equal(restored(views()), bound(views()))
    with pytest.raises(InputError, match="loss scales"):
        ClassTag("dog").bind(net, HEIGHT, WIDTH).scaled(bound.scales)


def test_a_term_at_its_minimum_is_not_amplified(net: SmallNetwork) -> None:
    same = torch.from_numpy(picture().grey).double()[None]
    bound = Content(picture(), "deep").bind(net, HEIGHT, WIDTH).calibrated(same)
    assert list(bound.scales.values()) == [SMALLEST_SCALE]
    images = same.requires_grad_()
    assert torch.autograd.grad(bound(images), images)[0].abs().max() < 1e-3


def test_scales_do_not_take_part_in_the_gradient_and_need_no_grad_mode(net: SmallNetwork) -> None:
    bound = Style(picture(), {"deep": 1.0}).bind(net, HEIGHT, WIDTH)
    with torch.no_grad():
        bound = bound.calibrated(views())
    scale = bound.scales["style picture"]
    torch.testing.assert_close(
        gradient(Style(picture(), {"deep": 1.0 / scale}), net, views()),
        torch.autograd.grad(bound(images := views().requires_grad_()), images)[0],
    )


def test_one_network_evaluation_serves_all_terms_of_a_view(net: SmallNetwork) -> None:
    objective = Semantic("alias_of_deep", (1,)) + Style(picture(), {"deep": 1.0, "shallow": 1.0})
    bound = objective.bind(net, HEIGHT, WIDTH)
    net.asked.clear()
    bound(views())
    assert [sorted(layers) for layers in net.asked] == [["deep", "shallow"]] * len(views())


def test_images_of_another_size_than_bound_are_refused(net: SmallNetwork) -> None:
    with pytest.raises(ValueError, match="expected \\(N, 12, 10\\)"):
        Semantic("deep", (1,)).bind(net, HEIGHT, WIDTH)(views()[:, 1:])

"""Loss terms against closed forms on a small smooth network, and on the real one where it is at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from small_network import HEIGHT, WIDTH, SmallNetwork, features, picture, value, views

from tnst_mi.errors import InputError
from tnst_mi.losses.objective import Objective
from tnst_mi.losses.pictures import GreyImage, resized
from tnst_mi.losses.style import Style
from tnst_mi.losses.terms import ClassTag, Content, Match, Semantic


@pytest.fixture
def net() -> SmallNetwork:
    return SmallNetwork()


@pytest.mark.parametrize("channels", [(0,), (5,), (1, 4), (4, 1, 4), tuple(range(6))])
@pytest.mark.parametrize("damping", [0.0, 0.7])
def test_semantic_is_the_negated_mean_plus_damping(net: SmallNetwork, channels: tuple, damping: float) -> None:
    deep = features(net, views(), "deep")
    others = np.delete(deep, channels, axis=1)
    expected = -deep[:, list(set(channels))].mean((1, 2, 3)).sum()
    if others.size:
        expected += damping * np.abs(others).mean((1, 2, 3)).sum()
    assert value(Semantic("deep", channels, damping), net, views()) == pytest.approx(expected, rel=1e-12)


def test_class_tag_is_the_negated_logit(net: SmallNetwork) -> None:
    assert value(ClassTag("cloud"), net, views()) == pytest.approx(-features(net, views(), "logits")[:, 3].sum())


@pytest.mark.parametrize("shape", [(), (6, 1, 1), (5,), (6, 6, 5)])
def test_match_is_the_mean_squared_difference_to_the_map(net: SmallNetwork, shape: tuple[int, ...]) -> None:
    target = np.random.default_rng(2).normal(size=shape)
    expected = np.square(features(net, views(), "deep") - target).mean((1, 2, 3)).sum()
    assert value(Match("deep", target), net, views()) == pytest.approx(expected, rel=1e-12)


def area_means(length: int, bins: int) -> np.ndarray:
    """Oracle: (bins, length) weights of averages over whole cells that a bin touches, the area average of torch."""
    weights = np.zeros((bins, length))
    for i in range(bins):
        low, high = i * length // bins, -(-(i + 1) * length // bins)
        weights[i, low:high] = 1 / (high - low)
    return weights


def linear(length: int, points: int) -> np.ndarray:
    """Oracle: (points, length) weights of linear interpolation between cell centres, clamped at the ends."""
    at = np.clip((np.arange(points) + 0.5) * length / points - 0.5, 0, length - 1)
    return np.maximum(1 - np.abs(at[:, None] - np.arange(length)), 0)


@pytest.mark.parametrize(("rows", "columns"), [(3, 2), (12, 10), (13, 3), (1, 9), (6, 5)])
def test_a_map_is_resampled_to_its_layer(net: SmallNetwork, rows: int, columns: int) -> None:
    """Averages over areas along an axis that shrinks, linear along one that grows; 6×5 is the layer's own size."""
    target = np.random.default_rng(2).normal(size=(6, rows, columns))
    along = [
        area_means(length, size) if length > size else linear(length, size)
        for length, size in ((rows, HEIGHT // 2), (columns, WIDTH // 2))
    ]
    wanted = np.einsum("yh,xw,chw->cyx", *along, target)
    expected = np.square(features(net, views(), "deep") - wanted).mean((1, 2, 3)).sum()
    assert value(Match("deep", target), net, views()) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("shape", [(5,), (5, 1, 1)])
def test_logits_match_a_vector(net: SmallNetwork, shape: tuple[int, ...]) -> None:
    target = np.linspace(-1, 1, 5).reshape(shape)
    expected = np.square(features(net, views(), "logits") - target.ravel()).mean(1).sum()
    assert value(Match("logits", target), net, views()) == pytest.approx(expected, rel=1e-12)


def test_content_matches_the_features_of_the_cropped_and_resized_picture(net: SmallNetwork) -> None:
    wide = picture(height=2 * HEIGHT, width=5 * WIDTH)
    fitted = torch.from_numpy(wide.fitted(HEIGHT, WIDTH).grey).double()[None]
    difference = features(net, views(), "deep") - features(net, fitted, "deep")
    expected = np.square(difference).mean((1, 2, 3)).sum()
    assert value(Content(wide, "deep"), net, views()) == pytest.approx(expected, rel=1e-12)


def style_loss(rendered: np.ndarray, target: np.ndarray) -> float:
    """Oracle: Eq. 6 and 7 with explicit sums, for one view (C, H, W)."""
    gram, gram_target = (np.einsum("ahw,bhw->ab", f, f) for f in (rendered, target))
    return ((gram - gram_target) ** 2).sum() / (gram_target**2).sum()


def test_style_is_the_distance_of_gram_matrices(net: SmallNetwork) -> None:
    weights = {"shallow": 2.0, "alias_of_deep": 0.5}
    target = torch.from_numpy(picture().grey).double()[None]
    expected = sum(
        weight * style_loss(view, features(net, target, layer)[0])
        for layer, weight in weights.items()
        for view in features(net, views(), layer)
    )
    assert value(Style(picture(), weights), net, views()) == pytest.approx(expected, rel=1e-12)


def test_style_loss_of_the_paper_divides_by_4_c2_a2(net: SmallNetwork) -> None:
    """Eq. 7 with Gram matrices that are sums over the A positions of a layer with C channels."""
    weights = {"shallow": 2.0, "alias_of_deep": 0.5}
    target = torch.from_numpy(picture().grey).double()[None]
    expected = 0.0
    for layer, weight in weights.items():
        wanted = features(net, target, layer)[0]
        for view in features(net, views(), layer):
            channels, area = len(view), view[0].size
            gram, gram_wanted = (np.einsum("ahw,bhw->ab", f, f) for f in (view, wanted))
            expected += weight * ((gram - gram_wanted) ** 2).sum() / (4 * channels**2 * area**2)
    assert value(Style(picture(), weights, "paper"), net, views()) == pytest.approx(expected, rel=1e-12)
    assert value(Style(picture(), weights), net, views()) != pytest.approx(expected, rel=0.5)


@pytest.mark.parametrize("term", [Style(picture(), {"shallow": 1.0, "deep": 1.0}), Content(picture(), "deep")])
def test_a_rendering_equal_to_the_picture_has_no_loss(net: SmallNetwork, term: Objective) -> None:
    same = torch.from_numpy(picture().grey).double()[None]
    assert value(term, net, same) < 1e-25 < 1e-6 < value(term, net, views(1))


def test_style_ignores_where_things_are_and_content_does_not(net: SmallNetwork) -> None:
    """A picture mirrored left to right: with a network of mirrored kernels the features just move."""
    net.first.weight.copy_((net.first.weight + net.first.weight.flip(3)) / 2)
    mirrored = GreyImage("mirrored", picture().grey[:, ::-1])
    images = torch.from_numpy(picture().grey).double()[None]
    assert value(Style(mirrored, {"shallow": 1.0}), net, images) < 1e-25
    assert value(Content(mirrored, "shallow"), net, images) > 1e-3


def test_alpha_takes_features_out_of_the_style(net: SmallNetwork) -> None:
    """With the lower half masked the picture there does not matter, beyond the reach of the kernels."""
    alpha = np.ones((HEIGHT, WIDTH), np.float32)
    alpha[HEIGHT // 2 :] = 0.0
    other = picture().grey.copy()
    other[HEIGHT // 2 + 1 :] = 0.25  # the 3 x 3 kernel of the last visible row sees one row further
    losses = [
        value(Style(GreyImage("masked", grey, alpha), {"shallow": 1.0}), net, views())
        for grey in (picture().grey, other)
    ]
    assert losses[0] == pytest.approx(losses[1], rel=1e-12)
    assert value(Style(picture(), {"shallow": 1.0}), net, views()) != pytest.approx(losses[0], rel=1e-3)
    target = torch.from_numpy(picture().grey).double()[None]
    masked = features(net, target, "shallow")[0] * alpha
    expected = sum(style_loss(view, masked) for view in features(net, views(), "shallow"))
    assert losses[0] == pytest.approx(expected, rel=1e-12), "the divisor keeps the whole area"


def test_alpha_is_resized_to_the_feature_map(net: SmallNetwork) -> None:
    alpha = np.random.default_rng(3).random((HEIGHT, WIDTH)).astype(np.float32)
    image = GreyImage("masked", picture().grey, alpha)
    target = torch.from_numpy(image.grey).double()[None]
    masked = features(net, target, "deep")[0] * resized(alpha, HEIGHT // 2, WIDTH // 2)
    expected = sum(style_loss(view, masked) for view in features(net, views(), "deep"))
    assert value(Style(image, {"deep": 1.0}), net, views()) == pytest.approx(expected, rel=1e-12)


# ---- bad input -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make, complaint",
    [
        (lambda net: Semantic("nowhere", (0,)).bind(net, HEIGHT, WIDTH), "nowhere"),
        (lambda net: Semantic("deep", (6,)).bind(net, HEIGHT, WIDTH), "channel"),
        (lambda net: Semantic("deep", ()).bind(net, HEIGHT, WIDTH), "no channel"),
        (lambda net: Style(picture(), {"nowhere": 1.0}).bind(net, HEIGHT, WIDTH), "nowhere"),
        (lambda net: Style(picture(), {"logits": 1.0}).bind(net, HEIGHT, WIDTH), "positions"),
        (lambda net: Style(picture(), {}), "style layers"),
        (lambda net: Style("nowhere.png", {"deep": 1.0}), "nowhere.png"),
        (lambda net: Content("nowhere.png", "deep"), "nowhere.png"),
        (lambda net: Match("deep", np.zeros((5, 6, 5))).bind(net, HEIGHT, WIDTH), "expected 6 channels"),
        (lambda net: Match("deep", np.zeros((2, 6, 6, 5))).bind(net, HEIGHT, WIDTH), "expected 6 channels"),
        (lambda net: Match("logits", np.zeros((5, 2, 1))).bind(net, HEIGHT, WIDTH), "expected 5 channels"),
        (lambda net: Objective([]), "no term"),
    ],
)
def test_bad_input_is_named_in_one_line(net: SmallNetwork, make: object, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint) as error:
        make(net)
    assert "\n" not in str(error.value)


# ---- files, and the real network -------------------------------------------------------------------------


def test_a_picture_file_serves_as_style(net: SmallNetwork, tmp_path: Path) -> None:
    pixels = np.random.default_rng(4).integers(0, 256, (30, 40, 4), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "style.png")
    grey = GreyImage("style.png", pixels[..., :3].mean(-1) / 255, pixels[..., 3] / 255)
    from_file, from_arrays = Style(tmp_path / "style.png", {"deep": 1.0}), Style(grey, {"deep": 1.0})
    assert from_file.name == "style style.png"
    assert value(from_file, net, views()) == pytest.approx(value(from_arrays, net, views()), rel=1e-6)


def test_terms_on_googlenet(bvlc_weights: Path, asset: object) -> None:
    from tnst_mi.network.googlenet import GoogLeNet

    net = GoogLeNet.load(bvlc_weights)
    layers = {"conv2/3x3": 1.0, "inception_3b/output": 1.0, "inception_4b/output": 1.0}
    fire = Style(asset("styles/fire.png"), layers)
    images = torch.rand((2, 48, 32), generator=torch.Generator().manual_seed(0))
    same = torch.from_numpy(fire.picture.fitted(48, 32).grey)[None]
    alone = fire.bind(net, 48, 32)
    assert alone(same).item() < 1e-8 * alone(images[:1]).item()

    bound = (fire + Semantic("inception_4b/pool_proj", (16,)) + ClassTag("volcano")).bind(net, 48, 32)
    bound = bound.calibrated(images)
    for name, (square_sum, count) in bound.gradient_square_sum(images).items():
        assert np.sqrt(square_sum / count) == pytest.approx(bound.scales[name], rel=1e-4)
    volcano = net.class_index("volcano")
    logits = net(images[:, None].repeat(1, 3, 1, 1), layers=["logits"])["logits"]
    assert bound.evaluate(images)[1]["tag volcano"].item() == pytest.approx(-logits[:, volcano].sum().item(), rel=1e-4)


def test_a_layer_named_twice_counts_twice(net: SmallNetwork) -> None:
    """By its name and by an alias."""
    twice = value(Style(picture(), {"deep": 1.0, "alias_of_deep": 0.5}), net, views())
    assert twice == pytest.approx(value(Style(picture(), {"deep": 1.5}), net, views()), rel=1e-12)


def test_a_picture_without_structure_where_it_is_used_is_no_style(net: SmallNetwork) -> None:
    """Its corners have some, which the crop to the smoke's aspect leaves out."""
    grey = np.full((20, 80), 0.5, np.float32)
    grey[:, :8] = np.linspace(0, 1, 8)
    with pytest.raises(InputError, match=r"plain\.png: one grey all over where it is used .*, which is no style"):
        Style(GreyImage("plain.png", grey), {"deep": 1.0}).bind(net, HEIGHT, WIDTH)
    Style(GreyImage("left.png", grey[:, :20]), {"deep": 1.0}).bind(net, HEIGHT, WIDTH)


def test_a_layer_that_does_not_respond_to_a_picture_is_named(net: SmallNetwork) -> None:
    class Silent(SmallNetwork):
        def forward(self, x: torch.Tensor, layers: list[str]) -> dict[str, torch.Tensor]:
            return {layer: torch.zeros_like(values) for layer, values in super().forward(x, layers).items()}

    silent = Silent()
    with pytest.raises(InputError, match="picture: no channel of style layer 'deep' responds to it; use another layer"):
        Style(picture(), {"deep": 1.0}).bind(silent, HEIGHT, WIDTH)


def test_pictures_with_values_that_are_not_finite_are_refused() -> None:
    grey = np.full((4, 5), 0.5, np.float32)
    grey[1, 2:4] = np.nan, np.inf
    for planes in ((grey, None), (np.zeros((4, 5), np.float32), grey)):
        with pytest.raises(InputError, match=r"odd: 2 of 20 pixels are not finite, expected values in \[0, 1\]"):
            GreyImage("odd", *planes)


def test_a_picture_that_is_transparent_where_it_is_used_is_refused(net: SmallNetwork) -> None:
    """Opaque only at its left edge, which the crop to the smoke's aspect leaves out."""
    alpha = np.zeros((20, 80), np.float32)
    alpha[:, :8] = 1
    image = GreyImage("edge.png", np.tile(np.linspace(0, 1, 80, dtype=np.float32), (20, 1)), alpha)
    with pytest.raises(InputError, match=r"edge\.png: transparent where it is used"):
        Style(image, {"deep": 1.0}).bind(net, HEIGHT, WIDTH)

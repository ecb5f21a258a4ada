"""scripts/figures: the numbers that figures are judged by, how they are drawn, and the page that shows them."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from fields import blob, smooth_noise
from PIL import Image

import tnst_mi

tnst_mi.activate()
from figures import MODULES, figure_named, measures  # noqa: E402
from figures.figure import Claim, Figure, Made, Panel, Plot, draw, write_numbers  # noqa: E402
from figures.page import page, palette_png, write_page  # noqa: E402
from figures.seen import smoke_box  # noqa: E402
from figures.setting import SCENES, Setting  # noqa: E402

RUN = {"command": "python scripts/reproduce.py density", "size": "small", "seconds": 61.4, "device": {"variant": "v"}}


def made(**changes: object) -> Made:
    picture = np.linspace(0, 1, 6 * 4).reshape(6, 4)
    curve = Plot({"a": ([1, 2], [3, 4])}, "x", "y")
    rows = [[Panel(picture, "one\ntwo"), curve], [Panel(np.stack([picture] * 3, -1))]]
    return Made(rows, [Claim("It is 3", True), Claim("It is 4", False)], {"it": 3.0}, **changes)


def figure(title: str = "Transport, and λ") -> Figure:
    return Figure(title, "It is 3 or 4.", lambda setting: made(), "We count.")


# ---------------------------------------------------------------- measures


def test_spectral_centroid_of_a_wave_is_its_frequency() -> None:
    x = np.arange(64)
    waves = {period: np.sin(2 * np.pi * x / period) + np.zeros((32, 1)) for period in (4, 16)}
    for period, wave in waves.items():
        assert measures.spectral_centroid(3 + wave) == pytest.approx(1 / period, rel=1e-6)
    # Energies of 1 and 4 weigh the frequencies.
    both = waves[4] + 2 * waves[16]
    assert measures.spectral_centroid(both) == pytest.approx((1 / 4 + 4 / 16) / 5, rel=1e-6)
    assert measures.spectral_centroid(np.full((8, 8), 0.3)) == 0.0


def test_spread_is_the_standard_deviation_in_the_plane() -> None:
    rows, columns = np.indices((60, 80))
    for sigma in (2.0, 5.0):
        bell = np.exp(-((rows - 28) ** 2 + (columns - 41) ** 2) / (2 * sigma**2))
        assert measures.spread(bell) == pytest.approx(np.sqrt(2) * sigma, rel=1e-4)
    two = np.zeros((9, 9))
    two[4, 1] = two[4, 7] = 0.3
    assert measures.spread(two) == pytest.approx(3)


def test_radial_spectrum_has_a_wave_in_its_ring_and_shares_that_add_up() -> None:
    x = np.arange(64)
    wave = np.cos(2 * np.pi * x / 8) + np.zeros((64, 1))
    frequency, power = measures.radial_spectrum(wave, bins=16)
    assert abs(frequency[power.argmax()] - 1 / 8) <= 1 / 32
    assert np.sort(power)[-2] < 1e-9 * power.max()
    noise = np.random.default_rng(1).standard_normal((256, 256))
    frequency, power = measures.radial_spectrum(noise)
    np.testing.assert_allclose(power * noise.size, 1, atol=0.25)
    assert np.all(np.diff(frequency) > 0) and frequency[-1] < 0.5


def test_correlation_length_of_waves_in_all_directions() -> None:
    """Their autocorrelation is Bessel's J0, which first is 0 at 2.405 / (2π) periods."""
    rng, rows = np.random.default_rng(5), np.arange(400)
    for period in (12.0, 24.0):
        angles, phases = rng.uniform(0, np.pi, 400), rng.uniform(0, 2 * np.pi, 400)
        wave = sum(
            np.cos(2 * np.pi / period * (np.cos(a) * rows + np.sin(a) * rows[:, None]) + p)
            for a, p in zip(angles, phases, strict=True)
        )
        assert measures.correlation_length(np.asarray(wave)) == pytest.approx(2.405 / (2 * np.pi) * period, rel=0.06)


def test_masses_and_what_appears_where_there_was_none() -> None:
    before, after = np.zeros((4, 4, 4)), np.zeros((4, 4, 4))
    before[1], after[1], after[2] = 1.0, 0.75, 0.5
    assert measures.mass_change(before, after) == pytest.approx(0.25)
    assert measures.appeared(before, after) == pytest.approx(0.5)
    assert measures.appeared(before, before) == 0.0
    # Sorted, 16 cells of 1 face 0.75 and 16 of 0 face 0.5.
    assert measures.made_or_removed(before, after) == pytest.approx(0.25 + 0.5)
    assert measures.made_or_removed(before, before[::-1]) == 0.0


def test_gradients_have_no_curl_and_curls_no_divergence() -> None:
    """With potentials that vanish near the walls the squares of both add up to all derivatives."""
    rng = np.random.default_rng(2)
    inside = blob((20, 22, 24), (12, 11, 10), 2.5)
    gradient = tnst_mi.velocity(inside * smooth_noise(rng, 20, 22, 24), None, 1.0)
    curl = tnst_mi.velocity(None, inside[..., None] * smooth_noise(rng, 20, 22, 24, 3), 0.0)
    assert measures.relative_divergence(curl) < 1e-6 and measures.relative_curl(gradient) < 1e-6
    assert measures.relative_divergence(gradient) == pytest.approx(1, rel=1e-3)
    assert measures.relative_curl(curl) == pytest.approx(1, rel=1e-3)
    both = gradient + 2 * curl
    assert measures.relative_divergence(both) ** 2 + measures.relative_curl(both) ** 2 == pytest.approx(1, rel=1e-3)
    assert measures.relative_divergence(np.zeros((4, 4, 4, 3), np.float32)) == 0.0


def test_distance_counts_cells_along_the_longest_axis() -> None:
    smoke = np.zeros((9, 12, 15), bool)
    smoke[4, 5, 6] = True
    expected = np.abs(np.indices(smoke.shape) - np.array([4, 5, 6])[:, None, None, None]).max(0)
    np.testing.assert_array_equal(measures.cells_outside(smoke), expected)
    np.testing.assert_array_equal(measures.cells_outside(smoke, 4), np.minimum(expected, 4))


def test_depth_of_a_change_is_the_share_of_the_smoke_in_front() -> None:
    """The camera of the view (0, 0) is at the end of the z axis."""
    density = np.ones((10, 3, 4), np.float32)
    density[:, 0] = 0
    for z, depth in ((9, 0.05), (0, 0.95), (4, 0.55)):
        change = np.zeros_like(density)
        change[z] = -0.3
        assert measures.depth_of_change(density, change) == pytest.approx(depth)
    # As much everywhere, and none at all, are even.
    assert measures.depth_of_change(density, density) == pytest.approx(0.5)
    assert measures.depth_of_change(density, 0 * density) == 0.5
    # Where there is little smoke in front, the next of it is near.
    density[5:, 1:] = 1e-3
    change[:] = 0
    change[4, 1:] = 1
    assert measures.depth_of_change(density, change) == pytest.approx((5e-3 + 0.5) / 5.005)


def test_share_of_a_change_that_is_seen_is_the_transmittance_to_it() -> None:
    density = np.full((10, 3, 4), 0.5, np.float32)
    change = np.zeros_like(density)
    change[9] = 2
    assert measures.visible_share(density, change, 0.8) == pytest.approx(np.exp(-0.8 * 0.25))
    change[7] = 1
    expected = (4 * np.exp(-0.8 * 0.25) + np.exp(-0.8 * 1.25)) / 5
    assert measures.visible_share(density, change, 0.8) == pytest.approx(expected)
    assert measures.visible_share(0 * density, change, 0.8) == 1.0
    assert measures.visible_share(density, 0 * change, 0.8) == 0.0


def test_what_follows_the_lattice_is_uneven_on_it_and_noise_is_not() -> None:
    rows, columns = np.indices((24, 32))
    board = np.where((rows + columns) % 2 == 0, 2.0, 0.0)[None]
    np.testing.assert_allclose(measures.by_phase(board, 2), [[2, 0], [0, 2]])
    assert measures.unevenness(measures.by_phase(board, 2)) == pytest.approx(1)
    assert measures.unevenness(measures.by_phase(board, 4)) == pytest.approx(1)
    # Another period does not see it, nor is there anything in noise.
    assert measures.unevenness(measures.by_phase(board, 3)) == pytest.approx(0, abs=0.02)
    noise = np.random.default_rng(4).standard_normal((8, 96, 96))
    assert measures.unevenness(measures.by_phase(noise, 4)) < 0.05


# ---------------------------------------------------------------- the smoke in pictures


def test_box_holds_all_smoke_of_all_images_and_is_not_too_narrow() -> None:
    images = np.zeros((2, 60, 50))
    images[0, 20:40, 30], images[1, 24, 10:12] = 0.5, 0.5
    assert smoke_box(images, margin=3) == (slice(17, 43), slice(7, 34))
    rows, columns = smoke_box(images[:1], margin=3)
    assert rows == slice(17, 43) and columns.start < 27 and columns.stop > 34
    assert columns.stop - columns.start == pytest.approx(26 * 2 / 3, abs=2)
    assert smoke_box(0 * images, margin=3) == (slice(0, 60), slice(0, 50))


def test_close_up_keeps_the_smoke_and_fills_its_grid(tmp_path: Path) -> None:
    density = 3 * blob((44, 50, 60), (30, 20, 25), 2.0)
    frame = tnst_mi.Frame(density.astype(np.float32), name="blob", number=7)
    near = Setting("small", tmp_path).close_up(frame)
    assert all(small < large for small, large in zip(near.density.shape, density.shape, strict=True))
    assert near.mass == pytest.approx(1.5**3 * frame.mass, rel=0.01)
    assert (near.name, near.number) == ("blob", 7)
    assert Setting("paper", tmp_path).close_up(frame) is frame


# ---------------------------------------------------------------- the frame


def test_every_figure_has_a_module_that_describes_it() -> None:
    for name in MODULES:
        described = figure_named(name)
        assert described.title and described.paper.endswith("."), name
        assert not described.differs or described.differs.endswith("."), name


def test_a_figure_is_drawn_and_its_numbers_written(tmp_path: Path) -> None:
    draw(tmp_path / "a.png", "Title", made())
    with Image.open(tmp_path / "a.png") as picture:
        pixels = np.asarray(picture.convert("RGB"), float)
    assert pixels.min() < 30 and pixels.max() == 255
    # White on all sides: nothing is cut off.
    assert (pixels[[0, -1]] == 255).all() and (pixels[:, [0, -1]] == 255).all()
    write_numbers(tmp_path / "a.json", figure(), made(notes=["Noted."]), RUN)
    record = json.loads((tmp_path / "a.json").read_text("utf-8"))
    assert record["claims"] == [{"text": "It is 3", "holds": True}, {"text": "It is 4", "holds": False}]
    assert record["differs"] == "We count. Noted." and record["numbers"] == {"it": 3.0} and record["seconds"] == 61.4


def test_smoke_that_is_not_there_is_an_input_error_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(tnst_mi.InputError, match=r"whirl: frames 3 to 5 .*scripts/simulate.py whirl"):
        Setting("small", tmp_path, data=tmp_path).smoke("whirl", 3, 5)


@pytest.mark.parametrize(
    ("name", "eta", "gamma", "octaves", "layers"),
    [
        ("semantic", 0.002, 0.1, 3, 1),
        ("style", 0.002, 0.1, 2, 3),
        ("volcano", 0.003, 10, 2, 2),
        ("sato", 0.005, 5, 2, 3),
    ],
)
def test_recipes_of_table_2_have_its_numbers(name: str, eta: float, gamma: float, octaves: int, layers: int) -> None:
    recipe = tnst_mi.Recipe.from_toml(SCENES / "paper" / f"{name}.toml")
    assert (recipe.eta, recipe.gamma, recipe.octaves) == (eta, gamma, octaves)
    assert (recipe.iterations, recipe.views, recipe.window) == (20, 9, 9)
    assert len(recipe.semantic) + bool(recipe.style) * len(recipe.style_layers) == layers


# ---------------------------------------------------------------- the page


def test_page_shows_the_figures_found_in_their_order(tmp_path: Path) -> None:
    out, docs = tmp_path / "out", tmp_path / "docs"
    out.mkdir()
    for name, title in (("table2", "Table 2: times"), ("density", "Transport, and λ")):
        draw(out / f"{name}.png", title, made())
        write_numbers(out / f"{name}.json", figure(title), made(), RUN)
    write_page(out, docs)
    text = (docs / "figures.md").read_text("utf-8")
    assert text.index("## Transport, and λ") < text.index("## Table 2: times")
    assert "| [Transport, and λ](#transport-and-λ) | 1 of 2 | 61 |" in text
    assert "- ✓ It is 3.\n- ✗ It is 4.\n" in text and "**Where we differ:** We count." in text
    assert "images/figures/density.png" in text
    assert (docs / "images" / "figures" / "density.png").stat().st_size < 250_000
    with pytest.raises(tnst_mi.InputError, match="holds no figure"):
        write_page(tmp_path / "nothing", docs)


def test_page_of_nothing_to_differ_says_nothing_of_it() -> None:
    record = {"title": "T", "paper": "P.", "claims": [], "differs": "", **RUN}
    assert "Where we differ" not in page({"density": record})


def test_pictures_are_made_smaller_until_they_fit() -> None:
    noise = np.random.default_rng(3).integers(0, 256, (300, 400, 3), np.uint8)
    data = palette_png(Image.fromarray(noise), widest=200, largest=20_000)
    with Image.open(io.BytesIO(data)) as picture:
        assert len(data) <= 20_000 and picture.mode == "P"
        assert picture.width < 200 and picture.width / picture.height == pytest.approx(4 / 3, rel=0.02)
    with Image.open(io.BytesIO(palette_png(Image.new("RGB", (30, 20), "red")))) as small:
        assert small.size == (30, 20)

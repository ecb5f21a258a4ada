"""scripts/quality.py: each measure against what is known of it, and a comparison that is resumed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import quality
import torch
from fields import blob
from moving_smoke import moving_smoke

import tnst_mi

tnst_mi.activate()
from quality_measures import flicker  # noqa: E402
from quality_measures.compared import Smoke, Trial, Variant  # noqa: E402
from quality_measures.crops import Picture, pieces, places  # noqa: E402
from quality_measures.judge import judge_of  # noqa: E402
from quality_measures.measured import measured  # noqa: E402
from quality_measures.seen import FRONT, Look, held_out_views, style_picture  # noqa: E402
from quality_measures.spectrum import contrast, energy_shares, mean_frequency, scrambled, spectral_distance  # noqa: E402
from quality_measures.speed import equal_time, of_one_iteration  # noqa: E402
from quality_measures.table import report  # noqa: E402
from quality_measures.texture import relative_texture, sliced_wasserstein, texture_distances  # noqa: E402
from quality_measures.trials import Comparison, carry_out  # noqa: E402

from tnst_mi import GoogLeNet, Recipe, render  # noqa: E402
from tnst_mi.errors import InputError  # noqa: E402
from tnst_mi.recipe.paths import STYLES  # noqa: E402

SIZE = (72, 64)
EVERYWHERE = np.ones(SIZE, bool)
SHIPPED = ("cells", "flames", "net", "spirals")


@pytest.fixture(scope="module")
def judge() -> GoogLeNet:
    return judge_of("bvlc")


def style(name: str, size: tuple[int, int] = SIZE) -> Picture:
    return style_picture(STYLES / f"{name}.png", size)


def round_smoke() -> np.ndarray:
    """A smooth ball, as pictures of unstylized smoke are."""
    row, column = np.indices(SIZE)
    return np.clip(1.2 - np.hypot(row - 36, column - 32) / 36, 0, 1).astype(np.float32)


def wave(period: float, amplitude: float = 0.5, angle: float = 0.0) -> np.ndarray:
    row, column = np.indices(SIZE)
    along = np.cos(angle) * column + np.sin(angle) * row
    return (0.5 + amplitude * np.sin(2 * np.pi * along / period)).astype(np.float32)


# ---------------------------------------------------------------- pieces


def test_pieces_are_inside_the_smoke_and_where_they_were_drawn() -> None:
    inside = np.zeros((40, 30), bool)
    inside[10:30, 5:17] = True
    corners = places(inside, 8, 200, (3, 1))
    assert np.array_equal(corners, places(inside, 8, 200, (3, 1)))
    assert not np.array_equal(corners, places(inside, 8, 200, (3, 2)))
    assert all(inside[r : r + 8, c : c + 8].mean() >= 0.5 for r, c in corners)
    plane = np.arange(1200.0).reshape(40, 30)
    assert np.array_equal(pieces(plane, corners, 8)[7], plane[corners[7][0] :, corners[7][1] :][:8, :8])


def test_pictures_without_smoke_are_refused_in_words() -> None:
    with pytest.raises(InputError, match="shows no smoke"):
        places(np.zeros((9, 9), bool), 3, 5, (0,))


# ---------------------------------------------------------------- texture


def test_sliced_wasserstein_of_a_shift_is_its_length() -> None:
    points = torch.from_numpy(np.random.default_rng(0).normal(size=(500, 3)))
    assert sliced_wasserstein(points[:, :1], points[:, :1] - 0.75) == pytest.approx(0.75, rel=1e-12)
    # Of a shift s in C dimensions, the mean of (s·θ)² over all directions θ is |s|² / C.
    shift = torch.tensor([2.0, -1.0, 0.5], dtype=torch.float64)
    expected = float(shift.norm()) / np.sqrt(3)
    assert sliced_wasserstein(points, points + shift, directions=4000) == pytest.approx(expected, rel=0.02)


def test_sliced_wasserstein_sees_what_first_and_second_moments_do_not() -> None:
    random = np.random.default_rng(1)
    normal = random.normal(size=(4000, 1))
    signs = np.sign(random.normal(size=(4000, 1)))
    signs, normal = (x - x.mean() for x in (signs, normal))
    signs, normal = (x / x.std() for x in (signs, normal))
    # W₂² = 2 − 2 E|x| for a standard normal x against ±1, with E|x| = √(2/π).
    expected = np.sqrt(2 - 2 * np.sqrt(2 / np.pi))
    found = sliced_wasserstein(torch.from_numpy(normal), torch.from_numpy(signs))
    assert found == pytest.approx(expected, rel=0.03)


def test_sliced_wasserstein_of_sets_of_different_size() -> None:
    random = np.random.default_rng(2)
    many, other = random.normal(size=(3000, 2)), random.normal((4.0, 0.0), size=(3000, 2))
    halves = torch.from_numpy(many[::2]), torch.from_numpy(many)
    assert sliced_wasserstein(*halves) < 0.05 * sliced_wasserstein(halves[0], torch.from_numpy(other))


def test_the_style_itself_has_no_distance_and_noise_a_large_one(judge: GoogLeNet) -> None:
    random = np.random.default_rng(3)
    pictures = {
        "itself": style("spirals"),
        "noise": Picture(random.random(SIZE, np.float32), EVERYWHERE),
        "smoke": Picture(round_smoke(), EVERYWHERE),
    }
    # The same texture anew: tiles of the style from anywhere, at random places.
    source, tiled = style("spirals").grey, np.empty(SIZE, np.float32)
    for row in range(0, SIZE[0], 24):
        for column in range(0, SIZE[1], 16):
            r, c = random.integers(0, SIZE[0] - 24), random.integers(0, SIZE[1] - 16)
            tiled[row : row + 24, column : column + 16] = source[r : r + 24, c : c + 16]
    pictures["synthesised"] = Picture(tiled, EVERYWHERE)
    distances = {name: texture_distances(judge, [p] * 2, style("spirals")) for name, p in pictures.items()}
    relative = {name: relative_texture(found, distances["smoke"]) for name, found in distances.items()}
    assert set(distances["itself"].values()) == {0.0}
    assert 2 * relative["synthesised"] < relative["noise"] and relative["synthesised"] < 0.35
    assert distances["noise"] == texture_distances(judge, [pictures["noise"]] * 2, style("spirals")), "same bits"


@pytest.mark.parametrize("name", SHIPPED)
def test_of_several_styles_the_judge_finds_the_one_that_smoke_shows(judge: GoogLeNet, name: str) -> None:
    ball = round_smoke()
    inside = ball > 0.4
    shown = Picture(ball * np.roll(style(name).grey, (9, 14), (0, 1)), inside)
    smoke = Picture(ball, inside)
    relative = {
        other: relative_texture(
            texture_distances(judge, [shown] * 2, style(other)), texture_distances(judge, [smoke] * 2, style(other))
        )
        for other in SHIPPED
    }
    assert min(relative, key=lambda other: relative[other]) == name


def test_the_judge_is_another_network_than_the_one_that_is_optimised(
    weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert judge_of("bvlc").flavour == judge_of("inception5h").flavour == "patterns"
    monkeypatch.setenv("TNST_MI_WEIGHTS", str(weights))
    assert judge_of("patterns").source == str(weights)
    monkeypatch.setenv("TNST_MI_WEIGHTS", "patterns")
    with pytest.raises(InputError, match="no other network is found to judge it"):
        judge_of("patterns")


# ---------------------------------------------------------------- contrast and spectrum


def test_contrast_of_a_wave_inside() -> None:
    half = EVERYWHERE.copy()
    half[:, 32:] = False
    picture = np.where(half, wave(8, 0.3), 7.0)
    assert contrast([Picture(picture, half)]) == pytest.approx(0.3 / np.sqrt(2), rel=1e-5)


@pytest.mark.parametrize("period", [3, 4, 6, 8, 12])
@pytest.mark.parametrize("angle", [0.0, 0.5 * np.pi, 0.6])
def test_the_spectrum_of_a_wave_peaks_at_its_frequency(period: int, angle: float) -> None:
    cycles, shares = energy_shares([Picture(wave(period, angle=angle), EVERYWHERE)])
    assert shares.sum() == pytest.approx(1)
    assert cycles[shares.argmax()] == pytest.approx(1 / period, abs=0.5 / 24)
    assert mean_frequency(cycles, shares) == pytest.approx(1 / period, rel=0.1)
    # A Hann window spreads a wave over its own ring and the next.
    near = abs(cycles - 1 / period) < 2.1 / 24
    assert shares[near].sum() > 0.99


def test_spectral_distance_of_waves() -> None:
    coarse, fine = (energy_shares([Picture(wave(p), EVERYWHERE)])[1] for p in (12, 3))
    assert spectral_distance(coarse, coarse) == 0
    assert spectral_distance(coarse, fine) == pytest.approx(1, abs=0.01)
    assert spectral_distance(coarse, 0.75 * coarse + 0.25 * fine) == pytest.approx(0.25, abs=0.01)


def test_a_scrambled_change_has_contrast_and_spectrum_but_no_motifs(judge: GoogLeNet) -> None:
    change, other = style("spirals").grey - 0.5, scrambled(style("spirals").grey - 0.5, EVERYWHERE, 5)
    assert np.array_equal(other, scrambled(change, EVERYWHERE, 5))
    assert other.std() == pytest.approx(change.std(), rel=1e-4) and other.mean() == pytest.approx(change.mean())
    amplitudes = [np.abs(np.fft.fft2(values - values.mean())) for values in (change, other)]
    assert np.allclose(*amplitudes, rtol=0.02, atol=1e-3 * amplitudes[0].max())
    # Between a smooth ball and its spirals: nearer by its contrast, farther for want of them.
    before = texture_distances(judge, [Picture(round_smoke(), EVERYWHERE)] * 2, style("spirals"))
    after = texture_distances(judge, [Picture(0.5 + other, EVERYWHERE)] * 2, style("spirals"))
    assert 0.2 < relative_texture(after, before) < 0.9


def test_a_picture_without_contrast_has_no_energy() -> None:
    _, shares = energy_shares([Picture(np.zeros(SIZE, np.float32), EVERYWHERE)])
    assert not shares.any()


# ---------------------------------------------------------------- flicker


def test_light_adds_up_to_the_picture() -> None:
    density = np.random.default_rng(4).random((6, 9, 7), np.float32)
    image = np.asarray(render(density, FRONT, 0.4))
    assert np.allclose(flicker.light(density, 0.4).sum(0)[::-1], image, rtol=1e-5)


def test_what_is_seen_moves_with_the_smoke_that_is_seen() -> None:
    density, velocity = np.zeros((2, 5, 4), np.float32), np.zeros((2, 5, 4, 3), np.float32)
    density[1], density[0] = 0.8, 0.5  # 1 is in front
    velocity[1], velocity[0] = (2.0, 1.0, 9.0), (-1.0, 3.0, 9.0)
    front, behind = 0.8 * np.exp(-0.3 * 0.8), 0.5 * np.exp(-0.3 * 1.3)
    right = (2 * front - behind) / (front + behind)
    down = -(1 * front + 3 * behind) / (front + behind)
    assert np.allclose(flicker.seen_motion(density, velocity, 0.3), (right, down), rtol=1e-5)


def test_velocities_of_another_grid_are_refused() -> None:
    with pytest.raises(InputError, match=r"expected \(2, 3, 4, 3\)"):
        flicker.seen_motion(np.ones((2, 3, 4)), np.ones((2, 3, 5, 3)), 0.1)


@pytest.mark.parametrize("shift", [(3, 2), (-2, 5)])
def test_smoke_that_a_known_velocity_shifts_has_no_warp_error(shift: tuple[int, int]) -> None:
    x, y = shift
    density = blob((16, 48, 40), (20, 24, 8), 4) * (1 + 0.5 * np.sin(np.arange(40)))
    moved = np.roll(density, (y, x), (1, 2))
    velocity = np.broadcast_to(np.float32([x, y, 0]), (*density.shape, 3))
    images = [np.asarray(render(d.astype(np.float32), FRONT)) for d in (density, moved)]
    inside = images[1] > 0.05
    errors = [
        flicker.difference(flicker.carried(images[0], flicker.seen_motion(density, v, 0.1)), images[1], inside)
        for v in (velocity, 0 * velocity, -velocity)
    ]
    assert errors[0] < 1e-5 * images[1].max()
    assert errors[1] > 0.05 * images[1].max() and errors[2] > 0.05 * images[1].max()


def test_carrying_by_parts_of_a_pixel_blurs_little() -> None:
    row, column = np.indices((60, 80))

    def pattern(right: float, down: float) -> np.ndarray:
        return np.sin(2 * np.pi * (column - right) / 12) * np.cos(2 * np.pi * (row - down) / 15)

    motion = np.broadcast_to([1.4, -0.7], (60, 80, 2))
    inside = np.zeros((60, 80), bool)
    inside[5:-5, 5:-5] = True
    error = flicker.difference(flicker.carried(pattern(0, 0), motion), pattern(1.4, -0.7), inside)
    assert error < 0.02
    assert flicker.difference(pattern(0, 0), pattern(1.4, -0.7), inside) > 0.2


def test_perceptual_distance_is_of_structure(judge: GoogLeNet) -> None:
    picture = style("net").grey
    distance = {
        name: flicker.perceptual_distance(judge, picture, other, EVERYWHERE)
        for name, other in {
            "itself": picture,
            "a little brighter": 0.02 + picture,
            "moved by 3 pixels": np.roll(picture, 3, 1),
            "another": style("flames").grey,
        }.items()
    }
    assert distance["itself"] == 0
    assert list(distance.values()) == sorted(distance.values())
    # The change is outside, and out of the reach of the layers' receptive fields.
    far, top = picture.copy(), EVERYWHERE.copy()
    far[-6:], top[12:] = 0, False
    assert flicker.perceptual_distance(judge, picture, far, top) < 0.05 * flicker.perceptual_distance(
        judge, picture, far, EVERYWHERE
    )


# ---------------------------------------------------------------- all together


def test_smoke_that_is_left_alone_is_as_it_was(judge: GoogLeNet) -> None:
    frames = moving_smoke(3)
    shape = frames[0].density.shape
    look = Look(0.1, "paper", 0.2, 1.0, shape[1:])
    views = held_out_views(Recipe())
    record = measured(judge, style("net", shape[1:]), frames, [f.density for f in frames], [look] * 3, views)
    assert record["texture"] == record["mass_kept"] == record["flicker"] == record["perceptual_flicker"] == 1
    assert record["contrast"] == 0 and record["reachable"] < 1


def test_changes_that_do_not_follow_the_smoke_flicker(judge: GoogLeNet) -> None:
    frames = moving_smoke(2)
    shape = frames[0].density.shape
    look = Look(0.1, "paper", 0.2, 1.0, shape[1:])
    stripes = 1 + 0.5 * np.sin(np.indices(shape)[1] * 2 * np.pi / 6)
    alternating = [(f.density * s).astype(np.float32) for f, s in zip(frames, (stripes, 2 - stripes), strict=True)]
    views = held_out_views(Recipe())
    record = measured(judge, style("net", shape[1:]), frames, alternating, [look] * 2, views)
    assert record["flicker"] > 2 and record["perceptual_flicker"] > 2


def test_held_out_views_are_outside_of_the_ranges() -> None:
    for keys in ({}, {"azimuth": [0, 40], "elevation": [5, 5]}):
        recipe = Recipe.from_dict({"style": ["net"], **keys})
        (left, right), (low, high) = recipe.azimuth, recipe.elevation
        views = held_out_views(recipe)
        assert len(set(views)) == 4
        assert not any(left <= azimuth <= right and low <= elevation <= high for azimuth, elevation, *_ in views)


def test_equal_time() -> None:
    seconds = {"first": 0.2, "slow": 0.5, "as fast": 0.216, "fast": 0.1, "very slow": 100.0}
    assert equal_time(seconds, "first", 20) == {"first": 20, "slow": 8, "as fast": 20, "fast": 40, "very slow": 1}


def test_the_time_of_an_iteration_is_that_between_the_ends_of_two() -> None:
    # Octave 0 has compiled by 7.0 and then takes 2 s an iteration; octave 1 takes 3 s.
    ends = [(0, 7.0), (0, 8.5), (0, 11.0), (1, 40.0), (1, 43.0)]
    assert of_one_iteration(ends) == 2 + 3


def test_tables_count_where_the_judge_is_of_another_mind() -> None:
    def record(variant: str, texture: float) -> dict:
        measures = dict.fromkeys(("scrambled", "contrast", "spectral_distance", "frequency", "mass_kept"), 1.0)
        return (
            measures
            | {"texture": texture, "flicker": None, "perceptual_flicker": None, "reachable": 0.25}
            | {
                "variant": variant,
                "iterations": 20,
                "seconds": 1.0,
            }
        )

    records = {}
    for cell, other in (("a", 0.68), ("b", 0.79), ("c", 0.96)):
        records["jet", cell, "gram"] = record("gram", 0.8)
        records["jet", cell, "swd"] = record("swd", other)
    page = report({"equal time": records}, ["gram", "swd"], "Such and such.")
    assert "| swd | 0.810 | 1.000 | 1.000 | 1.000 | 1.000 | 1.000 | – | – | 1 better, 1 worse of 3 |" in page
    assert "| jet | b | 0.800 | 0.790 | 0.250 |" in page


# ---------------------------------------------------------------- a comparison


def compare(out: Path, weights: Path, *arguments: str) -> int:
    given = ["--weights", str(weights), "--keys", "octaves = 1, iterations = 1, views = 1", "--out", str(out)]
    return quality.main([*given, *arguments])


def test_a_comparison_is_made_once_and_again_with_the_same_bits(
    tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for frame in moving_smoke(2):
        np.savez(tmp_path / f"{frame.name}.npz", density=frame.density, velocity=frame.velocity)
    what = ("--inputs", str(tmp_path), "--styles", "net", "--loss", "gram", "paper")
    assert compare(tmp_path / "one", weights, *what) == 0
    assert compare(tmp_path / "one", weights, *what) == 2
    assert "go on with --resume" in capsys.readouterr().err
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "one" / "trials").iterdir()}
    assert compare(tmp_path / "one", weights, *what, "--resume") == 0
    assert before == {path: path.stat().st_mtime_ns for path in before}
    # A trial that was not finished is made anew, the same to the bit.
    (lost,) = (path for path in before if path.match("*_net_gram_1.json"))
    found = json.loads(lost.read_text("utf-8"))
    lost.unlink()
    lost.with_suffix(".npz").unlink()
    assert compare(tmp_path / "one", weights, *what, "--resume") == 0
    again = json.loads(lost.read_text("utf-8"))
    assert {**again, "seconds": 0} == {**found, "seconds": 0}
    record = json.loads((tmp_path / "one" / "quality.json").read_text("utf-8"))
    assert [len(cells) for cells in record["budgets"].values()] == [2, 2]
    assert (tmp_path / "one" / "sheet.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "nothing to compare"),
        (["--loss", "gram", "gram"], "variant 'gram' is given twice"),
        (["--loss", "grum"], "style_loss"),
        (["--variant", "a b: eta = 1.0"], "expected a name of letters"),
        (["--variant", "eta = 1.0"], "expected NAME: KEYS"),
        (["--variant", "a: eta = "], "no recipe keys in TOML"),
        (["--variant", "a: iterations = 4"], "iterations is the same for all"),
        (["--loss", "gram", "--inputs", "/nowhere"], "/nowhere"),
        (["--loss", "gram", "--styles", "nothing.png"], "nothing.png"),
    ],
)
def test_what_cannot_be_compared_is_told_in_one_line(
    tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], told: str
) -> None:
    arguments = arguments if "--inputs" in arguments else [*arguments, "--inputs", "suzanne"]
    arguments = arguments if "--styles" in arguments else [*arguments, "--styles", "net"]
    assert compare(tmp_path / "out", weights, *arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("quality: ") and error.count("\n") == 1 and told in error


def test_an_interrupted_comparison_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(quality, "compare", interrupted)
    assert quality.main(["--out", str(tmp_path)]) == 3
    assert capsys.readouterr().err == "quality: interrupted; the same command with --resume goes on\n"


def test_progress_is_told_trial_by_trial(tmp_path: Path, weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = moving_smoke(1)
    variants = [Variant("gram", {}), Variant("gentle", {"eta": 0.001})]
    keys = {"octaves": 1, "iterations": 2, "views": 1}
    comparison = Comparison(tmp_path, [Smoke("smoke", frames)], ["net"], variants, keys, str(weights))
    monkeypatch.setattr(comparison, "seconds", lambda smoke: {"gram": 1.0, "gentle": 2.0})
    said: list[str] = []
    carry_out(comparison, said.append)
    assert [line.split(":")[0] for line in said] == [
        "1/3 smoke_net_gram_2",
        "2/3 smoke_net_gentle_2",
        "3/3 smoke_net_gentle_1",
    ]
    assert comparison.done(Trial(comparison.smokes[0], "net", variants[1], 1))


def test_trimmed_grids_hold_all_smoke() -> None:
    (whole,) = quality.smoke_named(str(quality.HERE / "scenes" / "suzanne" / "frame_0010.npz"), None)[1]
    (cut,) = quality.smoke_named(str(quality.HERE / "scenes" / "suzanne" / "frame_0010.npz"), 4)[1]
    assert cut.mass == pytest.approx(whole.mass, rel=1e-6)
    assert cut.density.size < whole.density.size
    assert cut.density[4:-4, 4:-4, 4:-4].sum() == pytest.approx(whole.density.sum(), rel=1e-6)

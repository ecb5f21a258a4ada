"""`tnst-mi train`, and `stylize --model` with what it has written."""

import json

import numpy as np
import pytest
from PIL import Image

from tnst_mi.cli import main


@pytest.fixture(scope="module")
def smoke(tmp_path_factory):
    folder = tmp_path_factory.mktemp("smoke")
    z, y, x = (axis / n - 0.5 for axis, n in zip(np.indices((16, 24, 16)), (16, 24, 16), strict=True))
    for number in range(3):
        far = (z * 2.6) ** 2 + (y * 2.2 - 0.1 * number) ** 2 + (x * 3.0) ** 2
        density = np.clip(1 - far, 0, None) * (0.6 + 0.4 * np.sin(19 * x) * np.cos(17 * z + 11 * y))
        np.save(folder / f"smoke_{number:04d}.npy", density.astype(np.float32))
    return folder


GOAL = ("--style", "spirals", "--octaves", "1", "--views", "1")


@pytest.fixture(scope="module")
def model(smoke, weights, tmp_path_factory):
    out = tmp_path_factory.mktemp("model") / "spirals.safetensors"
    assert main(["train", str(smoke), *GOAL, "--weights", str(weights), "--updates", "30", "--out", str(out)]) == 0
    return out


def record(out):
    return json.loads((out / "run.json").read_text())


def density(out):
    return np.load(out / "density" / "smoke_0000.npz")["density"]


def test_a_training_says_what_it_has_come_to(model, smoke):
    card = json.loads(model.with_suffix(".json").read_text())
    assert card["inputs"] == [{"name": smoke.name, "frames": 3}] and card["held_out"] == []
    assert card["recipe"] == {"style": ["spirals"], "octaves": 1, "views": 1}
    assert [point["update"] for point in card["curve"]] == [30]
    assert card["curve"][0]["loss"] < card["loss_before"]


def test_info_tells_of_a_model_what_its_card_does(model, smoke, capsys):
    assert main(["info", str(model)]) == 0
    said = capsys.readouterr().out.splitlines()
    card = json.loads(model.with_suffix(".json").read_text())
    assert said[0] == f"{model}: a model that stylizes in one pass (--model {model})"
    assert said[1] == '  trained for: style = ["spirals"], octaves = 1'
    assert said[2] == f"  learned from: {smoke.name} (3 frames)"
    before, after = card["loss_before"], card["curve"][-1]["loss"]
    assert (
        said[3]
        == f"  loss of what it learned from (less is better): {before:.4g} without it, {after:.4g} after 30 updates"
    )


def test_info_knows_models_that_ship_by_their_names(capsys):
    assert main(["info", "flower"]) == 0
    assert '--model flower)\n  trained for: tag = ["flower"]' in capsys.readouterr().out


def test_info_refuses_weights_that_are_no_model(weights, capsys):
    assert main(["info", str(weights)]) == 2
    assert "has no model of tnst-mi" in capsys.readouterr().err


def test_the_same_command_gives_the_same_bits(model, smoke, weights, tmp_path):
    again = tmp_path / "again.safetensors"
    command = ["train", str(smoke), *GOAL, "--weights", str(weights), "--out", str(again)]
    assert main([*command, "--updates", "30"]) == 0
    assert again.read_bytes() == model.read_bytes()


def test_a_training_goes_on_with_what_it_began_with(model, smoke, weights, tmp_path, capsys):
    out = tmp_path / model.name
    for file in model.parent.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    command = ["train", str(smoke), "--weights", str(weights), "--out", str(out), "--resume", "--updates", "31"]
    before = out.read_bytes()
    assert main([*command, *GOAL, "--held-out", f"{smoke}/smoke_0000.npy"]) == 2
    assert "has another held_out" in capsys.readouterr().err
    assert main([*command, "--style", "net", *GOAL[2:]]) == 2
    assert "has another recipe, expected the same to go on" in capsys.readouterr().err
    assert out.read_bytes() == before
    assert main([*command, *GOAL]) == 0
    curve = json.loads(out.with_suffix(".json").read_text())["curve"]
    assert [point["update"] for point in curve] == [30, 31]


def test_a_frame_is_stylized_in_one_pass_or_refined(model, smoke, weights, tmp_path, capsys):
    command = ["stylize", str(smoke), "--model", str(model), "--weights", str(weights)]
    assert main([*command, "--out", str(tmp_path / "pass")]) == 0
    assert main([*command, "--refine", "4", "--out", str(tmp_path / "refined")]) == 0
    capsys.readouterr()
    one, refined = record(tmp_path / "pass"), record(tmp_path / "refined")
    assert one["model"]["refine"] == 0 and refined["model"]["refine"] == 4
    for at_once, further in zip(one["frames"], refined["frames"], strict=True):
        assert at_once["losses"] == [] or at_once["losses"] == [[]]
        assert at_once["loss_after"] < at_once["loss_before"]
        assert further["loss_after"] < at_once["loss_after"]
        assert abs(at_once["mass_after"] / at_once["mass_before"] - 1) < 0.02


def test_a_run_that_stopped_goes_on_with_the_model_that_it_began_with(model, smoke, weights, tmp_path):
    whole, out = tmp_path / "whole", tmp_path / "run"
    command = ["stylize", str(smoke), "--model", str(model), "--weights", str(weights)]
    assert main([*command, "--out", str(whole)]) == 0
    assert main([*command, "--out", str(out)]) == 0
    began = record(out)
    began["status"], began["frames"] = "interrupted", began["frames"][:1]
    (out / "run.json").write_text(json.dumps(began))
    assert main(["stylize", "--resume", "--out", str(out)]) == 0
    assert record(out)["model"] == record(whole)["model"]
    for number in range(3):
        name = f"density/smoke_{number:04d}.npz"
        assert np.array_equal(np.load(out / name)["density"], np.load(whole / name)["density"])


def test_a_model_is_moved_with_its_picture(smoke, weights, tmp_path):
    before, after = tmp_path / "before", tmp_path / "after"
    before.mkdir()
    pattern = np.indices((48, 48)).sum(axis=0) // 6 % 2 * 255
    Image.fromarray(pattern.astype(np.uint8)).save(before / "mine.png")
    command = ["train", str(smoke), "--style", str(before / "mine.png"), *GOAL[2:], "--weights", str(weights)]
    assert main([*command, "--updates", "1", "--out", str(before / "mine.safetensors")]) == 0
    assert str(tmp_path) not in (before / "mine.json").read_text()
    before.rename(after)
    command = ["stylize", f"{smoke}/smoke_0000.npy", "--model", str(after / "mine.safetensors")]
    assert main([*command, "--weights", str(weights), "--out", str(tmp_path / "out")]) == 0


def test_files_of_others_beside_a_model_stay(smoke, weights, tmp_path, capsys):
    (tmp_path / "shot.json").write_text("mine")
    command = ["train", str(smoke), *GOAL, "--weights", str(weights), "--out", str(tmp_path / "shot.safetensors")]
    assert main(command) == 2
    assert "shot.json: is there already" in capsys.readouterr().err
    assert (tmp_path / "shot.json").read_text() == "mine"


def test_a_folder_named_as_a_style_is_no_picture(model, smoke, weights, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spirals").mkdir()
    command = ["stylize", f"{smoke}/smoke_0000.npy", "--weights", str(weights)]
    assert main([*command, "--model", str(model), "--out", "one"]) == 0
    assert main([*command, *GOAL, "--iterations", "1", "--out", "two"]) == 0


def test_gamma_lambda_and_strength_act_on_what_a_network_gives(model, smoke, weights, tmp_path):
    def found(*flags):
        out = tmp_path / "_".join(("run", *flags))
        command = ["stylize", f"{smoke}/smoke_0000.npy", "--model", str(model), "--weights", str(weights)]
        assert main([*command, *flags, "--out", str(out)]) == 0
        return density(out), record(out)["frames"][0]

    plain, at_once = found()
    thick, _ = found("--gamma", "0.3")
    compressed, told = found("--lam", "0.6")
    weak, half = found("--strength", "0.5")
    unstylized = np.load(smoke / "smoke_0000.npy")
    for other in (thick, compressed, weak):
        assert np.abs(other - plain).max() > 1e-3
    # Only a velocity with a divergence changes the mass.
    assert abs(told["mass_after"] - told["mass_before"]) > abs(at_once["mass_after"] - at_once["mass_before"])
    assert half["largest_displacement"] == pytest.approx(at_once["largest_displacement"] / 2, rel=1e-3)
    assert np.square(weak - unstylized).sum() < np.square(plain - unstylized).sum()


def test_smoke_outside_of_a_mask_stays_as_it_is(model, smoke, weights, tmp_path):
    mask = np.zeros((16, 24, 16), np.float32)
    mask[:, :12] = 1
    np.save(tmp_path / "mask.npy", mask)
    recipe = tmp_path / "masked.toml"
    recipe.write_text(f'mask = "{tmp_path / "mask.npy"}"\n')
    for refine in ("0", "2"):
        out = tmp_path / refine
        command = ["stylize", f"{smoke}/smoke_0000.npy", "--model", str(model), "--weights", str(weights)]
        assert main([*command, "--recipe", str(recipe), "--refine", refine, "--out", str(out)]) == 0
        change = np.abs(density(out) - np.load(smoke / "smoke_0000.npy"))
        assert change[:, :9].max() > 1e-3
        # Smoke is drawn from within one cell of what is moved.
        assert not change[:, 14:].any()


def test_a_run_goes_on_as_it_began_and_with_no_other_model(model, smoke, weights, tmp_path, capsys):
    out = tmp_path / "run"
    command = ["stylize", str(smoke), "--model", str(model), "--weights", str(weights), "--out", str(out)]
    assert main(command) == 0
    assert main([*command, "--resume"]) == 0
    assert main([*command, "--resume", "--refine", "1"]) == 2
    assert "the run that is resumed began otherwise; use --overwrite" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--refine", "3"], "refine = 3: goes on from what a model gives; give a model too"),
        (["--model", "none.safetensors"], "none.safetensors: no such file"),
        (["--model", "MODEL", "--refine", "21"], "refine = 21: expected 0 to 20"),
        (["--model", "MODEL", "--parameterisation", "density"], "a model moves smoke; leave parameterisation out"),
        (["--model", "MODEL", "--style", "net"], "leave style out, or refine"),
        (["--model", "MODEL", "--quality", "draft", "--octaves", "2"], "a model gives the finest octave"),
        (["--model", "MODEL", "--refine", "-1"], "refine = -1: expected 0 to 20, the iterations of the finest octave"),
        (["--model", "MODEL", "--from", "RUN"], "expected only one of them to begin with"),
    ],
)
def test_what_does_not_go_together_is_refused(model, smoke, weights, tmp_path, capsys, flags, said):
    if "RUN" in flags:
        run = ["stylize", str(smoke), *GOAL, "--weights", str(weights), "--iterations", "1"]
        assert main([*run, "--out", str(tmp_path / "earlier")]) == 0
    flags = [{"MODEL": str(model), "RUN": str(tmp_path / "earlier")}.get(flag, flag) for flag in flags]
    goal = [] if "--model" in flags else GOAL
    out = tmp_path / "run"
    assert main(["stylize", str(smoke), *goal, "--weights", str(weights), *flags, "--out", str(out)]) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--out", "model.onnx"], "expected a file name that ends in .safetensors"),
        (["--out", "MODEL"], "is there already; give another name, or --resume"),
        (["--out", "new.safetensors", "--minutes", "0"], "minutes = 0"),
        (["--out", "new.safetensors", "--updates", "0"], "updates = 0"),
        (["--out", "new.safetensors", "--colour", "style"], "--colour"),
        (["--out", "new.safetensors", "--parameterisation", "density"], "a network gives potentials"),
        (["--out", "new.safetensors", "--eta", "{0: 0.1, 9: 0.2}"], "a network learns one look"),
        (["--out", "none/new.safetensors", "--resume"], "no training can go on"),
        (["--out", "new.safetensors", "--integrator", "prbvolpath"], "a network learns from smoke that emits"),
        (["--out", "new.safetensors", "--strength", "0.5"], "says what a run does"),
        (["--out", "new.safetensors", "--mask", "{height = [0, 1]}"], "says what a run does"),
    ],
)
def test_what_cannot_be_learned_is_refused(model, smoke, weights, tmp_path, capsys, monkeypatch, flags, said):
    monkeypatch.chdir(tmp_path)
    flags = [str(model) if flag == "MODEL" else flag for flag in flags]
    assert main(["train", str(smoke), *GOAL, "--weights", str(weights), *flags]) == 2
    told = capsys.readouterr().err
    assert said in told and told.count("\n") == 1
    assert not list(tmp_path.iterdir())

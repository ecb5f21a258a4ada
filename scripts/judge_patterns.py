"""How well the shipped network `patterns` steers smoke: its styles under another network's eye, and its tags.

    python scripts/judge_patterns.py styles FRAME.npz IMAGE… [--judge bvlc]
    python scripts/judge_patterns.py tags FRAME.npz [--tags spiral,net,…] [--out FOLDER]

`styles` stylizes the frame towards each picture with `patterns` alone, and prints how far the style distance falls
under the judge, a network that took no part. `tags` stylizes the frame towards each tag and prints what every tag's
logit gains by it: a table whose diagonal should dominate. Both look from the azimuths -8°, 0° and 8°, with 2 octaves of
20 iterations from 3 views; further recipe keys can be given as key=value in TOML.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from tnst_mi import Frame, GoogLeNet, Recipe, load_frames, render
from tnst_mi.losses.evaluation import as_rgb
from tnst_mi.losses.style import Style
from tnst_mi.optimisation.single_frame import optimise

VIEWS = [(azimuth, 0.0) for azimuth in (-8.0, 0.0, 8.0)]
TAGS = "spiral,net,flower,fire,stripes,dots,stars,scales,rings,hearts"
METHOD = {"lam": 1.0, "transport": "step", "motif_size": "cells", "octaves": 2, "iterations": 20, "views": 3}


def pictures(density: np.ndarray, recipe: Recipe, exposure: float) -> Tensor:
    """Exposed renderings (3, H, W) of a density (D, H, W) from the three views."""
    views = [np.asarray(render(density, view, recipe.gamma, recipe.quadrature)) for view in VIEWS]
    return torch.from_numpy(np.stack(views) * np.float32(exposure))


def stylized(frame: Frame, recipe: Recipe, network: GoogLeNet) -> tuple[Tensor, Tensor, float]:
    """The frame's pictures before and after, and the fraction of its mass that it keeps."""
    exposure = 1.0 / float(np.max(render(frame.density, recipe.main_view, recipe.gamma, recipe.quadrature)))
    result = optimise(frame, recipe, network, exposure)
    before, after = (pictures(density, recipe, exposure) for density in (frame.density, result.density))
    return before, after, float(result.density.sum() / frame.density.sum())


def judge_styles(frame: Frame, images: list[Path], judge: GoogLeNet, keys: dict) -> list[dict]:
    """For each picture the style distance under the judge, as a fraction of the start, with the mass kept."""
    patterns, rows = GoogLeNet.load("patterns"), []
    for image in images:
        recipe = Recipe.from_dict(METHOD | keys | {"style": [str(image)]}, "judge: ", Path.cwd())
        before, after, mass = stylized(frame, recipe, patterns)
        row = {"image": image.name, "mass": mass}
        for name, network, layers in (
            ("patterns", patterns, recipe.style_layers),
            ("judge", judge, Recipe().style_layers),
        ):
            distance = Style(str(image), layers).bind(network, *before.shape[1:])
            with torch.no_grad():
                row[name] = (distance(after) / distance(before)).item()
        rows.append(row)
        print(
            f"{row['image']:24} patterns {row['patterns']:.3f}   judge {row['judge']:.3f}   mass {mass:.2f}", flush=True
        )
    return rows


def judge_tags(frame: Frame, tags: list[str], keys: dict, out: Path | None) -> np.ndarray:
    """What each tag's logit (column) gains when the frame is stylized towards each tag (row), (tags, tags).

    The three views are averaged; the least gain of the own tag over any other's, in any view, is printed with each row.
    """
    network = GoogLeNet.load("patterns")
    classes = [network.class_index(tag) for tag in tags]
    gains, strip = np.zeros((len(tags), len(tags))), []
    print(" " * 14 + "".join(f"{tag[:9]:>10}" for tag in tags) + "    margin      mass")
    for row, tag in enumerate(tags):
        recipe = Recipe.from_dict(METHOD | keys | {"tag": [tag], "weights": "patterns"}, "judge: ", Path.cwd())
        before, after, mass = stylized(frame, recipe, network)
        with torch.no_grad():
            logits = [network(as_rgb(views), ["logits"])["logits"][:, classes] for views in (before, after)]
        gain = (logits[1] - logits[0]).numpy()
        gains[row] = gain.mean(0)
        margin = (gain[:, row] - np.delete(gain, row, axis=1).max(1)).min()
        print(f"{tag:14}" + "".join(f"{g:10.2f}" for g in gains[row]) + f"{margin:10.2f}{mass:10.2f}", flush=True)
        strip.append(after[1].clamp(0.0, 1.0))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        joined = torch.cat([before[1].clamp(0.0, 1.0), *strip], dim=1)
        Image.fromarray(np.uint8(np.round(255.0 * joined.numpy()))).save(out / f"{frame.name}_tags.png")
        (out / f"{frame.name}_tags.json").write_text(json.dumps({"tags": tags, "gains": gains.tolist()}, indent=1))
    return gains


def main() -> None:
    """Judge what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    styles, tags = commands.add_parser("styles"), commands.add_parser("tags")
    for command in (styles, tags):
        command.add_argument("frame", type=Path)
        command.add_argument("--keys", default="", help="recipe keys in TOML, such as 'lam = 0.0'")
    styles.add_argument("images", type=Path, nargs="+")
    styles.add_argument("--judge", default="bvlc", help="a flavour that is found, or downloaded (default bvlc)")
    tags.add_argument("--tags", default=TAGS, help=f"(default {TAGS})")
    tags.add_argument("--out", type=Path, help="a folder for the table as JSON and a strip of pictures")
    arguments = parser.parse_args()
    frame, keys = load_frames(arguments.frame)[0], tomllib.loads(arguments.keys)
    if arguments.command == "styles":
        judge_styles(frame, arguments.images, GoogLeNet.load(flavour=arguments.judge), keys)
    else:
        judge_tags(frame, arguments.tags.split(","), keys, arguments.out)


if __name__ == "__main__":
    main()

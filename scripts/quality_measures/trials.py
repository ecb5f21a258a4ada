"""The stylizations that are compared, how many iterations each has for the same time, and their results on the disk."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from quality_measures.compared import Smoke, Trial, Variant
from quality_measures.judge import judge_of
from quality_measures.measured import measured
from quality_measures.seen import Look, held_out_views, size_of_images, style_picture
from quality_measures.speed import ITERATIONS, equal_time, seconds_per_iteration
from quality_measures.table import MEASURES
from tnst_mi import GoogLeNet, Recipe, stylize
from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.machine.backend import torch_device
from tnst_mi.network.weights import find_weights

#: Of what is compared, unless keys say otherwise.
METHOD: dict[str, Any] = {"octaves": 2, "iterations": 20, "views": 3}


class Comparison:
    """Every variant on every smoke with every style, at equal iterations and at equal time.

    What is done is in `out/trials`: NAME.npz has the densities, NAME.json all else; one that is there is not made anew
    if it is of the same recipe, smoke and networks. A trial whose JSON alone is removed is measured again.

    Args:
        out: a folder.
        smokes: what is stylized.
        styles: pictures, as in a recipe.
        variants: the first is the one that others are compared with.
        keys: recipe keys that all variants share.
        weights: the network that is optimised, as in a recipe; None searches for one.

    Raises:
        InputError: a recipe is none, a picture or a network is not found, or names occur twice.
    """

    def __init__(
        self,
        out: Path,
        smokes: Sequence[Smoke],
        styles: Sequence[str],
        variants: Sequence[Variant],
        keys: Mapping[str, Any],
        weights: str | None,
    ) -> None:
        _require_distinct("variant", [variant.name for variant in variants])
        _require_distinct("input", [smoke.name for smoke in smokes])
        _require_distinct("style", [Path(style).stem for style in styles])
        self.smokes, self.styles, self.variants = smokes, styles, variants
        _require_free("--keys", keys, ("style", "weights"))
        for variant in variants:
            _require_free(variant.name, variant.keys, ("style", "weights", "iterations"))
        self._folder, self._keys = out / "trials", METHOD | dict(keys) | {"weights": weights}
        self.iterations = Recipe.from_dict(self._keys | {"style": [styles[0]]}, "--keys: ", Path.cwd()).iterations
        for style in styles:
            for variant in variants:
                self.recipe(Trial(smokes[0], style, variant, self.iterations))
        self.driver = find_weights(weights)

    @cached_property
    def judge(self) -> GoogLeNet:
        """The network that judges."""
        return judge_of(self.driver.flavour)

    def recipe(self, trial: Trial) -> Recipe:
        """The recipe of a trial, with absolute paths."""
        keys = self._keys | dict(trial.variant.keys) | {"style": [trial.style], "iterations": trial.iterations}
        return Recipe.from_dict(keys, f"{trial.variant.name}: ", Path.cwd()).located(Path.cwd())

    # --- time ---

    def seconds(self, smoke: Smoke) -> dict[str, float]:
        """Seconds that an iteration of each variant takes, of all octaves together; timed once, then remembered."""
        path = self._folder / f"{smoke.name}.seconds.json"
        identity = [self._identity(Trial(smoke, self.styles[0], v, self.iterations)) for v in self.variants]
        if (stored := _read(path)) is not None and stored["of"] == identity:
            return stored["seconds"]
        recipes = {v.name: self.recipe(Trial(smoke, self.styles[0], v, ITERATIONS)) for v in self.variants}
        network = GoogLeNet.from_file(self.driver.path).to(torch_device())
        seconds = seconds_per_iteration(smoke.frames[0], recipes, network)
        _write(path, {"of": identity, "seconds": seconds})
        return seconds

    def by_budget(self) -> dict[str, list[Trial]]:
        """A trial for each smoke, style and variant, by what is equal."""
        found: dict[str, list[Trial]] = {"equal iterations": [], "equal time": []}
        for smoke in self.smokes:
            same_time = equal_time(self.seconds(smoke), self.variants[0].name, self.iterations)
            for style in self.styles:
                for variant in self.variants:
                    found["equal iterations"].append(Trial(smoke, style, variant, self.iterations))
                    found["equal time"].append(Trial(smoke, style, variant, same_time[variant.name]))
        return found

    def trials(self) -> list[Trial]:
        """All trials, each once: those of equal iterations first."""
        return list({trial.name: trial for trials in self.by_budget().values() for trial in trials}.values())

    # --- work ---

    def done(self, trial: Trial) -> bool:
        """Whether a trial has been made and measured."""
        return self._found(trial) is not None

    def _found(self, trial: Trial) -> dict[str, Any] | None:
        stored = _read(self._folder / f"{trial.name}.json") or {"of": None}
        # One that lacks a measure is of an earlier version of this script.
        whole = stored["of"] == self._identity(trial) and stored.keys() >= MEASURES.keys()
        return stored if whole else None

    def record(self, trial: Trial) -> dict[str, Any]:
        """The measures of a trial; it is made if it is not there.

        Raises:
            KeyboardInterrupt: Ctrl-C ended it.
        """
        if (found := self._found(trial)) is not None:
            return found
        run, densities = self._stylized(trial)
        recipe, (rows, columns) = self.recipe(trial), densities[0].shape[1:]
        size = size_of_images(recipe, densities[0].shape)
        looks = [
            Look(frame["gamma"], recipe.quadrature, frame["exposure"], run["density_scale"], size)
            for frame in run["frames"]
        ]
        views = held_out_views(recipe)
        style = style_picture(recipe.style[0], size)
        record = {
            "input": trial.smoke.name,
            "style": Path(trial.style).stem,
            "variant": trial.variant.name,
            "iterations": trial.iterations,
            "grid": [len(densities[0]), rows, columns],
            "views": views,
            "seconds": run["seconds"],
            "style_loss": [run["loss_before"], run["loss_after"]],
            **measured(self.judge, style, trial.smoke.frames, densities, looks, views),
            "of": self._identity(trial),
        }
        _write(self._folder / f"{trial.name}.json", record)
        return record

    def pictures(self, trial: Trial) -> tuple[np.ndarray, np.ndarray]:
        """The first frame of a trial before and after, the front views (rows, columns) in [0, 1]."""
        run, densities = self._stylized(trial)
        recipe, frame = self.recipe(trial), run["frames"][0]
        shape = densities[0].shape
        look = Look(frame["gamma"], recipe.quadrature, frame["exposure"], run["density_scale"], (shape[1], shape[2]))
        before, after = (look.images(d, [recipe.main_view])[0] for d in (trial.smoke.frames[0].density, densities[0]))
        return before, after

    def _stylized(self, trial: Trial) -> tuple[dict[str, Any], list[np.ndarray]]:
        """What a run says and its densities, from the disk if they are there."""
        path, identity = self._folder / f"{trial.name}.npz", self._identity(trial)
        if path.is_file():
            with np.load(path) as stored:
                run = json.loads(str(stored["run"]))
                if run["of"] == identity:
                    return run, list(stored["densities"])
        result = stylize(list(trial.smoke.frames), self.recipe(trial), progress=False)
        _require_whole(result.run)
        frames = result.run["frames"]
        run = {
            "of": identity,
            "density_scale": result.run["density_scale"],
            "seconds": sum(entry["seconds"] for history in result.history for entry in history),
            "loss_before": frames[0]["loss_before"],
            "loss_after": frames[0]["loss_after"],
            "frames": [{key: frame[key] for key in ("gamma", "exposure")} for frame in frames],
        }
        self._folder.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, densities=np.stack(list(result.densities)), run=json.dumps(run))
        return run, list(result.densities)

    def _identity(self, trial: Trial) -> str:
        """A digest of all that decides the result of a trial."""
        recipe = self.recipe(trial)
        picture = hashlib.sha256(Path(recipe.style[0]).read_bytes()).hexdigest()
        parts = [recipe.to_toml(), trial.smoke.digest, picture, str(self.driver.path), self.judge.sha256]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def carry_out(comparison: Comparison, say: Callable[[str], None]) -> None:
    """Make all trials, and say after each how far that is and how long the rest may take."""
    trials = comparison.trials()
    left = [trial for trial in trials if not comparison.done(trial)]
    if len(left) < len(trials):
        say(f"{len(trials) - len(left)} of {len(trials)} trials are there already")
    work, since, spent = sum(trial.iterations for trial in left), time.perf_counter(), 0
    for number, trial in enumerate(left, 1):
        record = comparison.record(trial)
        spent += trial.iterations
        rest = (time.perf_counter() - since) * (work - spent) / spent
        say(f"{number}/{len(left)} {trial.name}: texture {record['texture']:.2f}, about {rest / 60:.0f} min left")


def _require_distinct(what: str, names: Sequence[str]) -> None:
    """Raise `InputError` if two things have one name, since files are named after them."""
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"{what} {twice[0]!r} is given twice; give each another name")


def _require_free(where: str, keys: Mapping[str, Any], taken: Sequence[str]) -> None:
    """Raise `InputError` if keys are given that the comparison itself decides."""
    if given := [key for key in keys if key in taken]:
        raise InputError(f"{where}: {given[0]} is the same for all variants, or set by a flag; leave it out")


def _require_whole(run: Mapping[str, Any]) -> None:
    """Raise KeyboardInterrupt if Ctrl-C ended a run, which then returns what it has."""
    if run["status"] != "done":
        raise KeyboardInterrupt


def _read(path: Path) -> dict[str, Any] | None:
    return json.loads(path.read_text("utf-8")) if path.is_file() else None


def _write(path: Path, content: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", "utf-8")

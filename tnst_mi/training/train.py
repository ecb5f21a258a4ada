"""`tnst_mi.train`: simulations and a recipe in, a network that stylizes in one pass out."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io.atomic import written_whole
from tnst_mi.machine.backend import activate, network_threads, own_variant, torch_device
from tnst_mi.machine.disk import require_writable
from tnst_mi.machine.interrupt import Interrupt, deferred_interrupt
from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.realtime.model import write_model
from tnst_mi.realtime.potential_network import Architecture, PotentialNetwork
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.resources import expanded
from tnst_mi.run.inputs import sequence_of
from tnst_mi.run.prepare import load_network
from tnst_mi.run.readable import Readable
from tnst_mi.training.card import card_of, earlier_curve
from tnst_mi.training.footage import Footage
from tnst_mi.training.trainer import Judgement, Trainer

#: Channels of the network at half the resolution of an octave: its file then has 1.1 MB.
WIDTH = 32

#: Octaves of the network at most. A third one learns more slowly.
OCTAVES = 2

#: Keys of a recipe of which a training makes nothing.
_OF_RUNS = (
    *("mask", "strength", "blend", "reach", "keep_silhouette", "window", "coherence", "quality"),
    *("context", "format", "carry", "keep_octaves"),
)

#: Seconds after which the network is judged and written.
_JUDGED_AFTER = 60.0


@dataclass(frozen=True)
class Training:
    """What a training has come to.

    Attributes:
        model: the file of the network.
        updates: done, and the `seconds` that they took, with those of earlier trainings that it went on from.
        before, after: mean loss of the frames that it is judged by, in the fixed views, without and with it.
        held_out: whether these are not those that it learned from.
        interrupted: it was ended early; it can go on.

    Example:
        >>> import pathlib, tnst_mi
        >>> training = tnst_mi.Training(pathlib.Path("flames.safetensors"), 900, 240.0, 300.0, 240.0, True, False)
        >>> f"{1 - training.after / training.before:.0%} of the loss is gone"
        '20% of the loss is gone'
    """

    model: Path
    updates: int
    seconds: float
    before: float
    after: float
    held_out: bool
    interrupted: bool


def train(
    inputs: Sequence[str | Path | Sequence[Frame]],
    recipe: Recipe | str | Path | Mapping[str, Any],
    out: str | Path,
    *,
    held_out: Sequence[str | Path | Sequence[Frame]] = (),
    minutes: float = 90.0,
    updates: int | None = None,
    resume: bool = False,
    progress: bool = True,
) -> Training:
    """Train a network that stylizes smoke in one pass, without examples of stylized smoke.

    The network is judged and written every minute, so it can be used, and the training resumed, whatever ends it.
    Beside `out` are `OUT.json`, which says how it was trained and how well, and `OUT.state`, from which it is resumed.
    With `updates`, the same call gives the same bits on the same machine.

    Args:
        inputs: simulations to learn from: files, folders of numbered ones, patterns, or frames.
        recipe: towards what, and how it is seen; its finest octave is what the network works on.
        out: file of the model, with the extension .safetensors.
        held_out: simulations to judge it by; without any, it is judged by those that it learns from.
        minutes: how long, above 0, with what an earlier training took that is resumed.
        updates: how many updates of the weights in place of that, 1 or more.
        resume: go on where an earlier training stopped.
        progress: show a progress bar on stderr.

    Raises:
        InputError: something cannot be used, or there is a file already.
        OSError: something cannot be written.

    Example:
        >>> import numpy as np, tempfile, pathlib, tnst_mi
        >>> density = np.zeros((16, 16, 16), np.float32)
        >>> density[4:12, 4:12, 4:12] = 1.0
        >>> recipe = {"style": ["spirals"], "octaves": 1, "views": 1, "weights": "patterns"}
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     out = pathlib.Path(folder) / "spirals.safetensors"
        ...     training = tnst_mi.train([[tnst_mi.Frame(density)]], recipe, out, updates=2, progress=False)
        ...     training.updates, out.is_file()
        (2, True)
    """
    if isinstance(inputs, str | Path | Frame) or not inputs:
        raise InputError("inputs: expected a list of simulations, each a path or frames; there is not one of them")
    if isinstance(recipe, str | Path):
        recipe = Recipe.from_toml(recipe)
    elif isinstance(recipe, Mapping):
        recipe = Recipe.from_dict(recipe)
    out = expanded(Path(out))
    _require_trainable(recipe)
    _require_place(out, resume)
    if not (minutes > 0 and (updates is None or updates >= 1)):
        raise InputError(f"minutes = {minutes:g}, updates = {updates}: expected minutes above 0, or 1 update or more")
    recipe = recipe.located(Path.cwd())
    with own_variant():
        activate(recipe.variant)
        network_threads(recipe.threads)
        return _trained(_Wanted(inputs, held_out, recipe, out, minutes, updates), resume, progress)


@dataclass(frozen=True)
class _Wanted:
    """What `train` was asked for."""

    inputs: Sequence[str | Path | Sequence[Frame]]
    held_out: Sequence[str | Path | Sequence[Frame]]
    recipe: Recipe
    out: Path
    minutes: float
    updates: int | None

    @property
    def state(self) -> Path:
        """From which the training is resumed."""
        return self.out.with_suffix(".state")

    @property
    def card(self) -> Path:
        """How it was trained, and how well."""
        return self.out.with_suffix(".json")

    def done(self, updates: int, seconds: float) -> float:
        """The share of the training that is done, from 0 to 1."""
        return min(1.0, seconds / (60 * self.minutes) if self.updates is None else updates / self.updates)


def _trained(wanted: _Wanted, resume: bool, progress: bool) -> Training:
    recipe, judge = wanted.recipe, load_network(wanted.recipe).model.to(torch_device())
    footage = _footage(wanted.inputs, recipe, judge, progress)
    # `frames` selects what is learned from.
    held_out = _footage(wanted.held_out, dataclasses.replace(recipe, frames=None), judge, progress)
    torch.manual_seed(recipe.seed)
    network = PotentialNetwork(Architecture(min(recipe.octaves, OCTAVES), WIDTH)).to(torch_device())
    trainer = Trainer(network, footage, held_out or footage, recipe.seed)
    before = trainer.read(wanted.state) if resume else 0.0
    kept = _Kept(wanted, network, trainer, card_of(recipe, footage, held_out, judge, WIDTH, wanted.out.parent))
    if resume:
        kept.curve.extend(earlier_curve(wanted.card, kept.card))
    with deferred_interrupt() as interrupt:
        seconds = _go_on(wanted, trainer, kept, before, interrupt, progress)
    judgement = kept.write(seconds)
    stopped = interrupt.requested and wanted.done(trainer.updates, seconds) < 1
    return Training(wanted.out, trainer.updates, seconds, judgement.before, judgement.after, bool(held_out), stopped)


def _go_on(
    wanted: _Wanted, trainer: Trainer, kept: _Kept, before: float, interrupt: Interrupt, progress: bool
) -> float:
    """Train until all is done, or Ctrl-C was pressed; gives the seconds that were taken, with those `before`."""
    begun = last = time.perf_counter()
    seconds, loss, judgement = before, 0.0, trainer.judged()
    by_time = wanted.updates is None
    bar = progress_bar(
        total=60 * wanted.minutes if by_time else wanted.updates,
        initial=before if by_time else trainer.updates,
        desc="training",
        bar_format="{desc}: {percentage:3.0f}%|{bar}| [{elapsed}<{remaining}{postfix}]",
        disable=not progress,
    )
    with bar:
        while (done := wanted.done(trainer.updates, seconds)) < 1 and not interrupt.requested:
            found = trainer.update(done)
            loss = loss if found is None else found
            now = time.perf_counter()
            seconds = before + now - begun
            if now - last >= _JUDGED_AFTER:
                judgement, last = kept.write(seconds), time.perf_counter()
            bar.set_postfix_str(
                f"update {trainer.updates}, loss {loss:.4g}, {'held out' if wanted.held_out else 'in fixed views'} "
                f"{judgement.before:.4g} → {judgement.after:.4g}",
                refresh=False,
            )
            bar.update(min(bar.total, seconds if by_time else trainer.updates) - bar.n)
    return seconds


@dataclass(frozen=True)
class _Kept:
    """What is written of a training: the network, how it came about, and how well it does at which time."""

    wanted: _Wanted
    network: PotentialNetwork
    trainer: Trainer
    card: Mapping[str, Any]
    curve: list[dict[str, float]] = field(default_factory=list)

    def write(self, seconds: float) -> Judgement:
        """Judge the network, and write it as it is."""
        trainer, card, judgement = self.trainer, self.card, self.trainer.judged()
        self.curve.append({"update": trainer.updates, "seconds": round(seconds, 1), "loss": judgement.after})
        trainer.write(self.wanted.state, seconds)
        # Without how long it took, the same training gives the same file.
        said = {"inputs": card["inputs"], "held_out": card["held_out"], "updates": trainer.updates}
        said |= {"loss": judgement.after, "loss_before": judgement.before}
        # How many views an update takes is nothing that a run of the network should begin with.
        recipe = {name: value for name, value in card["recipe"].items() if name != "views"}
        write_model(self.wanted.out, self.network, recipe, said)
        with written_whole(self.wanted.card) as temporary:
            text = json.dumps({**card, "loss_before": judgement.before, "curve": self.curve}, indent=1)
            temporary.write_text(text + "\n", "utf-8")
        return judgement


def _footage(
    inputs: Sequence[str | Path | Sequence[Frame]], recipe: Recipe, network: GoogLeNet, progress: bool
) -> list[Footage]:
    found = []
    for one in progress_bar(inputs, "reading", leave=False, disable=not progress or len(inputs) < 2):
        name = str(one) if isinstance(one, str | Path) else "frames"
        found.append(Footage(name, list(Readable(sequence_of(one, recipe), recipe.skip_bad)), recipe, network))
    return found


def _require_trainable(recipe: Recipe) -> None:
    """Check the keys that a network cannot learn.

    Raises:
        InputError: the recipe has one.
    """
    if recipe.keyframes:
        raise InputError(f"keyframes: of {', '.join(recipe.keyframes)}; a network learns one look, so give one value")
    if recipe.target:
        raise InputError("target: a network learns one look; train one for each, and give --mask when they are used")
    if recipe.parameterisation != "transport":
        raise InputError(f'parameterisation = "{recipe.parameterisation}": a network gives potentials; use "transport"')
    if recipe.colour == "style":
        raise InputError('colour = "style": a network moves smoke and does not colour it; use "keep" or "off"')
    if recipe.camera is not None:
        raise InputError("camera: a network learns views from all around; leave it out")
    if recipe.integrator != "emission_absorption":
        raise InputError(
            f'integrator = "{recipe.integrator}": a network learns from smoke that emits and absorbs light'
        )
    usual = Recipe()
    for name in _OF_RUNS:
        if (value := getattr(recipe, name)) != getattr(usual, name):
            raise InputError(f"{name} = {value!r}: says what a run does with what a network gives; leave it out here")


def _require_place(out: Path, resume: bool) -> None:
    if out.suffix != ".safetensors":
        raise InputError(f"{out}: expected a file name that ends in .safetensors")
    require_writable(out.parent, remedy=None)
    for file in (out, out.with_suffix(".json"), out.with_suffix(".state")):
        if file.exists() and not resume:
            raise InputError(f"{file}: is there already; give another name, or --resume to train it further")

"""What the commands accept that stylize: the keys of a recipe as flags, and what to do with the run."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from tnst_mi.commands.base import Arguments, Folder, recipe_flags
from tnst_mi.recipe.sections import Colouring, Goals, Method, Reading, Resources

# Dataclasses created at run time: a type checker cannot know them, so their fields are `Any`.
_GoalFlags = recipe_flags(key for key in Goals.__annotations__ if key != "target")
_MethodFlags = recipe_flags(Method.__annotations__)
_ColourFlags = recipe_flags(Colouring.__annotations__)
_ResourceFlags = recipe_flags(Resources.__annotations__)
_InputFlags = recipe_flags(Reading.__annotations__)

ClusterAddress = Annotated[str | None, tyro.conf.arg(metavar="local:N|tcp://…|slurm[:FILE]")]


@dataclass(kw_only=True)
class DemoArguments(Arguments):
    """Stylize the bundled frame with the bundled recipe; needs nothing else."""

    out: Folder = Path("tnst_mi-demo")
    """Folder for the results; those of an earlier demo in it are replaced."""
    fast: bool = False
    """In one pass by the network of `--model flames`, in seconds, rather than by an optimisation."""


@dataclass(kw_only=True)
class StylizeArguments(Arguments):
    """Stylize a density file, or a folder of numbered ones, towards pictures, features or classes.

    Values come from the defaults or a preset, then from the recipe file, then from the flags.
    """

    input: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="[INPUT]", help_behavior_hint="")] = None
    """Density file, folder of numbered ones, or pattern ('smoke_####.vdb'); with --resume, the run's by default."""
    out: Folder
    """New or empty folder for the results."""
    recipe: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Recipe file (TOML); its keys are the flags below."""
    start_from: Annotated[Path | None, tyro.conf.arg(name="from", metavar="RUN")] = None
    """Go on from what an earlier run of the same input and goals has found, a draft or a preview, of which nothing is
    computed again: with its input and its recipe, and the next --quality, unless these are given (docs/preview.md)."""
    model: Annotated[Path | None, tyro.conf.arg(metavar="NAME|FILE")] = None
    """Take the potentials of a network in one pass, in place of an optimisation: flames or flower, which ship with the
    package, or FILE of `tnst-mi train`; with its recipe, but for what --recipe and flags say (docs/realtime.md)."""
    refine: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """With --model: iterations in the finest octave that go on from these potentials."""
    resume: bool = False
    """Continue the run in --out where it stopped, whatever stopped it, with its own recipe unless --recipe is given."""
    overwrite: bool = False
    """Replace the run in --out."""
    cluster: ClusterAddress = None
    """Have several processes do the work, to the same bits: N on this machine, a Dask cluster by its scheduler's
    address, or jobs of a batch system (docs/cluster.md)."""
    unshared: bool = False
    """With --cluster: its processes do not see --out and INPUT, so what they need is sent to them, and comes back."""
    goals: Annotated[Any, tyro.conf.arg(constructor=_GoalFlags)] = field(default_factory=_GoalFlags)
    """What to stylize towards."""
    method: Annotated[Any, tyro.conf.arg(constructor=_MethodFlags)] = field(default_factory=_MethodFlags)
    """How to get there."""
    colouring: Annotated[Any, tyro.conf.arg(constructor=_ColourFlags)] = field(default_factory=_ColourFlags)
    """The colour of the smoke."""
    resources: Annotated[Any, tyro.conf.arg(constructor=_ResourceFlags)] = field(default_factory=_ResourceFlags)
    """What to read, compute with and write."""
    reading: Annotated[Any, tyro.conf.arg(constructor=_InputFlags)] = field(default_factory=_InputFlags)
    """How to read the input."""


@dataclass(kw_only=True)
class TrainArguments(Arguments):
    """Train a network that stylizes smoke of a kind in one pass, for `stylize --model`.

    It learns from simulations and from the losses that an optimisation has; no stylized smoke is needed. It is written
    every minute and can be used meanwhile (docs/realtime.md).
    """

    inputs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="INPUT…", help_behavior_hint="")]
    """Simulations to learn from: density files, folders of numbered ones, or patterns."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """The model, FILE.safetensors; beside it are FILE.json, how it was trained, and FILE.state, to resume it."""
    recipe: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Recipe file (TOML); its keys are the flags below."""
    held_out: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="INPUT")] = ()
    """A simulation to judge it by, which it does not learn from; may be repeated."""
    minutes: Annotated[float, tyro.conf.arg(metavar="N")] = 90.0
    """How long it is trained, with what an earlier training took that is resumed."""
    updates: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None
    """How many updates of the weights in place of that; the same command then gives the same bits on a machine."""
    resume: bool = False
    """Continue the training of --out where it stopped."""
    goals: Annotated[Any, tyro.conf.arg(constructor=_GoalFlags)] = field(default_factory=_GoalFlags)
    """What to stylize towards."""
    method: Annotated[Any, tyro.conf.arg(constructor=_MethodFlags)] = field(default_factory=_MethodFlags)
    """How smoke is seen and moved."""
    resources: Annotated[Any, tyro.conf.arg(constructor=_ResourceFlags)] = field(default_factory=_ResourceFlags)
    """What to read, compute with and write."""
    reading: Annotated[Any, tyro.conf.arg(constructor=_InputFlags)] = field(default_factory=_InputFlags)
    """How to read the inputs."""


@dataclass(kw_only=True)
class BatchArguments(Arguments):
    """Stylize every input by every recipe, one run after the other, and show the results on a page.

    Each run is in OUT/RECIPE/INPUT, as `stylize` leaves it. The same command goes on where it was stopped: runs that
    are done are not done again. A run that cannot be done is told, and the others go on.
    """

    files: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RECIPE… INPUT…", help_behavior_hint="")
    ]
    """Recipe files (.toml), one or more, and density files, folders of numbered ones, or patterns, one or more."""
    out: Folder
    """New or empty folder, or that of the batch to go on with; OUT/index.html shows the results."""
    overwrite: bool = False
    """Replace the runs in --out."""
    cluster: ClusterAddress = None
    """Have several processes do the work of each run: N on this machine, a Dask cluster by its scheduler's address, or
    jobs of a batch system (docs/cluster.md)."""
    method: Annotated[Any, tyro.conf.arg(constructor=_MethodFlags)] = field(default_factory=_MethodFlags)
    """How to get there, for all recipes, such as --quality draft."""
    colouring: Annotated[Any, tyro.conf.arg(constructor=_ColourFlags)] = field(default_factory=_ColourFlags)
    """The colour of the smoke."""
    resources: Annotated[Any, tyro.conf.arg(constructor=_ResourceFlags)] = field(default_factory=_ResourceFlags)
    """What to read, compute with and write."""
    reading: Annotated[Any, tyro.conf.arg(constructor=_InputFlags)] = field(default_factory=_InputFlags)
    """How to read the inputs."""

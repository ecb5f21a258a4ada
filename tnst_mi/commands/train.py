"""`tnst-mi train`: simulations in, a network that stylizes in one pass out."""

from __future__ import annotations

from tnst_mi.commands.base import given
from tnst_mi.commands.run_arguments import TrainArguments
from tnst_mi.errors import InputError, StoppedError
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.recipe.recipe import Recipe

#: It imports torch, and most mistakes are found without it.
training = LazyModule("tnst_mi.training.train")


def run(arguments: TrainArguments) -> int:
    """Train, and say how much of the loss is left."""
    recipe = Recipe() if arguments.recipe is None else Recipe.from_toml(arguments.recipe)
    for flags in (arguments.goals, arguments.method, arguments.resources, arguments.reading):
        recipe = recipe.updated_by_flags(given(flags))
    if not arguments.inputs:
        raise InputError("train: expected INPUT: density files, folders of numbered ones, or patterns")
    found = training.train(
        arguments.inputs,
        recipe,
        arguments.out,
        held_out=arguments.held_out,
        minutes=arguments.minutes,
        updates=arguments.updates,
        resume=arguments.resume,
    )
    where = "of smoke that was held out" if found.held_out else "of the smoke that it learned from"
    print(f"updates   {found.updates} in {found.seconds / 60:.1f} min")
    print(f"loss      {found.before:.4g} → {found.after:.4g} {where}, in the fixed views")
    print(f"model     {found.model}")
    if found.interrupted:
        raise StoppedError(f"interrupted after {found.updates} updates; {found.model} can be used, --resume continues")
    return 0

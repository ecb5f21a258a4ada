"""The class names of the network's `logits`."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import quoted, some_of
from tnst_mi.network.readers.network_weights import CLASSIFIER, NetworkWeights
from tnst_mi.resources import DATA


def class_names(weights: NetworkWeights) -> list[str]:
    """The file's own list, or the standard one of the 1000 ILSVRC classes; empty if neither applies."""
    if weights.class_names is not None:
        return list(weights.class_names)
    if weights.flavour == "inception5h":
        return []  # it has its own order of classes
    names = imagenet_names()
    return names if len(names) == weights.tensors[f"{CLASSIFIER}.bias"].numel() else []


def imagenet_names() -> list[str]:
    """The 1000 ILSVRC classes in their standard order."""
    return (DATA / "imagenet_classes.txt").read_text("utf-8").splitlines()


def matching_classes(names: Sequence[str], tag: str) -> set[int]:
    """The indices of the classes with this name or synonym; case is ignored unless there is an exact match."""
    wanted = tag.strip()
    # Two classes may differ only in case: Cardigan is a dog, cardigan a jacket.
    exact = {index for synonym, index in _synonyms(names) if synonym == wanted}
    return exact or {index for synonym, index in _synonyms(names) if synonym.lower() == wanted.lower()}


def class_index(names: Sequence[str], tag: str) -> int:
    """The index of a class by its name, or by one of its comma-separated synonyms; case is ignored.

    Raises `InputError` for a name that is unknown (naming the nearest three) or that several classes share.
    """
    matches = matching_classes(names, tag)
    if len(matches) == 1:
        return matches.pop()
    if matches:
        listed = some_of([f"{quoted(names[index])} (logits:{index})" for index in sorted(matches)])
        raise InputError(f"class tag {quoted(tag)}: names several classes: {listed}")
    lower = {synonym.lower(): synonym for synonym, _ in _synonyms(names)}
    nearest = difflib.get_close_matches(tag.strip().lower(), lower, n=3, cutoff=0.0)
    raise InputError(
        f"class tag {quoted(tag)}: unknown; the nearest are {', '.join(quoted(lower[name]) for name in nearest)}"
    )


def _synonyms(names: Sequence[str]) -> Iterator[tuple[str, int]]:
    """Every name of every class, the whole entry included, with the index of the class."""
    return ((synonym.strip(), index) for index, name in enumerate(names) for synonym in {name, *name.split(",")})

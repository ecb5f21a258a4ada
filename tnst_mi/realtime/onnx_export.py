"""A trained network as ONNX, for programs that run it without tnst_mi; docs/realtime.md says how to use it there."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import logging
import warnings
from collections.abc import Iterator
from pathlib import Path

import torch

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.realtime.model import Model
from tnst_mi.realtime.potential_network import FIELDS, PotentialNetwork

#: Of the operators; every runtime of the last years has them.
OPSET = 18

#: Multiples of the least size in the grid that is traced; the file takes any.
_TRACED = (2, 3, 2)

#: The axes of a grid.
_AXES = tuple(enumerate(("depth", "height", "width")))

#: What torch's exporter is made of.
_PACKAGES = ("onnx", "onnxscript")


def write_onnx(model: Model, path: Path) -> None:
    """Write the network: `smoke` (1, 1, D, H, W) and `lam` (1,) → `potentials` (1, C, D, H, W), sizes of any multiple.

    The metadata of the file have the multiple of which sizes must be, the names of the fields, and the recipe.

    Raises:
        InputError: the `onnx` extra is not installed.
        OSError: the file cannot be written.
    """
    if missing := [name for name in _PACKAGES if importlib.util.find_spec(name) is None]:
        raise InputError(f"{path}: writing ONNX needs {' and '.join(missing)}; pip install 'tnst_mi[onnx]'")
    architecture = model.network.architecture
    network = PotentialNetwork(architecture)
    network.load_state_dict({name: weight.cpu() for name, weight in model.network.state_dict().items()})
    smoke = torch.zeros((1, 1, *(architecture.multiple * times for times in _TRACED)))
    sizes = {2 + axis: architecture.multiple * torch.export.Dim(f"{name}_groups", min=1) for axis, name in _AXES}
    # The exporter tells of each of its steps on stdout, and of packages that are not needed.
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()), _errors_alone("torch.onnx"):
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network.eval(),
            (smoke, torch.zeros(1)),
            dynamo=True,
            opset_version=OPSET,
            input_names=["smoke", "lam"],
            output_names=["potentials"],
            dynamic_shapes=(sizes, None),
            verbose=False,
        )
    assert program is not None
    program.model.metadata_props.update(
        {
            "multiple": str(architecture.multiple),
            "fields": json.dumps(FIELDS),
            "recipe": json.dumps(dict(model.recipe)),
            "sha256": model.sha256,
        }
    )
    with written_whole(path) as temporary:
        program.save(temporary, external_data=False)


@contextlib.contextmanager
def _errors_alone(name: str) -> Iterator[None]:
    """Meanwhile nothing but errors is logged by a package."""
    logger = logging.getLogger(name)
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)

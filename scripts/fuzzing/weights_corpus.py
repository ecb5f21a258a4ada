"""Networks as weights files in the five formats: GoogLeNets of the least width, so that most bytes are structure."""

from __future__ import annotations

import io
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import safetensors.torch
import torch

# The tests have encoders of the formats that we only read.
sys.path.append(str(Path(__file__).parents[2] / "tests" / "helpers"))
import networks

#: Divides all widths, of which at least 2 remain.
_NARROW = 1000
_NORMS = [{"depth_radius": 5, "bias": 1.0, "alpha": 1e-4, "beta": 0.5}] * 2


def safetensors_files(folder: Path) -> Iterator[bytes]:
    """Networks of all flavours as .safetensors files."""
    for flavour in ("bvlc", "inception5h", "torchvision", "patterns"):
        yield networks.random_googlenet(folder / f"{flavour}.safetensors", flavour, narrow=_NARROW).read_bytes()


def pth_files(folder: Path) -> Iterator[bytes]:
    """State dicts as torch saves them, in both of its formats."""
    tensors = {name: torch.from_numpy(value) for name, value in _tensors("bvlc").items()}
    for contents, zipped in ((tensors, True), ({"state_dict": tensors}, True), (tensors, False)):
        stream = io.BytesIO()
        torch.save(contents, stream, _use_new_zipfile_serialization=zipped)
        yield stream.getvalue()
    # A safetensors file under another name.
    yield safetensors.torch.save(tensors)


def caffemodel_files(folder: Path) -> Iterator[bytes]:
    """Caffe's files, of both ages."""
    for legacy in (False, True):
        yield networks.caffemodel(_tensors("bvlc"), legacy)


def graph_files(folder: Path) -> Iterator[bytes]:
    """TensorFlow's graphs."""
    for as_float_list in (False, True):
        yield networks.graphdef(_tensors("inception5h"), _NORMS, as_float_list)


def graph_archives(folder: Path) -> Iterator[bytes]:
    """TensorFlow's graphs with class names, in archives."""
    for method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", method) as archive:
            archive.writestr("tensorflow_inception_graph.pb", next(graph_files(folder)))
            archive.writestr("imagenet_comp_graph_label_strings.txt", "dummy\nkit fox\nEnglish setter\n")
        yield stream.getvalue()


def _tensors(flavour: str) -> dict[str, np.ndarray]:
    return networks.random_tensors(flavour, narrow=_NARROW)

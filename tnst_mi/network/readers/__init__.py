"""Readers of GoogLeNet weights: GraphDef, caffemodel, torch state dict, safetensors; none executes code from a file.

network_weights   what all of them return, and the check that it is a GoogLeNet
protobuf          the wire format of GraphDef and caffemodel
graphdef, caffemodel, state_dict   one file format each
quantised         the 8-bit form of the network that ships with the package
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.machine.gate import decoding
from tnst_mi.network.readers.caffemodel import read_caffemodel
from tnst_mi.network.readers.graphdef import read_graphdef
from tnst_mi.network.readers.network_weights import MalformedFile, NetworkWeights
from tnst_mi.network.readers.quantised import from_quantised, is_quantised
from tnst_mi.network.readers.state_dict import (
    flavour_of_names,
    from_state_dict,
    read_pth,
    read_safetensors,
    safetensors_header,
)
from tnst_mi.network.shipped import PATTERNS

CLASS_LIST = "imagenet_comp_graph_label_strings.txt"
"""Inception5h's class names: a member of inception5h.zip, or a file beside the .pb or the state dict."""

SUFFIXES = (".safetensors", ".caffemodel", ".pb", ".zip", ".pth", ".pt")
"""The file formats, identified by the file extension."""

_GRAPH = "tensorflow_inception_graph.pb"
_ZIP_MAGIC = b"PK\x03\x04"
_LARGEST_FILE = 1 << 28
"""In bytes; the published files have 28 to 54 million. Keeps unrelated large files out of memory."""

_LARGEST_RATIO, _SMALL_ARCHIVE = 16, 1 << 20
"""Weights hardly shrink: no archive unfolds to more than so many times its size, or else to so many bytes."""


def read_weights(path: Path) -> NetworkWeights:
    """The network in a weights file, in float32.

    Raises `InputError` for a file that is missing, truncated, in no known format, or not a GoogLeNet.
    """
    with _input_errors(path):
        return _read(path)


def flavour_of(path: Path) -> str:
    """The flavour of a weights file, from its format, metadata and tensor names; raises `InputError`."""
    with _input_errors(path):
        match _suffix(path):
            case ".caffemodel":
                return "bvlc"
            case ".pb" | ".zip":
                return "inception5h"
            case ".safetensors":
                names, metadata = safetensors_header(path)
                return PATTERNS if is_quantised(names, metadata) else flavour_of_names(names)
            case _:
                return flavour_of_names(read_pth(path))


@contextmanager
def _input_errors(path: Path) -> Iterator[None]:
    """Turn errors in reading a file into one line that names it."""
    with decoding(path, "the weights of a GoogLeNet"):
        try:
            yield
        except MalformedFile as error:
            raise InputError(
                f"{path}: {error}; expected the weights of a GoogLeNet (tnst-mi weights lists them)"
            ) from None


def _suffix(path: Path) -> str:
    """The file extension, which determines the format; also checks the size."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise MalformedFile(f"no known weights format (the name ends in {suffix!r}, not in {', '.join(SUFFIXES)})")
    if (size := _unpacked_size(path)) > _LARGEST_FILE:
        raise MalformedFile(f"too large ({size} bytes)")
    return suffix


def _read(path: Path) -> NetworkWeights:
    suffix = _suffix(path)
    if suffix == ".caffemodel":
        return read_caffemodel(path.read_bytes())
    if suffix == ".zip":
        return _read_zip(path)
    if suffix == ".pb":
        weights = read_graphdef(path.read_bytes())
    elif suffix == ".safetensors":
        names, metadata = safetensors_header(path)
        tensors = read_safetensors(path)
        if is_quantised(names, metadata):
            return from_quantised(tensors, metadata)
        weights = from_state_dict(tensors)
    else:
        weights = from_state_dict(read_pth(path))
    class_list = path.with_name(CLASS_LIST)
    if weights.flavour == "inception5h" and class_list.is_file():
        weights = replace(weights, class_names=_class_names(class_list.read_bytes()))
    return weights


def _unpacked_size(path: Path) -> int:
    """Bytes that reading needs; a zip archive (`torch.save` writes one) can expand beyond its own size."""
    with path.open("rb") as file:
        if file.read(len(_ZIP_MAGIC)) != _ZIP_MAGIC:
            return path.stat().st_size
    with _archive(path) as archive:
        unpacked = sum(member.file_size for member in archive.infolist())
    if unpacked > max(_SMALL_ARCHIVE, _LARGEST_RATIO * (stored := path.stat().st_size)):
        raise MalformedFile(f"an archive of {stored} bytes that claims to hold {unpacked}")
    return unpacked


def _read_zip(path: Path) -> NetworkWeights:
    """inception5h.zip as published: the graph and its class names."""
    with _archive(path) as archive:
        members = {Path(member.filename).name: member for member in archive.infolist()}
        contents = {name: archive.read(members[name]) for name in (_GRAPH, CLASS_LIST) if name in members}
    if _GRAPH not in contents:
        raise MalformedFile(f"the archive has no {_GRAPH}")
    weights = read_graphdef(contents[_GRAPH])
    if CLASS_LIST in contents:
        weights = replace(weights, class_names=_class_names(contents[CLASS_LIST]))
    return weights


@contextmanager
def _archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """An open zip archive; any error in it becomes `MalformedFile`."""
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except Exception as error:  # a damaged directory raises more than BadZipFile: zlib, Unicode, RuntimeError, …
        raise MalformedFile(f"truncated or not a zip archive ({error})") from None


def _class_names(text: bytes) -> tuple[str, ...]:
    try:
        return tuple(line.strip() for line in text.decode("utf-8").splitlines() if line.strip())
    except UnicodeDecodeError:
        raise MalformedFile(f"{CLASS_LIST} is not UTF-8 text") from None

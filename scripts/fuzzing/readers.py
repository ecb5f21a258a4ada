"""The readers of files that people bring, and of what earlier runs left, each called as the commands call it."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from fuzzing import corpus, own_corpus, usd_corpus, weights_corpus
from tnst_mi import GoogLeNet, Recipe, load_frames
from tnst_mi.atlas.layer_atlas import means_in
from tnst_mi.commands import info
from tnst_mi.commands.arguments import InfoArguments
from tnst_mi.errors import InputError
from tnst_mi.io.cameras.reading import read_cameras
from tnst_mi.losses.pictures import read_image
from tnst_mi.machine.terminal import one_line
from tnst_mi.optimisation.items.store import FolderStore
from tnst_mi.recipe.keys import Texts
from tnst_mi.recipe.sections import KINDS
from tnst_mi.run.folder import frame_names, input_of_run
from tnst_mi.run.resuming import resumable_run


@dataclass(frozen=True)
class Reader:
    """A reader.

    Attributes:
        file: the name of the file that is damaged.
        undamaged: makes such files, in a folder where it may write.
        read: reads one, given the path of the file that a user would name.
        named: the name of that file; that of the damaged one if empty.
        beside: undamaged files beside it, by name.
    """

    file: str
    undamaged: Callable[[Path], Iterable[bytes]]
    read: Callable[[Path], object]
    named: str = ""
    beside: Mapping[str, bytes] = field(default_factory=dict)

    def corpus(self, folder: Path) -> list[bytes]:
        """Undamaged files."""
        return list(self.undamaged(folder))

    def read_damaged(self, content: bytes, folder: Path) -> None:
        """Write a damaged file and those beside it into a folder, and read them."""
        for name, written in (self.beside | {self.file: content}).items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(written)
        self.read(folder / (self.named or self.file))


def _described_and_loaded(path: Path) -> None:
    info.run(InfoArguments(files=(path,)))
    load_frames(path)


def _resumed(path: Path) -> None:
    """The folder of a run, by the three commands that read one: to go on, to replace it, and to render it."""
    resumable_run(path.parent, Recipe(), {"sha256": own_corpus.WEIGHTS})
    frame_names(path.parent)
    input_of_run(path.parent)


def _flags(path: Path) -> None:
    lines = path.read_bytes().decode("utf-8", "surrogateescape").split("\n")
    pairs = (line.partition("=") for line in lines)
    try:
        Recipe().updated_by_flags(
            {name: (text,) if isinstance(KINDS[name], Texts) else text for name, _, text in pairs if name in KINDS}
        )
    except InputError as error:
        # Flags are no file, and the command line shortens what it says of them.
        raise InputError(one_line(str(error))) from None


def _seen_from(path: Path) -> None:
    """The cameras of a shot at a frame and between two."""
    cameras = read_cameras(str(path))
    for number in (2, 2.5):
        cameras.at(number, "z")


def _adaptive_vdb() -> bytes:
    with TemporaryDirectory() as folder:
        return own_corpus.adaptive_vdb(Path(folder))


_RUN_RESULTS = {f"{kind}/{own_corpus.FRAME}.npz": b"present" for kind in ("density", "velocity")}

#: All readers by name.
READERS = {
    "npz": Reader("smoke_0001.npz", corpus.npz_files, _described_and_loaded),
    "npz_obstacle": Reader(
        "smoke_obstacle_0001.npz",
        corpus.obstacle_files,
        _described_and_loaded,
        "smoke_0001.npz",
        {"smoke_0001.npz": corpus.npz({"density": corpus.DENSITY})},
    ),
    "npy": Reader("smoke_0001.npy", corpus.npy_files, _described_and_loaded),
    "vdb": Reader("smoke_0001.vdb", corpus.vdb_files, _described_and_loaded),
    "vdb_of_others": Reader("smoke_0001.vdb", corpus.vdb_files_of_others, _described_and_loaded),
    "uni": Reader("density_0001.uni", corpus.uni_files, _described_and_loaded),
    "vol": Reader("density_0001.vol", corpus.vol_files, _described_and_loaded),
    "toml": Reader("recipe.toml", corpus.recipe_files, Recipe.from_toml),
    "cameras": Reader("shot.toml", corpus.camera_files, lambda path: read_cameras(str(path))),
    "cameras_json": Reader("shot.json", corpus.camera_json_files, lambda path: read_cameras(str(path))),
    "picture": Reader("style.png", corpus.picture_files, read_image),
    "exr": Reader("style.exr", corpus.exr_files, read_image),
    "radiance": Reader("style.hdr", corpus.radiance_files, read_image),
    "safetensors": Reader("network.safetensors", weights_corpus.safetensors_files, GoogLeNet.load),
    "pth": Reader("network.pth", weights_corpus.pth_files, GoogLeNet.load),
    "caffemodel": Reader("network.caffemodel", weights_corpus.caffemodel_files, GoogLeNet.load),
    "pb": Reader("network.pb", weights_corpus.graph_files, GoogLeNet.load),
    "run": Reader(
        "run.json",
        own_corpus.run_files,
        _resumed,
        beside=_RUN_RESULTS | {"recipe.toml": Recipe().to_toml().encode()},
    ),
    "run_recipe": Reader(
        "recipe.toml",
        own_corpus.run_recipe_files,
        _resumed,
        beside=_RUN_RESULTS | {"run.json": next(own_corpus.run_files(Path()))},
    ),
    "state": Reader(
        "fields/000000.000001.safetensors",
        own_corpus.state_files,
        lambda path: FolderStore(path.parent.parent).read("fields", 0),
    ),
    "numbers": Reader(
        "numbers.json", own_corpus.numbers_files, lambda path: FolderStore(path.parent).numbers("exposure")
    ),
    "log": Reader("metrics.jsonl", own_corpus.log_files, lambda path: FolderStore(path.parent).entries("0")),
    "atlas": Reader("000_picture.png", own_corpus.atlas_files, means_in),
    "configuration": Reader(
        "config/config_0001.uni",
        own_corpus.configuration_files,
        _described_and_loaded,
        "data/smoke_0001.vdb",
        {"data/smoke_0001.vdb": _adaptive_vdb()},
    ),
    "flags": Reader("flags.txt", own_corpus.flag_files, _flags),
    "zip": Reader("network.zip", weights_corpus.graph_archives, GoogLeNet.load),
}
if importlib.util.find_spec("pxr") is not None:
    # Each read starts a process.
    READERS |= {
        "usd": Reader("shot.usd", usd_corpus.stages, _seen_from),
        "usdz": Reader("shot.usdz", usd_corpus.packages, _seen_from),
    }

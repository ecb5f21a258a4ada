"""The readers of files that people bring, each called as the commands call it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fuzzing import corpus, weights_corpus
from tnst_mi import GoogLeNet, Recipe, load_frames
from tnst_mi.commands import info
from tnst_mi.commands.arguments import InfoArguments
from tnst_mi.losses.pictures import read_image


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
        for name, other in self.beside.items():
            (folder / name).write_bytes(other)
        (folder / self.file).write_bytes(content)
        self.read(folder / (self.named or self.file))


def _described_and_loaded(path: Path) -> None:
    info.run(InfoArguments(files=(path,)))
    load_frames(path)


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
    "picture": Reader("style.png", corpus.picture_files, read_image),
    "exr": Reader("style.exr", corpus.exr_files, read_image),
    "radiance": Reader("style.hdr", corpus.radiance_files, read_image),
    "safetensors": Reader("network.safetensors", weights_corpus.safetensors_files, GoogLeNet.load),
    "pth": Reader("network.pth", weights_corpus.pth_files, GoogLeNet.load),
    "caffemodel": Reader("network.caffemodel", weights_corpus.caffemodel_files, GoogLeNet.load),
    "pb": Reader("network.pb", weights_corpus.graph_files, GoogLeNet.load),
    "zip": Reader("network.zip", weights_corpus.graph_archives, GoogLeNet.load),
}

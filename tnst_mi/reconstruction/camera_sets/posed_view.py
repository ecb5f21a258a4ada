"""A view of a reconstruction as its file describes it: a camera, and the names of its pictures."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.io.cameras.scene_camera import SceneCamera

#: Where the name of a picture has the number of the frame.
_NUMBER = re.compile(r"#+")


@dataclass(frozen=True)
class PosedView:
    """A camera and its pictures.

    Attributes:
        name: of the view, for messages and results.
        image: file of the picture; #### stands for the number of the frame.
        camera: gives the camera in the scene for pictures of (width, height) pixels.
        mask: file of a picture that is 0 where pixels do not count; None if all do.
        background: file of a picture without smoke; None if there is none.
        held_out: whether it judges the result instead of being used.
        layer: which of the pictures of an .npz file each of them is, from 0; None where all are files of one picture.
    """

    name: str
    image: Path
    camera: Callable[[tuple[int, int]], SceneCamera]
    mask: Path | None = None
    background: Path | None = None
    held_out: bool = False
    layer: int | None = None

    def files(self, number: int | None) -> list[Path]:
        """The picture of a frame, its mask and its background.

        Raises:
            InputError: the name of the picture has no place for the number of the frame.
        """
        beside = [file_of_any_frame(file, number) for file in (self.mask, self.background) if file is not None]
        return [file_of_frame(self.image, number), *beside]

    def layer_in(self, file: Path) -> int | None:
        """The number of the view's picture in one of its files: in those of several, or in all if none is one."""
        named = [path for path in (self.image, self.mask, self.background) if path is not None]
        return self.layer if _holds_several(file) or not any(map(_holds_several, named)) else None


@dataclass(frozen=True)
class CameraSet:
    """What a file of cameras says.

    Attributes:
        file: its path.
        up: which axis of its scene is up, "y" or "z".
        views: the views, in its order.
        settings: of the reconstruction, by name.
        remarks: what was assumed, to be said.
    """

    file: Path
    up: str
    views: Sequence[PosedView]
    settings: Mapping[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


def file_of_frame(path: Path, number: int | None) -> Path:
    """The file of a frame, by a path that has #### in the place of its number.

    Raises:
        InputError: there is a number and no place for it, or the other way round.

    Example:
        >>> file_of_frame(Path("left/smoke_####.png"), 7).name
        'smoke_0007.png'
    """
    marks = _NUMBER.search(path.name)
    if number is None and marks:
        raise InputError(f"{path}: has {marks[0]} in place of a frame's number; say of which frames, as --frames 49:72")
    if number is None:
        return path
    if not marks:
        raise InputError(f"{path}: is the same picture for all frames; write #### where it has the frame's number")
    return path.with_name(f"{path.name[: marks.start()]}{number:0{len(marks[0])}d}{path.name[marks.end() :]}")


def file_of_any_frame(path: Path, number: int | None) -> Path:
    """The file of a mask or a background in a frame, which may be the same for all frames."""
    return file_of_frame(path, number) if "#" in path.name else path


def require_files(views: Sequence[PosedView], numbers: Sequence[int | None]) -> None:
    """Check that the pictures, masks and backgrounds of all frames are there.

    Raises:
        InputError: some are not, or the name of a picture has no place for the number of the frame.
    """
    missing: dict[Path, str] = {}
    for number in numbers:
        of_frame = "" if number is None else f" in frame {number}"
        for view in views:
            gone = [file for file in view.files(number) if file not in missing and not os.path.isfile(file)]
            missing |= dict.fromkeys(gone, f"view {view.name}{of_frame}")
    if missing:
        file, wanted = next(iter(missing.items()))
        more = f", and {len(missing) - 1} more are missing" if len(missing) > 1 else ""
        remedy = "" if None in numbers else ", or give other --frames"
        raise InputError(f"{file}: no such file, expected for {wanted}{more}; put it there{remedy}")


def _holds_several(path: Path) -> bool:
    return path.suffix.lower() == ".npz"

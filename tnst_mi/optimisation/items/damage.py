"""What in a folder of items is not what was written, and what is not damage."""

from __future__ import annotations

import errno
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from tnst_mi.errors import StoppedError
from tnst_mi.io.atomic import remove_folder
from tnst_mi.machine.terminal import one_line


class DamagedItemError(StoppedError):
    """An item is not what was written; a run makes it anew when it finds it.

    Attributes:
        group, frame, generation: of the item; the group is None if it is the numbers.
    """

    def __init__(
        self, item: object, reason: object, group: str | None = None, frame: int = 0, generation: int = 0
    ) -> None:
        super().__init__(one_line(f"{item}: damaged ({reason}); --resume makes anew what is lost"))
        self.group, self.frame, self.generation = group, frame, generation
        self._given = item, reason, group, frame, generation

    def __reduce__(self) -> tuple[type[DamagedItemError], tuple[object, ...]]:
        """As another process gets it, which has to be what it was made of rather than the message."""
        item, reason, *where = self._given
        return DamagedItemError, (str(item), str(reason), *where)


@contextmanager
def reading(path: Path, group: str | None = None, frame: int = 0, generation: int = 0) -> Iterator[None]:
    """Whatever is raised in reading an item means that it is damaged: decoders raise many types.

    Raises:
        DamagedItemError: it is damaged.
        OSError: too many files are open, which says nothing about it.
    """
    try:
        yield
    except (DamagedItemError, MemoryError):
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
            raise
        raise DamagedItemError(path, error, group, frame, generation) from None


def remove_misplaced(folder: Path, files: Collection[Path]) -> None:
    """Remove folders in the place of files, and files in that of folders: they would be in the way of items.

    Args:
        folder: the folder of the groups of items.
        files: what in it is a file.
    """
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.is_dir() == (path in files):
            remove_folder(path)
    for path in folder.glob("*/*.safetensors"):
        if not path.is_file():
            remove_folder(path)

"""Pictures that are sent to the page, by the readers of untrusted pictures."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.losses.pictures import GreyImage, read_image
from tnst_mi.machine.terminal import displayable, one_line


def uploaded_picture(name: str, body: bytes) -> GreyImage:
    """What is read of a picture.

    Args:
        name: that of its file, for what is said of it.
        body: the bytes of the file, bounded in number.

    Raises:
        InputError: it cannot be read as a picture.
    """
    with tempfile.TemporaryDirectory(prefix="tnst_mi-") as folder:
        path = Path(folder) / "uploaded"
        path.write_bytes(body)
        try:
            return read_image(path)
        except InputError as error:
            raise InputError(one_line(str(error).replace(str(path), displayable(Path(name).name)))) from None

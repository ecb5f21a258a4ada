"""Exceptions that the command line reports in one line, each with its own exit code."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class InputError(ValueError):
    """A file, value or option given by the user cannot be used: exit code 2.

    The message is one line. It names the file or key, the value found, what was expected and,
    if there is one, the remedy.
    """


class MissingFileError(InputError):
    """A file that a recipe names is not there, which is no fault of the recipe's."""


class UnforeseenError(InputError):
    """A file cannot be used, for a reason that nothing in the code foresees: the fault may be ours."""


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Errors in what is inside, which does not know its file, begin with the file's name.

    Raises:
        InputError: what is inside does.
    """
    try:
        yield
    except InputError as error:
        raise type(error)(f"{path}: {error}") from None


class StoppedError(RuntimeError):
    """A run had to stop for an external reason and can be resumed: exit code 3.

    The message is one line that names the reason and the remedy.
    """

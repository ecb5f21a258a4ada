"""The one exception that means "the input is wrong": the command line turns it into one line and exit code 2."""

from __future__ import annotations


class InputError(ValueError):
    """A file, value or option given by the user cannot be used.

    The message is one line. It names the file or key, the value found, what was expected and,
    where there is one, the remedy.
    """

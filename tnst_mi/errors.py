"""Exceptions that the command line reports in one line, each with its own exit code."""

from __future__ import annotations


class InputError(ValueError):
    """A file, value or option given by the user cannot be used: exit code 2.

    The message is one line. It names the file or key, the value found, what was expected and,
    if there is one, the remedy.
    """


class StoppedError(RuntimeError):
    """A run had to stop for an external reason and can be resumed: exit code 3.

    The message is one line that names the reason and the remedy.
    """

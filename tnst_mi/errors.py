"""The exceptions that the command line turns into one line and an exit code of their own."""

from __future__ import annotations


class InputError(ValueError):
    """A file, value or option given by the user cannot be used: exit code 2.

    The message is one line. It names the file or key, the value found, what was expected and,
    where there is one, the remedy.
    """


class StoppedError(RuntimeError):
    """A run could not go on for a reason outside of it, and can be resumed: exit code 3.

    The message is one line that names the reason and the remedy.
    """

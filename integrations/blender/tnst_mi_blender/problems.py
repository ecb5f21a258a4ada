"""What stands in the way of a stylization, in words for artists."""

from __future__ import annotations


class CannotStylizeError(Exception):
    """Something is missing or cannot be used; the message is one line with the remedy, made to be shown as it is."""

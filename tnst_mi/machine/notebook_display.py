"""Objects that show themselves in a notebook.

Their classes are of the lower layers, and what they show is made by the renderer, far above. The package, which knows
both, says on import what makes it (`tnst_mi.__init__`).
"""

from __future__ import annotations

import html
from collections.abc import Callable

from tnst_mi.machine.terminal import one_line, printable, shortened

#: Most characters of the text that stands for an object.
_LONGEST = 2000


class _Cards:
    """What makes the HTML of an object; set when the package is imported."""

    of: Callable[[object], str]


def show_by(card: Callable[[object], str]) -> None:
    """From now on, objects that show themselves do so by the HTML that this function makes of them."""
    _Cards.of = staticmethod(card)


class NotebookDisplay:
    """Base of classes whose objects show themselves."""

    def _repr_html_(self) -> str:
        """What a notebook shows; never raises: without a picture of the object, it is its text and the reason."""
        try:
            return _Cards.of(self)
        except Exception as error:
            return f"<pre>{html.escape(_text(self))}\n\nnot shown as a picture: {html.escape(_reason(error))}</pre>"


def _text(shown: object) -> str:
    """The text of an object, shortened; that of its type if it has none."""
    try:
        lines = repr(shown).splitlines()
    except Exception:
        lines = [object.__repr__(shown)]
    return shortened("\n".join(printable(line) for line in lines), _LONGEST)


def _reason(error: Exception) -> str:
    return one_line(str(error)) or type(error).__name__

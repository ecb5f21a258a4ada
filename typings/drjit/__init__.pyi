"""Dr.Jit as an untyped module.

Its own stubs describe the arrays of one variant, chosen when a program is checked, and refuse what this package does
with them all the time: `dr.detach`, `dr.ravel` and `CustomOp.grad_in` answer `object`, a vector times a `mi.Float` is
an error, and `drjit.auto.ad.Float` is another type than `mitsuba.Float`, though they are one at run time.
"""

from typing import Any

def __getattr__(name: str) -> Any: ...

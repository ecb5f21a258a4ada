"""Mitsuba's variants: each side of a comparison may have its own, that of the run if it names none.

Scenes of different variants can be loaded at the same time, but each must be used while its own variant is active.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import drjit as dr
import mitsuba as mi

from tnst_mi.compare.bench.renderers.sides import OURS, Side
from tnst_mi.errors import InputError
from tnst_mi.machine.loaded_llvm import check_llvm

#: What films of spectral variants show of a spectrum that is 1 everywhere: the constant by which Mitsuba 3.9.1 divides
#: is not quite the integral of its luminous efficiency.
SPECTRAL_WHITE = 1.0010002

#: Weights of red, green and blue in a luminance (Rec. 709, as Mitsuba's films have them).
LUMINANCE = (0.212671, 0.715160, 0.072169)

_BUILDING = "https://mitsuba.readthedocs.io/en/stable/src/developer_guide/compiling.html"


def variant_of(side: Side, of_smoke: bool) -> str:
    """The variant that a side is rendered in; the active one must be that of the run.

    Args:
        side: its `variant` is a whole name, or one without the backend, which is then that of the run: `mono` is
            `llvm_ad_mono` on a CPU.
        of_smoke: whether it shows a density, from several views at once.

    Raises:
        InputError: Mitsuba lacks the variant, or the side does not work in it.
    """
    own = mi.variant()
    assert own is not None, "a variant is active"
    if not side.variant:
        return own
    backend = own[: own.index("_ad_") + len("_ad_")]
    name = next((name for name in (side.variant, backend + side.variant) if name in mi.variants()), None)
    if name is None:
        raise InputError(
            f"{side.text}: Mitsuba {mi.__version__} as installed has no variant {side.variant}, expected one of "
            f"{', '.join(mi.variants())}; others, such as those of double precision, are compiled from its source: "
            f"{_BUILDING}"
        )
    if reason := _unsuited(side, name, of_smoke):
        raise InputError(f"{side.text}: {reason}")
    _require_device(side, name)
    return name


def _unsuited(side: Side, variant: str, of_smoke: bool) -> str:
    """Why a side does not work in a variant; "" if it does."""
    if "_ad_" not in variant:
        if side.kind in (OURS, "prbvolpath"):
            return f"is not in {variant}, which does not differentiate; expected volpath, volpathmis or a scene file"
        if of_smoke:
            return (
                f"{variant} renders one ray after the other, expected a Mitsuba scene as INPUT, or a variant with _ad_"
            )
    if "polarized" in variant:
        if side.kind not in ("volpath", "scene"):
            return f"does not work with the Stokes vectors of {variant}, expected volpath or a scene file"
        if of_smoke:
            return f"the views of smoke have no Stokes vectors of {variant}, expected a Mitsuba scene as INPUT"
    return ""


def _require_device(side: Side, variant: str) -> None:
    if variant.startswith("llvm"):
        check_llvm()
    if variant.startswith("cuda") and not dr.has_backend(dr.JitBackend.CUDA):
        raise InputError(f"{side.text}: {variant} needs an NVIDIA GPU, and none answers; choose another variant")


@contextmanager
def within(variant: str) -> Iterator[None]:
    """Within the block, a variant is active; afterwards, the one from before."""
    before = mi.variant()
    if variant != before:
        mi.set_variant(variant)
    try:
        yield
    finally:
        if before is not None and mi.variant() != before:
            mi.set_variant(before)

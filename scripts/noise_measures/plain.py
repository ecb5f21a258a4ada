"""Scattering smoke as Mitsuba's `prbvolpath` alone renders and differentiates it, to compare ours with."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from tnst_mi.rendering.scattering import ScatteringRenderer


class PlainPathTracer(ScatteringRenderer):
    """A `ScatteringRenderer` that leaves everything to `prbvolpath`; the rays and the majorant are the same."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._once = None

    def _integrators(self, majorant: float) -> tuple[dict[str, Any], dict[str, Any]]:
        ours, _ = super()._integrators(majorant)
        plain = {"type": "prbvolpath", "hide_emitters": True, **{key: ours[key] for key in ("max_depth", "rr_depth")}}
        return plain, plain

    def _scattering_everywhere(self, density: mi.TensorXf) -> mi.TensorXf:
        return density

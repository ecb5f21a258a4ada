"""The names that a recipe chooses from, where what they mean is somewhere else."""

from __future__ import annotations

QUADRATURES = ("paper", "exact", "transmittance")
"""How the emission–absorption integral along a ray (paper Eq. 11) is discretised.

With samples d_k of the density at distance h, from the sensor away:

    paper          h Σ_k d_k exp(−γ h Σ_{i≤k} d_i)     the inclusive sum of the authors' program
    exact          (1 − exp(−γ h Σ_k d_k)) / γ         every segment integrated exactly; the sum telescopes
    transmittance  1 − exp(−γ h Σ_k d_k)               γ times exact: opacity alone

The continuous integral is the exact one's limit. Where γ h d ≳ 1, "paper" departs from it: dense smoke darkens.
"""

WINDOW_WEIGHTS = ("uniform", "triangle", "gaussian")
"""The shapes of a window in time, see `tnst_mi.optimisation.window.window_weights`."""

LOOKS = ("thin", "medium", "thick")
"""How dense the smoke appears in a beauty render; each is a Mitsuba scene in `scenes/looks`."""

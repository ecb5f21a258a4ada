"""Names that a recipe can choose from, whose meaning is implemented elsewhere."""

from __future__ import annotations

QUADRATURES = ("paper", "exact", "transmittance", "integrated_transmittance")
"""How the emission–absorption integral along a ray (paper Eq. 11) is discretised.

For density samples d_k with spacing h, ordered away from the sensor:

    paper                     h Σ_k d_k exp(−γ h Σ_{i≤k} d_i)   inclusive sum, as in the authors' program
    exact                     (1 − exp(−γ h Σ_k d_k)) / γ       every segment integrated exactly; the sum telescopes
    transmittance             1 − exp(−γ h Σ_k d_k)             γ times exact: opacity alone
    integrated_transmittance  h Σ_k exp(−γ h Σ_{i≤k} d_i)       transmittance without density, over the grid's box

"exact" converges to the continuous integral. Where γ h d ≳ 1, "paper" deviates from it: dense smoke darkens. The last
is what the paper's supplement compares the product of density and transmittance with. Empty space counts in it: a ray
shows its length inside the box where there is no smoke, and less where there is.
"""

STYLE_LOSSES = ("gram", "paper", "swd", "nnfm", "histogram")
"""What is compared of the features of the smoke and of a style picture.

    gram       Gram matrices, relative to the picture's
    paper      Gram matrices, by Eq. 7 of the paper
    swd        sliced Wasserstein distance
    nnfm       nearest-neighbour feature matching
    histogram  Gram matrices and the histograms of all channels

docs/losses.md has their formulas."""

STYLE_STATISTICS = ("image", "smoke")
"""Which positions of an image count in statistics of a style: all alike, or each by the opacity of the smoke there."""

TRACES = ("step", "flow")
"""How transport follows a velocity, see `tnst_mi.fields.advection.advect`."""

WINDOW_WEIGHTS = ("uniform", "triangle", "gaussian")
"""Shapes of the temporal window, see `tnst_mi.optimisation.temporal.window.window_weights`."""

QUALITIES = ("draft", "preview", "final")
"""How far a run goes on the way that its recipe describes, see `tnst_mi.recipe.quality`."""

LOOKS = ("thin", "medium", "thick")
"""How dense the smoke appears in a beauty render; each is a Mitsuba scene in `scenes/looks`."""

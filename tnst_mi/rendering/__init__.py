"""Rendering a density.

`renderer` holds the common interface of all renderers, the emission–absorption renderer, and `tnst_mi.render`; it
builds on `march` (the integrator plugin) and `cameras`. `scattering` is the path-traced alternative, `driving` chooses
between them. `studio`, `looks` and `pictures` make the final pictures.
"""

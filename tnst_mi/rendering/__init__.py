"""From a density to pictures.

`renderer` has the one interface of all renderers, the emission–absorption one, and `tnst_mi.render`; what it calls is
in `march` (the integrator plugin) and `cameras`. `scattering` is the path-traced alternative, `driving` chooses.
`studio`, `looks` and `pictures` make the lit pictures of the end.
"""

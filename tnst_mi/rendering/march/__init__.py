"""The `emission_absorption` integrator plugin (Eq. 11) and what it marches through.

Read `integrator` first; then `medium` (the grid), `lattice` (the samples of a ray), `grid_march` (visiting them), `quadratures`
(what they add up to), `occupancy` (skipping empty space), `back_projection` (the adjoint), and `boundary` (media inside Mitsuba scenes).
"""

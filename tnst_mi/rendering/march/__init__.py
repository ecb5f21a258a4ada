"""The `emission_absorption` integrator plugin (Eq. 11) and what it marches through.

Read `integrator` first; then how one grid is marched: `medium` (the grid), `lattice` (the samples of a ray),
`grid_march` (visiting them), `quadratures` (what they add up to), `occupancy` (skipping empty space) and
`back_projection` (the adjoint). Last what scenes add: `scene_media` (their media), `ray_path` (where rays pass through
these), `segments` (the parts of a ray in each) and `behind` (what is seen at its end).
"""

"""Regions: where a goal applies. `regions` evaluates the masks of a recipe on the grid of each frame: `shapes` in the
scene, `projection` of a painted picture, `stored` grids, `following` the smoke; `measured_masks` says what they hold.
`octave_masks` brings them to octaves so that nothing outside changes, and `seen` finds which part of an image is
theirs.
"""

"""Where grids lie, and which a frame has: affine maps between cells, voxels and the scene, resampling along them.

Coordinates are (X, Y, Z) throughout; whole numbers are the centres of cells and voxels. Start with `affine`.
"""

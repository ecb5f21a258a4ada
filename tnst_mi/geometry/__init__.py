"""Where grids lie: affine maps between cells, voxels and the scene, and resampling along them.

Coordinates are (X, Y, Z) throughout; whole numbers are the centres of cells and voxels. Start with `affine`.
"""

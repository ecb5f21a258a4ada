"""The OpenVDB file format: `reader` and `writer`, the trees of a file's grids, their values and metadata."""

"""OpenVDB files (.vdb), read and written without the OpenVDB library: trees of scalars and vectors."""

from __future__ import annotations

from tnst_mi.geometry.boxes import Box
from tnst_mi.io.grids.vdb.file_format.reader import Grid, VdbFile, read_vdb
from tnst_mi.io.grids.vdb.file_format.tree import Tree
from tnst_mi.io.grids.vdb.file_format.writer import DenseGrid, write_vdb
from tnst_mi.io.grids.vdb.limits import require_small

__all__ = ["Box", "DenseGrid", "Grid", "Tree", "VdbFile", "read_vdb", "require_small", "write_vdb"]

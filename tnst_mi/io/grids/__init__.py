"""The file formats of grids, each read and written in its own axes and units: npz, .uni, .vol, .vdb."""

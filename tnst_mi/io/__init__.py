"""Reading and writing files.

`grids` and `pictures` implement the file formats. `files` finds the files of an input; `interpretation` decides what
their grids are, and in which axes and units. `formats` reads and writes one frame in any format. `sequence`, the usual
entry point, handles files and folders of frames. Writers share `atomic`, readers `untrusted`.
"""

from __future__ import annotations

from tnst_mi.io.sequence import load_frames, open_frames, save_frames

__all__ = ["load_frames", "open_frames", "save_frames"]

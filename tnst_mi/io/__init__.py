"""Reading and writing files.

`grids` and `pictures` implement the file formats. `formats` reads and writes one frame in any of them, with what the
format leaves open (`conventions`, `orientation`, `staggered`) and the files beside it (`companions`). `sequence`, the
usual entry point, handles files and folders of frames. Writers share `atomic`, readers `untrusted`.
"""

from __future__ import annotations

from tnst_mi.io.sequence import load_frames, open_frames, save_frames

__all__ = ["load_frames", "open_frames", "save_frames"]

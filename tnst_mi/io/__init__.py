"""Files in and out.

`grids` and `pictures` have the formats. A frame is read and written by `formats`, whatever its format, with what the
format leaves open (`conventions`, `orientation`, `staggered`) and the files beside it (`companions`); `sequence` is for
files and folders of frames, and for everyone. `atomic` and `untrusted` are for all that writes and reads.
"""

from __future__ import annotations

from tnst_mi.io.sequence import load_frames, open_frames, save_frames

__all__ = ["load_frames", "open_frames", "save_frames"]

"""Files in and out: npz frames, EXR and PNG pictures."""

from __future__ import annotations

from tnst_mi.io.sequence import load_frames, open_frames, save_frames

__all__ = ["load_frames", "open_frames", "save_frames"]

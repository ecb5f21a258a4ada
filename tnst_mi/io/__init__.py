"""Files in and out: frames as npz, .vol, .uni and .vdb, EXR and PNG pictures, videos."""

from __future__ import annotations

from tnst_mi.io.sequence import load_frames, open_frames, save_frames

__all__ = ["load_frames", "open_frames", "save_frames"]

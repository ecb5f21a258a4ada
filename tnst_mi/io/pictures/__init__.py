"""The file formats of pictures and videos: PNG, EXR, mp4."""

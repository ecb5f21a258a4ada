"""Cameras: sets of views (`views`) and their rays (`orthographic`), those of shots, and both as Mitsuba sensors."""

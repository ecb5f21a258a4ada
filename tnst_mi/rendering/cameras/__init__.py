"""Cameras: sets of views (`views`), their rays (`orthographic`), and the same as a Mitsuba sensor (`sensor`)."""

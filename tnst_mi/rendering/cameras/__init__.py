"""Where the cameras stand: sets of views (`views`), their rays (`orthographic`), and as a Mitsuba sensor (`sensor`)."""

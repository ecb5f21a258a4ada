"""Files that say where cameras stand and which picture each has taken: ours, a NeRF's, and scenes of Mitsuba."""

"""Which files are the frames of an INPUT, by their names. Read `listing` first."""

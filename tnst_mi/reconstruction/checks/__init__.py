"""What pictures and cameras have to be, for a reconstruction to mean anything."""

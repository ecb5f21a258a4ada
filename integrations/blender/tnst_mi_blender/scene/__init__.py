"""From objects of the scene to `smoke`, `shots` with cameras, and `regions`; and `results` back into it."""

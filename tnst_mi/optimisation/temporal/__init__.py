"""Temporal coherence: the window of a frame (`window`), steps transported to it (`alignment`), and, beyond the paper,
changes of the density that move with the smoke (`coherence`)."""

"""The atlas of a network's layer: what excites each channel, and how it stylizes smoke."""

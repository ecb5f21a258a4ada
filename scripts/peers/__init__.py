"""Other implementations of the same computation, for comparison in `benchmark.py`."""

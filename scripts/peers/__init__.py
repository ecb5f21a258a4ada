"""The same computation written in other ways, for `benchmark.py` to compare with."""

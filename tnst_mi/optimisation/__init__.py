"""The optimisation: the paper's Algorithm 1 and its parts."""

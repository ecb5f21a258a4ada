"""One pass in place of an optimisation: a network that has learned a style gives the potentials of any smoke.

`potential_network` is the network, `prediction` runs it on a frame of any size, `model` is what a file holds of it.
"""

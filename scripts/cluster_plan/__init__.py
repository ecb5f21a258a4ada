"""A shot on workers that do not exist yet: what `scripts/plan_cluster.py` is made of.

measured    what was measured of tasks, read from a file and checked
recorded    the same, from the folder of a run on a cluster
graph       the tasks of a shot, and which waits for which
items       what tasks read and write, what workers still have of it, and what the store holds
machines    workers that share the cores of a machine
simulation  the scheduler, and what became of it all
"""

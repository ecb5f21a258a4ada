"""Runs on a cluster, measured on this machine: what `scripts/measure_cluster.py` is made of.

smoke      frames in closed form, and a digest of the results of a run
observed   a run, and what can be seen of it while it goes on
processes  a scheduler and workers that can be killed, pinned to cores, or put on hosts of their own
hosts      network namespaces as hosts
watching   what the processes of a run use
setting    what is stylized, and where its files are
part       what a part says
bits       whether results are the same: same, kills, hosts
speed      how fast: speed, predict
costs      what a cluster costs: overhead, locality
memory     whether that of the processes grows: memory
"""

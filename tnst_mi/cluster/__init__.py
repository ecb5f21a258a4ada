"""A run on several processes, on one machine or many, by Dask: `stylize --cluster`.

Read `tasks` first: what the processes do, one task per frame and step of Algorithm 1. `graph` says which task needs
which others, `member` is the process that carries them out, `crew` has Dask do so, `run` is the process that the user
has started. Only names travel: the items are in the folder of the run, which all processes share.
"""

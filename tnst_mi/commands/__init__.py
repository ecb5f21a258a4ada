"""The commands of `tnst-mi`: one dataclass each, its fields the arguments and flags, its `run` the work.

These modules are imported to print --help, so they import torch, and what needs an active variant, only inside
`run`.
"""

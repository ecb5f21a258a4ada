"""The commands of `tnst-mi`: `arguments` defines what each accepts, and a module per command does its work in `run`.

They are separate so that --help and wrong usage are answered at once: `arguments` imports nothing large, while the
modules of the commands import torch and much else.
"""

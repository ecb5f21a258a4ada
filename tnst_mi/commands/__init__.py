"""The commands of `tnst-mi`: what each accepts (`arguments`), and one module each for what it does, in `run`.

They are apart because --help and wrong usage are to be answered at once: `arguments` imports nothing large, while the
modules of the commands import torch and much else.
"""

"""Training a network for one pass: no targets are optimised first, the renderer and the losses are what it learns from.

`footage` is the smoke that it sees, `learning` a step of it, `trainer` all of them.
"""

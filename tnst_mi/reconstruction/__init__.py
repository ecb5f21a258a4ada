"""Smoke from images: the density whose renderings are the pictures that calibrated cameras took.

`reconstruct` is the whole of it. `camera_sets` says where cameras stand and which pictures are theirs, `photographs`
reads these, `image_model` is what a pixel is taken to be, and `descent` changes an extinction until the pictures fit.
"""

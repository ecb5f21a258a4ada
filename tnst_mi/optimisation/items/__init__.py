"""What is known of each frame in an octave, and where it is kept.

Read `state` first: the items that Algorithm 1 reads and writes. `own_step` is what becomes of a frame's step,
`device_store` keeps items on the device, `store` keeps all of them in a folder or in memory. `mending` makes of a state
with a damaged item one from which the run can go on.
"""

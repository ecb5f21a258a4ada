"""tnst-mi from Houdini: the SOP `tnst_mi::stylize` and work items for TOPs.

`node` uses `hou` and only runs inside Houdini; everything else is plain Python (3.9 and newer, standard
library only). torch, Mitsuba and tnst_mi itself are never imported: tnst-mi runs as a process of its own.
"""

"""The optimisation: the paper's Algorithm 1 and its parts.

Read `algorithm` first: the loop and its two steps. What they work on is planned in `plan`, and kept in `state`, whose
items are in a `store`. `gradient` goes from fields to the loss and back, by way of a `parameterisation`; `alignment`,
`window` and `coherence` join the frames in time. `runner` gives turns, resumes and reports; `single_frame` is the way
in for one frame, and `finish` makes a `result` of what has been reached.
"""

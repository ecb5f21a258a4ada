"""The optimisation: the paper's Algorithm 1 and its parts.

Read `algorithm` first: the loop and its two steps. `plan` fixes their settings in advance; `state` holds their data, as
items in a `store`. `gradient` evaluates the loss of the fields and its derivative, through a `parameterisation`;
`alignment`, `window` and `coherence` couple the frames in time. `runner` schedules the frames, resumes and reports;
`single_frame` is the entry point for one frame, and `finish` turns the optimised fields into a `result`.
"""

"""The optimisation: the paper's Algorithm 1 and its parts.

Read `algorithm` first: the loop and its two steps. `plan` fixes their settings in advance; `items` holds their data.
`gradient` evaluates the loss of the fields and its derivative, through a `parameterisation`; `temporal` couples the
frames in time. `runner` schedules the frames, resumes and reports; `single_frame` is the entry point for one frame, and
`finish` turns the optimised fields into a `result`.
"""

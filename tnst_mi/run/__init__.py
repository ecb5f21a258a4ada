"""A whole run: from paths and a recipe to a folder of results.

Read `api` first (`tnst_mi.stylize`), then `prepare`, which checks everything and returns an immutable `Prepared`, and
`job`, which runs it. `inputs` and `measure` examine the frames, `memory` estimates what they need; `folder` defines the
layout of the results, `record` and `flicker` the contents of run.json, `report` and `before_after` the figures.
"""

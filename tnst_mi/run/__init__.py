"""A whole run: from paths and a recipe to a folder of results.

Read `api` first (`tnst_mi.stylize`), then `prepare`, which checks everything and gives an immutable `Prepared`, and
`job`, which runs it. `inputs` and `measure` look at the frames, `memory` at what they need; `folder` says what is
written where, `record` and `flicker` what run.json tells, `report` and `before_after` what is drawn.
"""

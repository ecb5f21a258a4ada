"""Any two renderers, compared by what chance alone may make of them (`tnst-mi compare --left A --right B`).

sides  what can be compared    smoke_scene, mitsuba_scene  scenes that show it    batches  independent estimates
parameters, derivatives  by automatic differentiation and central differences    student, decision  the statistics
measurement  all of it    known_answers  scenes whose answers are known    record, baseline  report.json, and another run's
"""

"""Any two renderers, compared by what chance alone may make of them (`tnst-mi compare --left A --right B`).

sides, variants  what can be compared    smoke_scene, scene_file, pictures, known_answers  what shows it
renderer, parameters  images in independent batches, and their derivatives    batches, student, decision  the statistics
hypotheses, prepared_side, measurement  all of it, as bench_settings say
record, baseline, bench_report  what is written, and what an earlier run wrote
"""

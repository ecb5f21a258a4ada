"""Stages of USD that show smoke: what its files say (`smoke_volume`), and the stage itself (`usd_stage`).

`asset_paths` names the files in it, and `own_stages` tells those that may be replaced.
"""

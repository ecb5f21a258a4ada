"""Stages of USD that show smoke: what its files say (`smoke_volume`), and the stage itself (`usd_stage`)."""

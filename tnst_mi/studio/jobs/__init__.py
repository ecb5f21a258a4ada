"""Tries and renders: `work` is one of them, `workshop` all."""

"""Losses on images of the smoke: the `terms` (Eq. 5 to 7), their weighted sum (`objective`), and the pictures that
provide their targets (`pictures`)."""

"""Losses on images of the smoke: the `terms` (Eq. 5) and that of `style` (Eq. 6 and 7, and others), their weighted sum
(`objective`) and its `evaluation`, the pictures (`pictures`) and maps of features (`feature_maps`) that provide their
targets."""

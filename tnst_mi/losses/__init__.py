"""Losses on images of the smoke: the `terms` (Eq. 5 to 7), their weighted sum (`objective`) and its `evaluation`, the
pictures (`pictures`) and maps of features (`feature_maps`) that provide their targets."""

"""The atlas of a network's layer: what each channel looks for, and what it makes of smoke."""

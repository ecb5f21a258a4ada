"""What `measure_gradient_noise.py` and `measure_noisy_drives.py` share."""

"""With noise, a density is found at least as well as SART finds it at its best, which only the truth tells."""

from __future__ import annotations

from measure_reconstruction import Bench

import tnst_mi


def test_with_noise_it_is_no_worse_than_the_best_of_sart(cloud, tmp_path):
    bench = Bench(tnst_mi.Frame(cloud), tmp_path)
    ours = bench.reconstructed("noisy", 12, 0.01, {"iterations": 100, "levels": 1, "batch": 3})
    sart = bench.sart(12, 0.01)
    assert ours["distance"] <= sart["distance"] < 0.3
    assert ours["psnr"] >= sart["psnr"]

from __future__ import annotations

import subprocess
import sys

import pytest

from tnst_mi.machine.heap import LARGE

#: Frees one block of two, after a larger one, which raises the size from which on others would be given back; prints
#: the MB that are kept of them.
KEPT = """
import numpy as np, psutil
from tnst_mi.machine.heap import give_back_large_blocks
assert {first} or give_back_large_blocks()
np.ones(24 << 20, np.uint8)
before = psutil.Process().memory_info().rss
blocks = [np.ones({size}, np.uint8) for _ in range(64)]
del blocks[::2]
print((psutil.Process().memory_info().rss - before - 32 * {size}) / 1e6)
"""


def kept(as_is: bool) -> float:
    code = KEPT.format(first=as_is, size=2 * LARGE)
    return float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="of GNU's C library")
def test_large_blocks_are_given_back_once_they_are_freed() -> None:
    assert kept(as_is=False) < 5

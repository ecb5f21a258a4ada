"""Preloaded by a Dask worker that is to die at the own step of the third frame."""

from __future__ import annotations

import os
import time
from typing import Any

from tnst_mi.cluster import tasks

_step = tasks._DO[tasks.STEP]


def _deadly(task: tasks.Task, *others: Any) -> None:
    if task.frame == 2:
        time.sleep(0.2)
        os._exit(1)
    _step(task, *others)


tasks._DO[tasks.STEP] = _deadly

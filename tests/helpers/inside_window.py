"""Runs inside a Blender with a window: walks through what artists do, from a timer, and tells what it saw.

    blender --enable-event-simulate SCENE --python inside_window.py -- JSON

The JSON names a walk of window_walks.py and the folder `out`. What it saw is in told.json there; where something did
not come true in time, or an error was raised, "failed" says where. Blender is quit in the end.
"""

from __future__ import annotations

import json
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy

# Blender looks for modules beside its own scripts alone.
sys.path.insert(0, str(Path(__file__).parent))

#: Seconds in which something comes true, and those between two looks at it.
PATIENCE, PACE = 30.0, 0.05

#: What a walk gives: what has to be true before it goes on.
Walk = Iterator[Callable[[], Any]]


class Walker:
    """Goes through a walk.

    Args:
        walk: a generator.
        told: what it tells.
        file: where that is written in the end.
    """

    def __init__(self, walk: Walk, told: dict[str, Any], file: Path) -> None:
        self._walk, self._told, self._file = walk, told, file
        self._until: Callable[[], Any] = lambda: True
        self._asked = time.monotonic()

    def __call__(self) -> float | None:
        """Take a step, if it is time; returns the seconds until the next one, None at the end."""
        try:
            if self._until():
                self._until, self._asked = next(self._walk), time.monotonic()
            elif time.monotonic() - self._asked > PATIENCE:
                self._walk.throw(TimeoutError(f"has not come true within {PATIENCE:g} s"))
            return PACE
        except StopIteration:
            pass
        except Exception:
            self._told["failed"] = traceback.format_exc()
        self._file.write_text(json.dumps(self._told), "utf-8")
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            bpy.ops.wm.quit_blender()
        return None


def main() -> None:
    """Begin the walk that the arguments name, once Blender has drawn its window."""
    import window_walks

    arguments = json.loads(sys.argv[sys.argv.index("--") + 1])
    told: dict[str, Any] = {}
    out = Path(arguments["out"])
    walk = getattr(window_walks, arguments["walk"])(told, out)
    bpy.app.timers.register(Walker(walk, told, out / "told.json"), first_interval=0.5, persistent=True)


main()

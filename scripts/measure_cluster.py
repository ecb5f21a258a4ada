"""What a run on a cluster does on this machine, against a run in one process: bits, kills, hosts, speed and costs.

    python scripts/measure_cluster.py [--only same kills hosts overhead memory locality speed predict] [--json FILE]

Parts, all of which take about half an hour on two cores:

same       results of one process and of one to three workers: are their bits the same?
kills      20 runs in which a worker is killed at a random moment, and 3 in which the scheduler is
hosts      two and three network namespaces as hosts (needs root, iproute2)
overhead   what a task costs beside its own seconds
memory     of the workers and of the coordinator, over 200 frames
locality   bytes that workers read, with and without the hint where the neighbours of a frame are
speed      iterations per second of one process on one core, and of one to three workers with a core each
predict    the speed-up that plan_cluster.py predicts from a run on one worker, against that of two and three

Prints a report (Markdown), part by part; --json writes its numbers. Other work on the machine changes what the last
two say: run them when there is none. Needs the extra `cluster`. Exit codes: 0 all that is asked was found to hold, 1
not all of it, 2 bad input.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from cluster_measures.part import Part

#: By the name of a part, the module and the function that measures it in a folder of its own.
PARTS = {
    "same": ("bits", "same_bits"),
    "kills": ("bits", "kills"),
    "hosts": ("bits", "on_hosts"),
    "overhead": ("costs", "overhead"),
    "memory": ("memory", "memory"),
    "locality": ("costs", "locality"),
    "speed": ("speed", "speed"),
    "predict": ("speed", "predict"),
}


def main() -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART", help="these parts")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers")
    given = parser.parse_args()
    if importlib.util.find_spec("distributed") is None:
        print("measure_cluster: distributed is not installed; pip install 'tnst_mi[cluster]'", file=sys.stderr)
        return 2
    found: dict[str, Part] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in given.only:
            found[name] = measure(name)(Path(folder) / name)
            print(found[name].report(), flush=True)
            if given.json is not None:
                values = {
                    of: {"holds": part.holds, "skipped": part.skipped} | part.values for of, part in found.items()
                }
                given.json.write_text(json.dumps(values, indent=1) + "\n", "utf-8")
    return int(not all(all(part.holds.values()) for part in found.values()))


def measure(name: str) -> Callable[[Path], Part]:
    """The function that measures a part, which needs what --help does not."""
    module, function = PARTS[name]
    return getattr(importlib.import_module(f"cluster_measures.{module}"), function)


if __name__ == "__main__":
    sys.exit(main())

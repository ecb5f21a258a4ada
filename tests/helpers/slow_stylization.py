"""Stands in for `tnst-mi`: the same command lines and progress, but results are copies of the smoke.

    python slow_stylization.py FOLDER --version
    python slow_stylization.py FOLDER stylize SMOKE --recipe FILE --out OUT [--overwrite]
    python slow_stylization.py FOLDER stylize --resume --out OUT

A run goes on until there is a file `end` in the folder, so that tests decide when that is; Ctrl-C stops it, with exit
code 3. Each start is a line of `starts.jsonl` there: the arguments, the process and its parent, the supervisor.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import time
from pathlib import Path

VERSION = (Path(__file__).parents[2] / "integrations" / "blender" / "tnst_mi_blender" / "version.py").read_text("utf-8")

#: Seconds between two lines of progress, and how many of them a run has until it waits to be ended.
PACE, LINES = 0.2, 8


def stylize(folder: Path, given: argparse.Namespace) -> None:
    """Say how far it has got until the end is asked for; results are then written, one after the other."""
    results, state = given.out / "density", given.out / "run.json"
    if given.overwrite:
        shutil.rmtree(given.out, ignore_errors=True)
    source = Path(json.loads(state.read_text("utf-8"))["source"]) if given.resume else given.source
    results.mkdir(parents=True, exist_ok=True)
    state.write_text(json.dumps({"source": str(source), "status": "running"}), "utf-8")
    print("device: none", file=sys.stderr, flush=True)
    done = 0
    while not (folder / "end").exists():
        done = min(done + 1, LINES)
        share = f"{100 * done // (LINES + 1):3}% {done}/{LINES + 1}"
        line = f"smoke_0007 octave 1/1: {share} [00:01<00:03, iteration {done}/{LINES + 1}, loss 1.0]"
        print(line, file=sys.stderr, flush=True)
        time.sleep(PACE)
    (folder / "end").unlink()
    for file in sorted(source.parent.glob(source.name.replace("#", "?"))):
        # Whole or not at all, as of tnst-mi: Blender ends where it shows a file of which a part is there.
        beside = results / f".{file.name}"
        shutil.copyfile(file, beside)
        os.replace(beside, results / file.name)
        time.sleep(PACE)
    state.write_text(json.dumps({"source": str(source), "status": "done"}), "utf-8")


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--version", action="version", version="tnst-mi " + VERSION.split('"')[-2])
    parser.add_argument("command", choices=["stylize"])
    parser.add_argument("source", type=Path, nargs="?")
    parser.add_argument("--recipe", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--overwrite", action="store_true")
    parser.add_argument("--resume", action="store_true")
    given = parser.parse_args()
    start = {"arguments": sys.argv[2:], "processes": [os.getpid(), os.getppid()]}
    with (given.folder / "starts.jsonl").open("a", encoding="utf-8") as starts:
        starts.write(json.dumps(start) + "\n")
    try:
        stylize(given.folder, given)
    except KeyboardInterrupt:
        print("tnst-mi: stopped; go on with --resume", file=sys.stderr)
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(main())

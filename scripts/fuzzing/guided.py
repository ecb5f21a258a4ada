"""Fuzzing one reader with atheris, which keeps the inputs that reach new lines of our modules and damages them further.

    python -m fuzzing.guided READER MINUTES SEED FOLDER

Reads are in this process: a crash or a hang ends it, and atheris leaves the input in the folder. Each other fault is
saved once for each of its kinds and places. Started by `scripts/fuzz.py`.
"""

from __future__ import annotations

import os
import random
import sys
import tempfile
import time
from pathlib import Path

import atheris

# Before anything else imports the package: its modules are made to tell which of their lines are reached.
with atheris.instrument_imports(include=["tnst_mi"]):
    from fuzzing.mutations import mutated
    from fuzzing.readers import READERS
    from fuzzing.trials import MOST_MEMORY, Tally, save, trial
    from fuzzing.workers import HANGS


def main() -> None:
    """Fuzz until the time is over; ends the process with code 1 if there was a fault."""
    name, minutes, seed, out = sys.argv[1], float(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])
    tally, known, end = Tally(), set[tuple[str, ...]](), time.monotonic() + 60 * minutes
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        place, kept = Path(folder) / name, Path(folder) / "corpus"
        place.mkdir()
        kept.mkdir()
        undamaged = READERS[name].corpus(place)
        for number, content in enumerate(undamaged):
            (kept / str(number)).write_bytes(content)

        def read(content: bytes) -> None:
            found = trial(name, content, place)
            tally.add(found)
            mark = (*found.faults, found.where)
            if found.faults and mark not in known:
                known.add(mark)
                save(out / f"{name}-guided-{len(known)}", content, found)
            if time.monotonic() > end:
                print(tally.line(name), flush=True)
                os._exit(int(bool(tally.faults)))  # the library does not return

        def damage(content: bytes, most: int, number: int) -> bytes:
            rng = random.Random(number)
            if rng.random() < 0.5:
                return atheris.Mutate(content, most)
            return mutated(content, undamaged, rng)[:most]

        options = [
            f"-seed={seed + 1}",  # 0 stands for a random one
            f"-timeout={HANGS:.0f}",
            f"-rss_limit_mb={4 * MOST_MEMORY >> 20}",
            f"-max_len={2 * max(map(len, undamaged))}",
            f"-artifact_prefix={out}/{name}-",
            "-verbosity=0",
        ]
        atheris.Setup([sys.argv[0], *options, str(kept)], read, custom_mutator=damage)
        atheris.Fuzz()


if __name__ == "__main__":
    main()

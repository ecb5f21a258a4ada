"""Read damaged files of every format, as the commands read them, and report what a reader must not do.

    python scripts/fuzz.py [--readers npz,vdb,…] [--inputs N | --minutes M] [--seed S] [--out FOLDER]

Small undamaged files of each format are made here and damaged: bits, lengths, pieces and words, also inside of
archives with checksums made right again. Each is read in a process with a limit of memory. Of a damaged file there has
to come one line (`tnst_mi.InputError`) of at most 300 printable characters, within 2 s of processor time and 500 MB
of memory; anything else, such as a crash, another exception or a hang, is a fault. The input of each is saved, as
FOLDER/READER-NUMBER with a .txt beside it that says what happened, and the exit code is 1.

Input N of a seed is always the same. --minutes is the time for each reader; where atheris is installed
(`pip install atheris`), it then keeps the inputs that reach new lines and damages these further. Without either flag,
1000 inputs for each reader.
"""

from __future__ import annotations

import argparse
import importlib.util
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from fuzzing.mutations import mutated
from fuzzing.readers import READERS
from fuzzing.trials import Tally, save
from fuzzing.workers import Worker


def inputs(name: str, seed: int) -> Iterator[bytes]:
    """The damaged files for a reader, without end."""
    with tempfile.TemporaryDirectory() as folder:
        corpus = READERS[name].corpus(Path(folder))
    number = 0
    while True:
        rng = random.Random(f"{seed} {name} {number}")
        yield mutated(rng.choice(corpus), corpus, rng)
        number += 1


def fuzzed(name: str, count: int | None, minutes: float | None, seed: int, out: Path | None, worker: Worker) -> Tally:
    """Try one reader with a number of inputs, or for some minutes."""
    tally, end = Tally(), None if minutes is None else time.monotonic() + 60.0 * minutes
    for number, content in enumerate(inputs(name, seed)):
        if number == count or (end is not None and time.monotonic() > end):
            break
        found = worker.read(name, content)
        tally.add(found)
        if found.faults and out is not None:
            save(out / f"{name}-{number}", content, found)
    return tally


def run_guided(name: str, minutes: float, seed: int, out: Path) -> int:
    """Try one reader with atheris, whose own words go to a log; the exit code, which is not 0 if there is a fault."""
    out.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "fuzzing.guided", name, str(minutes), str(seed), str(out.absolute())]
    with (out / f"{name}.log").open("wb") as log:
        code = subprocess.run(command, cwd=Path(__file__).parent, stderr=log, check=False).returncode
    if code > 1:
        print(f"{name}: a crash, a hang or too much memory; see {log.name} and the input beside it")
    return code


def main() -> int:
    """Try the readers, print one line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--readers", default=",".join(READERS), help="names separated by commas; all of them: %(default)s"
    )
    amount = parser.add_mutually_exclusive_group()
    amount.add_argument("--inputs", type=int, help="number of inputs for each reader")
    amount.add_argument("--minutes", type=float, help="time for each reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("fuzz"), help="folder for inputs with faults")
    arguments = parser.parse_args()
    names = arguments.readers.split(",")
    if unknown := [name for name in names if name not in READERS]:
        parser.error(f"no reader {unknown[0]!r}, expected some of {', '.join(READERS)}")
    guided = arguments.minutes is not None and importlib.util.find_spec("atheris") is not None
    if arguments.minutes is not None and not guided:
        print("atheris is not installed: the inputs are not guided by what they reach", file=sys.stderr)
    if guided:
        codes = [run_guided(name, arguments.minutes, arguments.seed, arguments.out) for name in names]
        return int(any(codes))
    count = 1000 if arguments.inputs is None and arguments.minutes is None else arguments.inputs
    worker, clean = Worker(), True
    for name in names:
        tally = fuzzed(name, count, arguments.minutes, arguments.seed, arguments.out, worker)
        print(tally.line(name), flush=True)
        clean = clean and not tally.faults
    worker.close()
    return 0 if clean else 1


if __name__ == "__main__":
    sys.exit(main())

"""The figures and tables of the paper, each made by one command.

    python scripts/reproduce.py FIGURE… [--size small|paper] [--out FOLDER] [--data FOLDER] [--weights FILE|FOLDER]
    python scripts/reproduce.py all                  # every figure; what is done already is not made again
    python scripts/reproduce.py page --out FOLDER    # docs/figures.md from the figures in FOLDER

Writes FOLDER/NAME.png with its caption, FOLDER/NAME.json with its numbers, and the runs behind it to FOLDER/runs,
resumed where one was interrupted. The exit code is 1 if the numbers of a figure do not bear out its claims. `--size
paper` wants simulations of 200×300×200 cells, which scripts/simulate.py makes, in the folder `--data`.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import tnst_mi  # before torch: it sets how torch's threads wait
from tnst_mi.errors import InputError
from tnst_mi.machine import environment


def main() -> int:
    """Make the figures that the command line names."""
    from figures import MODULES

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "figures", nargs="+", choices=[*MODULES, "all", "page"], metavar="FIGURE", help=", ".join(MODULES)
    )
    parser.add_argument("--size", choices=["small", "paper"], default="small")
    parser.add_argument("--out", type=Path, default=Path("figures"))
    parser.add_argument("--data", type=Path)
    parser.add_argument("--weights")
    options = parser.parse_args()
    if "page" in options.figures and options.figures != ["page"]:
        parser.error("page: expected by itself, once the figures are made")
    if options.size == "paper" and options.data is None:
        parser.error("--size paper: expected --data, a folder of simulations made with scripts/simulate.py")
    names = list(MODULES) if "all" in options.figures else options.figures
    try:
        if options.figures == ["page"]:
            from figures.page import write_page

            write_page(options.out, Path(__file__).resolve().parents[1] / "docs")
            return 0
        missed = [name for name in names if not reproduce(name, options)]
    except InputError as error:
        print(f"reproduce: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("reproduce: interrupted; the same command goes on", file=sys.stderr)
        return 3
    if missed:
        print(f"not borne out: {', '.join(missed)}", file=sys.stderr)
    return 1 if missed else 0


def reproduce(name: str, options: argparse.Namespace) -> bool:
    """Make one figure, and say whether its claims hold."""
    variant = tnst_mi.activate()
    from figures import figure_named
    from figures.figure import draw, write_numbers
    from figures.setting import Setting

    since = time.perf_counter()
    figure, setting = figure_named(name), Setting(options.size, options.out, options.data, options.weights)
    made = figure.make(setting)
    run = {
        "command": f"python scripts/reproduce.py {name}" + (" --size paper" if options.size == "paper" else ""),
        "size": options.size,
        "seconds": time.perf_counter() - since + sum(setting.earlier.values()),
        "device": environment.device(variant),
        "versions": environment.versions(),
    }
    draw(options.out / f"{name}.png", figure.title, made)
    write_numbers(options.out / f"{name}.json", figure, made, run)
    print(f"{options.out / name}.png")
    for claim in made.claims:
        print(f"  {'holds' if claim.holds else 'FAILS'}: {claim.text}")
    return all(claim.holds for claim in made.claims)


if __name__ == "__main__":
    sys.exit(main())

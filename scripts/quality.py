"""How good stylizations are: variants of a recipe compared by measures that no optimisation has seen.

    python scripts/quality.py --loss gram paper --out FOLDER [--resume]
    python scripts/quality.py --variant "gentle: eta = 0.001" "strong: eta = 0.004" --keys "octaves = 3" --out FOLDER

Every variant stylizes every input with every style, once with equal iterations and once in equal time. A network that
took no part judges the results, from views that no iteration saw; docs/quality.md explains the measures. Writes
quality.md, quality.json and sheet.png; what has been made is found again with --resume, whatever ended the command.
"""

from __future__ import annotations

import argparse
import json
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tnst_mi
from tnst_mi import Frame, load_frames
from tnst_mi.errors import InputError
from tnst_mi.fields.bounds import hull, smoke_box
from tnst_mi.io.atomic import written_whole
from tnst_mi.machine import environment
from tnst_mi.recipe.paths import shipped_styles

HERE = Path(__file__).resolve().parents[1]

#: Inputs by name: the folder of their frames below `scenes` or `shared/data`, and the first of two frames.
INPUTS = {"jet": ("smokejet", 61), "suzanne": ("suzanne", 10)}

#: Strokes, a photograph, and drawings: those that ship with the package, and those that may lie beside the checkout.
STYLES = ("starry_night", "fire", "spirals", "net", "flames", "cells")


def smoke_named(given: str, trim: int | None) -> tuple[str, list[Frame]]:
    """An input of `INPUTS`, or a file or folder, of which the first two frames are taken: its name and its frames.

    With `trim`, the grid is cut to the smoke of the frames and so many cells around it.

    Raises:
        InputError: there is none.
    """
    if given in INPUTS:
        folder, first = INPUTS[given]
        numbers = (first, first + 1)
        places = [HERE / "scenes" / folder, HERE.parent / "shared" / "data" / folder]
        found = [[place / f"frame_{number:04d}.npz" for number in numbers] for place in places]
        # Frames that are followed by the next one are preferred: a single one says nothing of flicker.
        files = max(([file for file in some if file.exists()] for some in found), key=len)
        if not files:
            raise InputError(
                f"input {given}: not in {' or '.join(map(str, places))}; give a file or a folder of frames"
            )
        name, frames = given, [load_frames(file)[0] for file in files]
    else:
        name, frames = Path(given).stem, load_frames(given)[:2]
    boxes = [box for frame in frames if (box := smoke_box(frame.density, trim or 0)) is not None]
    if trim is None or not boxes:
        return name, frames
    box = hull(boxes)
    return name, [_cut(frame, box) for frame in frames]


def _cut(frame: Frame, box: tuple[slice, slice, slice]) -> Frame:
    velocity, obstacle = (None if grid is None else grid[box] for grid in (frame.velocity, frame.obstacle))
    return Frame(frame.density[box], velocity, obstacle, name=frame.name, number=frame.number)


def style_named(given: str) -> str:
    """A style as recipes name it: one that ships with the package, one beside the checkout, or a file."""
    beside = sorted((HERE.parent / "shared" / "styles").glob(f"{given}.*"))
    return str(beside[0]) if given not in shipped_styles() and not Path(given).exists() and beside else given


def styles_at_hand() -> list[str]:
    """Those of `STYLES` that are found, with a word on stderr if some are not."""
    styles = [style_named(name) for name in STYLES]
    found = [style for style in styles if style in shipped_styles() or Path(style).exists()]
    if missing := [style for style in styles if style not in found]:
        print(f"quality: without {', '.join(missing)}, which are not here; --styles takes others", file=sys.stderr)
    return found


def keys_of(text: str, where: str) -> dict[str, Any]:
    """Recipe keys of text in TOML: on one line, separated by commas, or each on a line.

    Raises:
        InputError: it is not TOML.
    """
    for toml in (f"keys = {{{text}}}", f"[keys]\n{text}"):
        try:
            return tomllib.loads(toml)["keys"]
        except tomllib.TOMLDecodeError as error:
            reason = error
    raise InputError(f"{where}: {text!r} are no recipe keys in TOML, such as 'eta = 0.004, lam = 1.0' ({reason})")


def variants_of(options: argparse.Namespace) -> list[tuple[str, dict[str, Any]]]:
    """Names and keys of all variants, in the order of the flags."""
    found = [(loss, {"style_loss": loss}) for loss in options.loss]
    for text in options.variant:
        name, separator, keys = text.partition(":")
        if not separator:
            raise InputError(f"--variant {text!r}: expected NAME: KEYS, such as 'gentle: eta = 0.001'")
        found.append((name.strip(), keys_of(keys, f"--variant {name}")))
    if not found:
        raise InputError("nothing to compare; give --loss gram paper, or --variant 'NAME: KEYS'")
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare what the command line names; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loss", nargs="+", default=[], help="style losses to compare, such as gram paper")
    parser.add_argument("--variant", nargs="+", default=[], metavar="NAME: KEYS", help="further variants, keys in TOML")
    parser.add_argument("--keys", default="", help="recipe keys that all variants share, in TOML")
    parser.add_argument("--inputs", nargs="+", default=list(INPUTS), help="jet, suzanne, or files or folders of frames")
    parser.add_argument("--styles", nargs="+", help="pictures, or names of styles (six of those at hand)")
    parser.add_argument("--weights", help="the network that is optimised, as in a recipe; another one judges")
    parser.add_argument("--trim", type=int, metavar="CELLS", help="cut the grids to the smoke and so many cells around")
    parser.add_argument("--resume", action="store_true", help="go on in a folder that holds trials")
    parser.add_argument("--out", type=Path, required=True, help="a folder")
    options = parser.parse_args(arguments)
    try:
        compare(options)
    except InputError as error:
        print(f"quality: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("quality: interrupted; the same command with --resume goes on", file=sys.stderr)
        return 3
    return 0


def compare(options: argparse.Namespace) -> None:
    """Make and measure all trials, and write the results."""
    variant = tnst_mi.activate()
    # Modules with Dr.Jit types at their top need an active variant.
    from quality_measures.compared import Smoke, Variant
    from quality_measures.trials import Comparison, carry_out

    if not options.resume and (options.out / "trials").exists():
        raise InputError(f"{options.out}: holds trials; go on with --resume, or give another folder")
    comparison = Comparison(
        options.out,
        [Smoke(*smoke_named(given, options.trim)) for given in options.inputs],
        styles_at_hand() if options.styles is None else [style_named(given) for given in options.styles],
        [Variant(name, keys) for name, keys in variants_of(options)],
        keys_of(options.keys, "--keys"),
        options.weights,
    )
    carry_out(comparison, lambda line: print(line, file=sys.stderr, flush=True))
    write_results(comparison, options.out, {"device": environment.device(variant), "versions": environment.versions()})


def write_results(comparison: Any, out: Path, machine: dict[str, Any]) -> None:
    """Write quality.md, quality.json and sheet.png of a comparison whose trials are done."""
    from quality_measures import results
    from quality_measures.sheet import write_sheet
    from quality_measures.table import report

    budgets, head = results.records(comparison), results.described(comparison)
    names = [variant.name for variant in comparison.variants]
    record = {
        "described": head,
        "seconds_per_iteration": {smoke.name: comparison.seconds(smoke) for smoke in comparison.smokes},
        "budgets": {equal: list(records.values()) for equal, records in budgets.items()},
        **machine,
    }
    for name, text in (("quality.md", report(budgets, names, head)), ("quality.json", json.dumps(record, indent=1))):
        with written_whole(out / name) as temporary:
            temporary.write_text(text if text.endswith("\n") else text + "\n", "utf-8")
    write_sheet(out / "sheet.png", results.panels(comparison), head)
    print(out / "quality.md")


if __name__ == "__main__":
    sys.exit(main())

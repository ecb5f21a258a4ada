"""How much the parts of a sequence that are stylized by themselves differ from the whole, by the frames of context.

    python scripts/measure_chunks.py INPUT RECIPE [--part A:B] [--context 0 2 4 8]

Stylizes all frames of INPUT by RECIPE, then the frames A to B alone, with so many frames of context on both sides. For
each, the change d* − d of the part is compared with that in the whole run:

    difference    ‖d*_part − d*_whole‖ / ‖d*_whole − d‖, over all frames of the part, and of its first and last frame
    seam          how much more the change jumps from the frame before the part to its first one than it does in the
                  whole run: ‖(c_A − c_{A−1})‖ of part and whole, their ratio; 1 is no seam
    work          frames that are stylized for one that is kept
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import tnst_mi
from tnst_mi.recipe.recipe import Recipe


def changes(source: Path, recipe: Recipe, folder: Path) -> dict[int | float | None, np.ndarray]:
    """The change of each frame of a run, by its number."""
    result = tnst_mi.stylize(source, recipe, folder)
    return {f.number: d - f.density for f, d in zip(result.frames, result.densities, strict=True)}


def norm(fields: list[np.ndarray]) -> float:
    """‖·‖₂ over some fields."""
    return float(np.sqrt(sum(np.square(field, dtype=np.float64).sum() for field in fields)))


def row(part: dict, whole: dict, context: int) -> str:
    """A row of the table, for a part with so many frames of context."""
    numbers = sorted(part)
    first, last = numbers[0], numbers[-1]

    def difference(of: list) -> float:
        return norm([part[n] - whole[n] for n in of]) / norm([whole[n] for n in of])

    before = [n for n in sorted(whole) if n < first]
    seam = (
        norm([part[first] - whole[before[-1]]]) / norm([whole[first] - whole[before[-1]]]) if before else float("nan")
    )
    beside = sum(n not in part and first - context <= n <= last + context for n in whole)
    edges = f"{difference([first]):.0%}, {difference([last]):.0%}"
    return f"| {context} | {difference(numbers):.0%} | {edges} | {seam:.2f} | {1 + beside / len(numbers):.1f} |"


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("input", type=Path)
    parser.add_argument("recipe", type=Path)
    parser.add_argument("--part", required=True, help="numbers of the first and the last frame of the part, A:B")
    parser.add_argument("--context", type=int, nargs="+", default=[0, 2, 4, 8])
    arguments = parser.parse_args()
    recipe = Recipe.from_toml(arguments.recipe)
    with tempfile.TemporaryDirectory() as folder:
        whole = changes(arguments.input, recipe, Path(folder) / "whole")
        print("| context | difference | first and last frame | seam | work |\n|---|---|---|---|---|")
        for context in arguments.context:
            chosen = replace(recipe, frames=arguments.part, context=context)
            part = changes(arguments.input, chosen, Path(folder) / f"part_{context}")
            print(row(part, whole, context), flush=True)


if __name__ == "__main__":
    main()

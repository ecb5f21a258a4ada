"""Write the Houdini asset, whose parameters are those of a recipe: run it when a key of the recipe has changed.

    python scripts/build_houdini_asset.py [--check]

Written are integrations/houdini/otls/tnst_mi_stylize.hda, a folder of text files that Houdini loads as it is, and the
table by which the asset's Python code reads its parameters. --check writes nothing, and ends with code 1 if they differ
from what would be written.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from houdini_asset.files import files
from houdini_asset.interface import table
from tnst_mi_houdini.values import TABLE

from tnst_mi.network.readers import read_weights
from tnst_mi.network.shipped import shipped_weights
from tnst_mi.recipe.parameters import parameters
from tnst_mi.recipe.paths import shipped_lights, shipped_styles

ASSET = Path(__file__).resolve().parents[1] / "integrations" / "houdini" / "otls" / "tnst_mi_stylize.hda"


def main(arguments: list[str] | None = None) -> int:
    """Write the files, or compare them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="compare only")
    check = parser.parse_args(arguments).check
    wanted = generated()
    stale = [path for path, text in wanted.items() if not path.is_file() or path.read_text(encoding="utf-8") != text]
    stale += [path for path in ASSET.rglob("*") if path.is_file() and path not in wanted]
    for path in stale:
        print(f"{'differs' if check else 'written' if path in wanted else 'removed'}  {path}")
        if not check and path in wanted:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(wanted[path], encoding="utf-8")
        elif not check:
            path.unlink()
    return int(check and bool(stale))


def generated() -> dict[Path, str]:
    """The text of each file that is generated."""
    keys = parameters()
    suggestions = {
        "style": shipped_styles(),
        "tag": sorted(name.split(",")[0] for name in read_weights(shipped_weights()).class_names or ()),
        "weights": ["patterns"],
        "light": shipped_lights(),
        "carry": ["all", "none"],
        "reach": ["off", "2%", "5%", "10%"],
        "keep_silhouette": ["off", "1%", "2%", "5%"],
    }
    asset = {ASSET / name: text for name, text in files(keys, suggestions).items()}
    rows = ",\n".join(json.dumps(row, ensure_ascii=False) for row in table(keys))
    return {**asset, TABLE: f"[\n{rows}\n]\n"}


if __name__ == "__main__":
    sys.exit(main())

"""Build the Blender add-on as a zip: for Blender 4.2 and newer as an extension, for 3.4 to 4.1 as an add-on.

    python scripts/build_blender_addon.py [--out FILE.zip] [--without-wheel]
    python scripts/build_blender_addon.py --generate

The zip carries the wheel of this checkout with constraints.txt, for the button that installs tnst-mi; --without-wheel
leaves both out, for those who have an environment. The same checkout gives the same bits: what is in the zip is not
compressed (the wheel is already), so that they do not depend on a version of zlib, except the wheel's.

The tables of the panel come from tnst_mi itself: its keys with their documentation, the names of its motifs. They are
in the checkout too, so that the add-on can be tried without being built, and --generate writes them again. The sheet of
thumbnails, drawn by torch, has other bits with another torch; so it is in the checkout (200 KB), where only --generate
writes it.

Exit codes: 0 done, 1 pip failed, 2 bad input.
"""

from __future__ import annotations

import argparse
import io
import json
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from motifs import FAMILIES, draw
from PIL import Image

from tnst_mi.io.atomic import written_whole
from tnst_mi.recipe.parameters import parameters
from tnst_mi.resources import VERSION

ROOT = Path(__file__).resolve().parents[1]
ADDON = ROOT / "integrations" / "blender" / "tnst_mi_blender"

#: What else is in the zip: modules of this checkout that run in Blender too, and the licence.
SHARED = ("scripts/export_camera.py", "LICENSE")

#: Folder of the wheel and its constraints in the add-on, where `processes/environment.py` looks for them.
CARRIED = "carried"

#: Thumbnails in a row of the sheet, their edge in pixels, and how much larger they are drawn.
COLUMNS, EDGE, FINER = 8, 64, 2

#: Seed of the first thumbnail; that of docs/patterns.md.
SEED = 1 << 40

#: The earliest time that a zip can hold; all of its files have it.
EPOCH = (1980, 1, 1, 0, 0, 0)


def generated() -> dict[str, bytes]:
    """The files of the add-on that are made of tnst_mi, by their names."""
    names = {"columns": COLUMNS, "edge": EDGE, "names": [list(kind.names) for kind in FAMILIES]}
    manifest = (ADDON / "blender_manifest.toml").read_text("utf-8")
    module = (ADDON / "version.py").read_text("utf-8")
    return {
        "recipes/parameters.json": _json(parameters()),
        "interface/motifs.json": _json(names),
        "version.py": re.sub(r'(?m)^VERSION = ".*"$', f'VERSION = "{VERSION}"', module).encode(),
        "blender_manifest.toml": re.sub(r'(?m)^version = ".*"$', f'version = "{VERSION}"', manifest).encode(),
    }


def sheet() -> bytes:
    """A picture of each family of motifs, at its smallest and almost upright: most of it is in view. Grey PNG."""
    picture = Image.new("L", (COLUMNS * EDGE, -(-len(FAMILIES) // COLUMNS) * EDGE))
    for number, kind in enumerate(FAMILIES):
        shown = replace(kind, span=(kind.span[1],) * 2, tilt=min(kind.tilt, 0.3))
        drawn = draw(shown, 1, EDGE * FINER, SEED + number, shaded=False)[0, 0]
        tile = Image.fromarray((drawn * 255.0).round().byte().numpy()).reduce(FINER)
        picture.paste(tile, (number % COLUMNS * EDGE, number // COLUMNS * EDGE))
    written = io.BytesIO()
    picture.save(written, "PNG", optimize=True)
    return written.getvalue()


def contents(wheel: Path | None) -> dict[str, bytes]:
    """All files of the zip by their names, in their order."""
    kept = [file for pattern in ("*.py", "*.json", "*.png", "*.toml") for file in ADDON.rglob(pattern)]
    files = {file.relative_to(ADDON).as_posix(): file.read_bytes() for file in kept} | generated()
    files |= {Path(name).name: (ROOT / name).read_bytes() for name in SHARED}
    if wheel is not None:
        files[f"{CARRIED}/{wheel.name}"] = wheel.read_bytes()
        files[f"{CARRIED}/constraints.txt"] = (ROOT / "constraints.txt").read_bytes()
    return {f"{ADDON.name}/{name}": files[name] for name in sorted(files)}


def write_zip(files: Mapping[str, bytes], out: Path) -> None:
    """Write a zip whose bits depend on these files alone; one that is there is replaced once it is complete."""
    with written_whole(out) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name, EPOCH)
            entry.create_system, entry.external_attr = 3, 0o100644 << 16  # a plain file of Unix, wherever it is made
            archive.writestr(entry, content)


def build_wheel(folder: Path) -> Path:
    """The wheel of this checkout, built by pip.

    Raises:
        subprocess.CalledProcessError: pip failed.
    """
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(ROOT)]
    subprocess.run(command, check=True)
    (wheel,) = folder.glob("tnst_mi-*.whl")
    return wheel


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = ROOT / "dist" / f"{ADDON.name}-{VERSION}.zip"
    parser.add_argument("--out", type=Path, default=default, metavar="FILE.zip", help="(default: in dist/)")
    parser.add_argument("--without-wheel", action="store_true", help="leave out what installs tnst-mi")
    parser.add_argument("--generate", action="store_true", help="write the tables of the checkout again, and no zip")
    given = parser.parse_args(arguments)
    if given.generate:
        for name, content in {**generated(), "interface/motifs.png": sheet()}.items():
            (ADDON / name).write_bytes(content)
        return 0
    if given.out.suffix != ".zip" or given.out.is_dir():
        print(
            f"build_blender_addon.py: --out {given.out}: expected the name of a file that ends in .zip", file=sys.stderr
        )
        return 2
    with tempfile.TemporaryDirectory() as folder:
        try:
            wheel = None if given.without_wheel else build_wheel(Path(folder))
        except subprocess.CalledProcessError:
            print(
                "build_blender_addon.py: pip could not build the wheel; --without-wheel builds the zip without it",
                file=sys.stderr,
            )
            return 1
        write_zip(contents(wheel), given.out)
    print(f"{given.out}: {given.out.stat().st_size / 1e6:.1f} MB, version {VERSION}")
    return 0


def _json(value: object) -> bytes:
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode()


if __name__ == "__main__":
    sys.exit(main())

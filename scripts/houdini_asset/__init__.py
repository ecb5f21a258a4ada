"""The Houdini asset as text: what `scripts/build_houdini_asset.py` is made of.

dialog      the syntax of a DialogScript: parameters, folders, menus
controls    the parameters of a recipe's key
interface   all parameters of the asset, in their folders
files       the files of the asset, expanded as Houdini's `hotl -t` leaves it
"""

import sys
from pathlib import Path

# The asset's own code, which knows how parameters are read.
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "integrations" / "houdini" / "python"))

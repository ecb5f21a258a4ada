"""The modules of the Blender add-on that need no Blender, importable as `tnst_mi_blender.NAME` after this one.

The add-on's own `__init__` imports bpy, which is not here; so its folder is made a package without it.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

ADDON = Path(__file__).resolve().parents[2] / "integrations" / "blender" / "tnst_mi_blender"

package = ModuleType("tnst_mi_blender")
package.__path__ = [str(ADDON)]
sys.modules.setdefault(package.__name__, package)

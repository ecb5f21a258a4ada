"""Errors of tnst-mi in the words of the Blender add-on's panel."""

from __future__ import annotations

from pathlib import Path

import blender_addon
import pytest
from tnst_mi_blender.interface import labels

from tnst_mi.recipe.parameters import parameters


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("tnst-mi: /a b/r.x/recipe.toml: style = '/a/x.png': no such", "tnst-mi: Picture = '/a/x.png': no such"),
        ("tnst-mi: C:\\a\\recipe.toml: camera = 'c': no", "tnst-mi: Camera = 'c': no"),
        ("tnst-mi: /a/02_close.toml: window = 4: expected", "tnst-mi: 02_close: Advanced, window = 4: expected"),
        (
            "tnst-mi: expected --style PICTURE, or colour = 'off'",
            "tnst-mi: expected Picture, or Advanced, colour = 'off'",
        ),
        ("tnst-mi: lower --style-layers", "tnst-mi: lower Advanced, style_layers"),
        ("tnst-mi: no internet, --weights patterns does", "tnst-mi: no internet, --weights patterns does"),
        ("tnst-mi: see --tag help", "tnst-mi: see --tag help"),
        ("tnst-mi: o: go on with --resume, or use --overwrite", "tnst-mi: o: go on with Resume, or use Stylize"),
        ("tnst-mi: f: damaged; --resume makes it anew", "tnst-mi: f: damaged; Resume makes it anew"),
        ("pip: ERROR: no --target\nstyle = 1", "pip: ERROR: no --target\nstyle = 1"),
        ("tnst-mi: free = 3 GB, with --force: no", "tnst-mi: free = 3 GB, with --force: no"),
        ("tnst-mi: /a/smoke.vdb: no such file", "tnst-mi: /a/smoke.vdb: no such file"),
        ("tnst-mi: o: its run was ended before it began; give its INPUT too to begin it", None),
    ],
)
def test_settings_stand_in_place_of_keys(said: str, shown: str | None) -> None:
    assert labels.in_panel_words(said) == (shown or "tnst-mi: o: its run was ended before it began; press Stylize")


def test_labels_are_those_of_the_panel_and_keys_those_of_a_recipe() -> None:
    assert set(labels.LABELS) <= {row["key"] for row in parameters()}
    interface = "".join(file.read_text("utf-8") for file in (blender_addon.ADDON / "interface").glob("*s.py"))
    for key, label in labels.LABELS.items():
        assert f'name="{label}"' in interface, key


def test_remedies_are_those_that_tnst_mi_says() -> None:
    program = Path(blender_addon.ADDON).parents[2] / "tnst_mi"
    names = ("commands/stylize.py", "run/resuming.py", "run/inputs.py")
    says = "".join((program / name).read_text("utf-8") for name in names)
    for remedy in labels.REMEDIES:
        assert remedy in says

"""Many views or one: does the stylization hold from where the cameras did not look? (paper, figures of views)"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from figures.figure import Claim, Figure, Made, Panel, Plot
from figures.seen import images_of, losses_of, smoke_box
from figures.setting import Run, Setting
from tnst_mi.losses.style import Style

#: The strip of one stylization, and the views of the comparison, in degrees of azimuth.
_STRIP, _AROUND = (-30, -15, 0, 15, 30), tuple(range(-90, 91, 15))
_KEYS = {
    "small": {"octaves": 2, "iterations": 12, "gamma": 0.03},
    "paper": {"octaves": 3, "iterations": 20, "gamma": 0.1},
}
_VIEWS = {"small": {"strip": 4, "half a turn": 6}, "paper": {"strip": 9, "half a turn": 9}}


def make(setting: Setting) -> Made:
    """Stylize one frame for a range of 60 degrees, of 180 degrees, and for one view."""
    frame = setting.close_up(setting.smoke("suzanne", 10)[0])
    keys, views = {"style": ["spirals"], **_KEYS[setting.size]}, _VIEWS[setting.size]
    still = {"azimuth": (0.0, 0.0), "elevation": (0.0, 0.0)}
    strip = setting.stylized("views-strip", frame, **keys, azimuth=(-30.0, 30.0), views=views["strip"])
    around = setting.stylized("views-around", frame, **keys, azimuth=(-90.0, 90.0), views=views["half a turn"])
    single = setting.stylized("views-single", frame, **keys, **still, views=1)

    images = {
        "input": _images(single, frame.density, _AROUND),
        "180°": _images(around, around.density, _AROUND),
        "one view": _images(single, single.density, _AROUND),
    }
    style = Style(Path(single.recipe.style[0]), single.recipe.style_layers)
    losses = {name: losses_of(setting, style, seen)[style.name] for name, seen in images.items()}
    # The main view, which both were optimised for, does not count; the others of the 180° are drawn anew each time.
    unseen = [i for i, azimuth in enumerate(_AROUND) if azimuth != 0]
    left = {name: float(values[unseen].mean() / losses["input"][unseen].mean()) for name, values in losses.items()}
    strips = {"input": _images(strip, frame.density, _STRIP), "stylized": _images(strip, strip.density, _STRIP)}
    strip_losses = {name: losses_of(setting, style, seen)[style.name] for name, seen in strips.items()}

    box = smoke_box([*strips["stylized"], *(image for seen in images.values() for image in seen)])
    rows = [_panels(strips["stylized"], _STRIP, "−30° to 30°", box)]
    chosen = [_AROUND.index(azimuth) for azimuth in (-90, -45, 0, 45, 90)]
    for name in ("180°", "one view"):
        rows.append(_panels(images[name][chosen], [_AROUND[i] for i in chosen], name, box))
    curves = {name: (_AROUND, values) for name, values in losses.items()}
    rows[0].append(Plot(curves, "azimuth in degrees", "style distance", "stylized for 180°, and for one view"))
    return Made(
        rows,
        [
            Claim(
                "Stylized for −30° to 30°, each view every 15° is nearer to the style: distances fall by "
                + ", ".join(f"{1 - x:.0%}" for x in strip_losses["stylized"] / strip_losses["input"]),
                bool((strip_losses["stylized"] < strip_losses["input"]).all()),
            ),
            Claim(
                f"Every 15° over 180°, but for the main view, {left['180°']:.0%} of the style distance is left on "
                f"average after stylizing for the 180°, and {left['one view']:.0%} after stylizing for the main view",
                left["180°"] < left["one view"],
            ),
        ],
        {
            "azimuth": list(_AROUND),
            "style_distance": {name: values.tolist() for name, values in losses.items()},
            "distance_left": left,
        },
    )


def _images(run: Run, density: np.ndarray, azimuths: Sequence[int]) -> np.ndarray:
    return images_of(run, density, [(float(azimuth), 0.0) for azimuth in azimuths])


def _panels(images: np.ndarray, azimuths: Sequence[int], name: str, box: tuple[slice, slice]) -> list[Panel | Plot]:
    return [Panel(image[box], f"{name}, seen from {azimuth}°") for image, azimuth in zip(images, azimuths, strict=True)]


FIGURE = Figure(
    "Many views against one",
    "Gradients summed over many views give a stylization that changes smoothly around the smoke; for a single view, it "
    "is flat and only right from there.",
    make,
    "The paper shows smoke in the shape of a bunny; this one has the shape of Blender's monkey.",
)

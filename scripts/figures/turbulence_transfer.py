"""Turbulence transfer: a picture of a finer simulation as the style of a coarse one (paper, Sato et al.'s data)"""

from __future__ import annotations

import dataclasses

import numpy as np

from figures.figure import Claim, Figure, Made, Panel, Plot
from figures.measures import radial_spectrum, spectral_centroid
from figures.seen import JUDGED, images_of, losses_of, smoke_box
from figures.setting import SCENES, Setting
from tnst_mi.fields.resampling import resample_potential
from tnst_mi.frame import Frame
from tnst_mi.losses.style import Style

#: Front view of frame 66 of the jet, simulated with 200×300×200 cells, at γ 0.032 (scripts/make_scenes.py).
PICTURE = SCENES / "paper" / "fine_jet.png"

#: Cells across that the input is resampled to, so that there is room for structures that it lacks; its γ fits PICTURE.
_ACROSS = {"small": 96, "paper": 192}
_KEYS = {
    "small": {"octaves": 2, "iterations": 20, "views": 3, "eta": 0.005, "lam": 0.5},
    "paper": {"octaves": 2, "iterations": 20, "views": 9, "eta": 0.005, "lam": 0.5},
}


def make(setting: Setting) -> Made:
    """Stylize a coarse jet, resampled, by the picture of the fine one, and compare what scales they have."""
    # The bundled jet is the coarse one at either size.
    (frame,) = dataclasses.replace(setting, data=None).smoke("smokejet", 63)
    coarse = frame.density.shape[2]
    across = _ACROSS[setting.size]
    shape = tuple(round(n * across / coarse) for n in frame.density.shape)
    density = np.maximum(resample_potential(frame.density, 1.0, shape, coarse / across), 0)
    run = setting.stylized(
        "turbulence", Frame(density, name=frame.name), style=[str(PICTURE)], gamma=6.4 / across, **_KEYS[setting.size]
    )
    style = Style(PICTURE, run.recipe.style_layers)
    seen = {"input": images_of(run, density, JUDGED), "result": images_of(run, run.density, JUDGED)}
    pictures = {name: views[0] for name, views in seen.items()}
    pictures["finer simulation"] = style.picture.fitted(*shape[1:]).grey

    centroids = {name: spectral_centroid(picture) for name, picture in pictures.items()}
    spectra = {name: radial_spectrum(picture) for name, picture in pictures.items()}
    logs = {name: np.log10(power) for name, (_, power) in spectra.items()}
    far = {name: float(np.abs(logs[name] - logs["finer simulation"]).mean()) for name in ("input", "result")}
    distance = {name: float(losses_of(setting, style, views)[style.name].mean()) for name, views in seen.items()}
    fine = centroids["finer simulation"]
    panels = [
        Panel(picture[smoke_box([picture])], f"{name}\ncentroid {centroids[name]:.4f}")
        for name, picture in pictures.items()
    ]
    return Made(
        [[*panels, Plot(spectra, "cycles per pixel", "share of power", logarithmic=True)]],
        [
            Claim(
                f"The spectral centroid goes from {centroids['input']:.4f} to {centroids['result']:.4f} cycles per "
                f"pixel, towards the finer simulation's {fine:.4f}",
                abs(centroids["result"] - fine) < abs(centroids["input"] - fine),
            ),
            Claim(
                f"The spectra differ by {far['result']:.2f} decades on average, {far['input']:.2f} before",
                far["result"] < far["input"],
            ),
            Claim(
                f"The Gram distance to the finer simulation falls from {distance['input']:.2f} to "
                f"{distance['result']:.2f}",
                distance["result"] < distance["input"],
            ),
        ],
        {
            "spectral_centroid": centroids,
            "decades_between_spectra": far,
            "gram_distance": distance,
            "coarse_cells_across": coarse,
            "cells_across": across,
        },
    )


FIGURE = Figure(
    "Turbulence of a finer simulation",
    "A single rendered frame of a turbulent simulation suffices as the style that gives a coarse one small scales, "
    "where the method of Sato et al. needs the volume itself.",
    make,
    "Data of our own: a jet of 48×72×48 cells, resampled to twice as many, and one of 200×300×200. Neither the "
    "original fields nor results of Sato et al. were at hand to compare with. scenes/paper/fine_jet.png is the picture "
    "used.",
)

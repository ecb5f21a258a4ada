"""Semantic transfer from shallow to deep layers: do structures grow? (paper, figure of semantic transfer)"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from figures.figure import Claim, Figure, Made, Panel
from figures.measures import spectral_centroid
from figures.seen import before_and_after, motif_radius, network, smoke_box
from figures.setting import Setting
from tnst_mi.atlas.excitation import Ascent, excite

#: Layers from shallow to deep, and channels of the BVLC network (`tnst-mi atlas` shows them all).
_CHANNELS = {
    "conv2/3x3": {12: "zigzag", 76: "dots"},
    "inception_3b/3x3_reduce": {35: "net", 2: "squares"},
    "inception_4b/pool_proj": {28: "flower", 53: "cloud", 49: "ribbon"},
}
_KEYS = {
    "small": {"lam": 0.5, "eta": 0.003, "octaves": 2, "iterations": 15, "views": 2},
    "paper": {"octaves": 3, "iterations": 20, "views": 9},
}
#: Number of the frame, and γ, which is smaller for the thicker smoke.
_SMOKE = {"smokejet": (61, 0.1), "suzanne": (10, 0.03)}


def make(setting: Setting) -> Made:
    """Make one channel after the other fire, in a free picture and in two kinds of smoke."""
    pictures = {
        (layer, channel): excite(network(setting.weights), layer, channel, Ascent(iterations=12))
        for layer, channels in _CHANNELS.items()
        for channel in channels
    }
    rows = [[Panel(picture, f"{layer}\nchannel {channel}") for (layer, channel), picture in pictures.items()]]
    found = {"picture": {key: spectral_centroid(picture) for key, picture in pictures.items()}}
    rose, radii = [], {layer: [] for layer in _CHANNELS}
    for smoke, (number, gamma) in _SMOKE.items():
        frame = setting.close_up(setting.smoke(smoke, number)[0])
        found[smoke], seen = {}, []
        for layer, channel in pictures:
            name = f"depth-{smoke}-{layer.replace('/', '-')}-{channel}"
            run = setting.stylized(name, frame, semantic=[f"{layer}:{channel}"], gamma=gamma, **_KEYS[setting.size])
            before, after = before_and_after(run)
            seen.append(after)
            found[smoke][layer, channel] = spectral_centroid(after - before)
            radii[layer].append(motif_radius(setting, layer, [channel], after))
            record = run.record["frames"][0]
            rose.append(sum(record["terms_after"].values()) < sum(record["terms_before"].values()))
        box = smoke_box([before, *seen])
        motifs = [motif for channels in _CHANNELS.values() for motif in channels.values()]
        rows.append([Panel(image[box], motif) for image, motif in zip(seen, motifs, strict=True)])
        rows[-1].append(Panel(before[box], "input"))
    means = {
        "motif radius": {layer: float(np.mean(values)) for layer, values in radii.items()},
        "centroid": _means([centroids for name, centroids in found.items() if name != "picture"]),
    }
    return Made(
        rows,
        [
            Claim(f"{sum(rose)} of {len(rose)} stylizations make their channel fire more", all(rose)),
            Claim(
                "What the channels respond to in the stylized smoke extends farther the deeper they are: its radius is "
                + ", ".join(f"{radius:.1f} px ({layer})" for layer, radius in means["motif radius"].items()),
                all(shallow < deep for shallow, deep in pairwise(means["motif radius"].values())),
            ),
        ],
        {
            "spectral_centroid_cycles_per_pixel": {
                name: {f"{layer}:{channel}": value for (layer, channel), value in centroids.items()}
                for name, centroids in found.items()
            },
            "means": means,
        },
        [
            "The spectral centroid of the change does not show it: structures by it are of "
            f"{_sizes(means['centroid'])}, and of {_sizes(_means([found['picture']]))} in the pictures that excite the "
            "channels without any smoke. It cannot: derivatives of all layers pass through the first ones, and have "
            "about the same spectrum (3.3 to 3.7 px from conv2 to 5a on the jet), which the Laplacian pyramid evens "
            "out. What depth changes is how far the parts of a motif belong together."
        ],
    )


def _means(centroids: list[dict[tuple[str, int], float]]) -> dict[str, float]:
    """Mean centroid of each layer's channels."""
    return {
        layer: float(np.mean([value for one in centroids for key, value in one.items() if key[0] == layer]))
        for layer in _CHANNELS
    }


def _sizes(means: dict[str, float]) -> str:
    return ", ".join(f"{1 / mean:.1f} px ({layer})" for layer, mean in means.items())


FIGURE = Figure(
    "Semantic transfer from shallow to deep layers",
    "Channels of shallow layers give the smoke small, simple patterns; those of deep ones larger, more complex motifs.",
    make,
    "The paper's channel numbers are of inception5h; these are of the BVLC network, chosen for motifs that look alike.",
)

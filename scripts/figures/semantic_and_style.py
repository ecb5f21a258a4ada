"""Semantic and style transfer together: does the result have both? (paper, figure of combinations)"""

from __future__ import annotations

from figures.figure import Claim, Figure, Made, Panel
from figures.seen import JUDGED, images_of, losses_of, smoke_box
from figures.setting import Setting
from tnst_mi.losses.style import Style
from tnst_mi.losses.terms import Semantic

_LAYER, _CHANNEL = "inception_4b/pool_proj", 28
_KEYS = {
    "small": {"lam": 0.5, "eta": 0.003, "octaves": 2, "iterations": 15, "views": 3},
    "paper": {"octaves": 2, "iterations": 20, "views": 9},
}


def make(setting: Setting) -> Made:
    """Stylize one frame by a channel, by a picture, and by both."""
    frame = setting.close_up(setting.smoke("smokejet", 61)[0])
    picture = setting.style("starry_night") or setting.style("spirals")
    goals = {"semantic": {"semantic": [f"{_LAYER}:{_CHANNEL}"]}, "style": {"style": [picture]}}
    goals["both"] = goals["semantic"] | goals["style"]
    runs = {
        name: setting.stylized(f"combined-{name}", frame, **goal, **_KEYS[setting.size]) for name, goal in goals.items()
    }
    style = Style(runs["both"].recipe.style[0], runs["both"].recipe.style_layers)
    semantic = Semantic(_LAYER, (_CHANNEL,))
    seen = {"input": images_of(runs["both"], frame.density, JUDGED)}
    seen |= {name: images_of(run, run.density, JUDGED) for name, run in runs.items()}
    losses = {name: losses_of(setting, semantic + style, images) for name, images in seen.items()}
    activation = {name: -float(values[semantic.name].mean()) for name, values in losses.items()}
    distance = {name: float(values[style.name].mean()) for name, values in losses.items()}
    box = smoke_box([images[0] for images in seen.values()])
    panels = [
        Panel(images[0][box], f"{name}\nactivation {activation[name]:.0f}, distance {distance[name]:.2f}")
        for name, images in seen.items()
    ]
    return Made(
        [[Panel(style.picture.fitted(*seen["input"][0].shape).grey, "style picture"), *panels]],
        [
            Claim(
                f"Together, they raise the activation from {activation['input']:.0f} to {activation['both']:.0f} and "
                f"lower the style distance from {distance['input']:.2f} to {distance['both']:.2f}",
                activation["both"] > activation["input"] and distance["both"] < distance["input"],
            ),
            Claim(
                f"Each alone does more of its own: activation {activation['semantic']:.0f}, "
                f"distance {distance['style']:.2f}",
                activation["semantic"] > activation["both"] and distance["style"] < distance["both"],
            ),
            Claim(
                f"Each alone does less of the other's: activation {activation['style']:.0f}, "
                f"distance {distance['semantic']:.2f}",
                activation["style"] < activation["both"] and distance["semantic"] > distance["both"],
            ),
        ],
        {"activation": activation, "gram_distance": distance},
    )


FIGURE = Figure(
    "Semantic and style transfer combined",
    "Both losses can be minimised at once: motifs of a channel drawn in the manner of a picture.",
    make,
    "Terms are scaled to equal image gradients before they are weighted (here 1:1), since the paper's constants are of "
    "one network and one size.",
)

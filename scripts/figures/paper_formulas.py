"""The paper's own formulas beside ours: what does `preset = "paper"` change? (docs/paper.md)"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from figures.figure import Claim, Figure, Made, Panel
from figures.seen import JUDGED, images_of, losses_of, smoke_box
from figures.setting import Run, Setting
from tnst_mi.frame import Frame
from tnst_mi.losses.style import Style
from tnst_mi.losses.terms import Semantic
from tnst_mi.recipe.paths import STYLES
from tnst_mi.recipe.recipe import Recipe

_LAYER, _CHANNEL, _STYLE = "inception_4b/pool_proj", 63, "spirals"
_SEMANTIC = Semantic(_LAYER, (_CHANNEL,))
_KEYS = {
    "small": {"octaves": 2, "iterations": 15, "views": 3},
    "paper": {"octaves": 2, "iterations": 20, "views": 9},
}
_TOWARDS = {"style": {"style": [_STYLE]}, "channel": {"semantic": [f"{_LAYER}:{_CHANNEL}"]}}

#: What each picture is stylized by: the goals and the formulas.
_KINDS = {
    "style, ours": _TOWARDS["style"],
    "style, paper": _TOWARDS["style"] | {"preset": "paper"},
    "style, paper\nbut σ of the step": _TOWARDS["style"] | {"preset": "paper", "sigma": "step"},
    "channel, ours": _TOWARDS["channel"],
    "channel, paper": _TOWARDS["channel"] | {"preset": "paper"},
    "both, ours": _TOWARDS["style"] | _TOWARDS["channel"],
    "both, paper": _TOWARDS["style"] | _TOWARDS["channel"] | {"preset": "paper"},
}


@dataclass(frozen=True)
class _Seen:
    """Means over the judged views: σ, the relative style distance, Eq. 7, σ times it, and the channel's activation."""

    sigma: float
    distance: float
    equation_7: float
    equation_2: float
    activation: float


def make(setting: Setting) -> Made:
    """Stylize two frames by a picture, a channel, and both, by our defaults and by the paper's preset."""
    smoke = {"suzanne": setting.smoke("suzanne", 10)[0], "jet": setting.close_up(setting.smoke("smokejet", 61)[0])}
    rows, claims, numbers = [], [], {}
    for name, frame in smoke.items():
        runs = {
            kind: setting.stylized(f"preset-{name}-{i}", frame, **keys, **_KEYS[setting.size])
            for i, (kind, keys) in enumerate(_KINDS.items())
        }
        images = _images(frame, runs)
        seen = {kind: _seen(setting, stack) for kind, stack in images.items()}
        box = smoke_box([stack[0] for stack in images.values()])
        panels = [Panel(stack[0][box], f"{name}: {_label(kind, seen[kind])}") for kind, stack in images.items()]
        rows += [panels[:4], panels[4:]]
        claims += _claims(name, seen)
        numbers[name] = {kind.replace("\n", " "): asdict(found) for kind, found in seen.items()}
    return Made(rows, claims, numbers)


def _images(frame: Frame, runs: dict[str, Run]) -> dict[str, np.ndarray]:
    """The frame and its stylizations, each from the judged views."""
    first = next(iter(runs.values()))
    stylized = {kind: images_of(run, run.density, JUDGED) for kind, run in runs.items()}
    return {"input": images_of(first, frame.density, JUDGED)} | stylized


def _seen(setting: Setting, images: np.ndarray) -> _Seen:
    found, layers = {}, Recipe().style_layers
    for distance in ("gram", "paper"):
        style = Style(STYLES / f"{_STYLE}.png", layers, distance)
        found[distance] = losses_of(setting, style, images)[style.name]
    sigma = images.sum((1, 2))
    activation = -losses_of(setting, _SEMANTIC, images)[_SEMANTIC.name]
    means = (sigma, found["gram"], found["paper"], sigma * found["paper"], activation)
    return _Seen(*(float(values.mean()) for values in means))


def _label(kind: str, seen: _Seen) -> str:
    return f"{kind}\ndistance {seen.distance:.2f}, activation {seen.activation:.0f}"


def _claims(name: str, seen: dict[str, _Seen]) -> list[Claim]:
    before, paper, step = (seen[kind] for kind in ("input", "style, paper", "style, paper\nbut σ of the step"))
    ours, channels = seen["style, ours"], (seen["channel, ours"], seen["channel, paper"])
    both = seen["both, ours"], seen["both, paper"]
    fall = paper.equation_2 / before.equation_2 - 1
    return [
        Claim(
            f"{name}: σ times Eq. 7 is lowered by its own measure, {fall:+.0%}, mostly by showing less: σ changes by "
            f"{paper.sigma / before.sigma - 1:+.0%}, Eq. 7 by {paper.equation_7 / before.equation_7 - 1:+.0%}; with σ "
            f"as a factor of the step, σ changes by {step.sigma / before.sigma - 1:+.0%}, Eq. 7 by "
            f"{step.equation_7 / before.equation_7 - 1:+.0%}",
            fall < 0 and step.sigma > paper.sigma,
        ),
        Claim(
            f"{name}: the relative style distance, {before.distance:.2f}, goes to {ours.distance:.2f} by our formulas, "
            f"{step.distance:.2f} by the paper's but for σ, and {paper.distance:.2f} by the paper's",
            ours.distance < min(before.distance, paper.distance),
        ),
        Claim(
            f"{name}: the channel's activation, {before.activation:.0f}, goes to {channels[0].activation:.0f} by ours, "
            f"{channels[1].activation:.0f} by the paper's formulas",
            min(found.activation for found in channels) > before.activation,
        ),
        Claim(
            f"{name}: with both goals at weight 1, the activation goes to {both[0].activation:.0f} by ours and to "
            f"{both[1].activation:.0f} by plain weights, which the style decides alone ({paper.activation:.0f} without "
            "the channel)",
            both[0].activation > both[1].activation,
        ),
    ]


FIGURE = Figure(
    "The paper's formulas beside ours",
    "The loss of a view is α times the semantic and β times the style loss of Eq. 7, times σ, the sum of its pixels "
    "(Eq. 2).",
    make,
    'The keys of `preset = "paper"` against our defaults; docs/paper.md says what each decides. Single frames, so that '
    "windows play no part.",
)

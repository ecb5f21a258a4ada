"""One straight step, sub-steps, and the flow: how much of the smoke is kept, and what style is reached with it?"""

from __future__ import annotations

import itertools
import statistics
import time
from dataclasses import asdict, dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from figures.figure import Claim, Figure, Made, Panel
from figures.measures import mass_change, sharpness
from figures.seen import images_of, smoke_box
from figures.setting import Run, Setting
from tnst_mi import advect
from tnst_mi.frame import Frame

_KEYS = {
    "small": {"octaves": 3, "iterations": 20, "views": 3},
    "paper": {"octaves": 3, "iterations": 20, "views": 9},
}
_CHANNEL = "inception_4b/pool_proj:16"

#: Iterations along the flow that take as long as 20 with one step, on a CPU.
_IN_EQUAL_TIME = 17

_WAYS = {
    "one step": {"transport": "step"},
    "sub-steps": {"transport": "step", "steps": "auto"},
    "flow": {"transport": "flow"},
    "flow, conservative": {"transport": "flow", "conservative": True},
    "flow, equal time": {"transport": "flow", "iterations": _IN_EQUAL_TIME},
}

#: What is compared: ways of transport by λ, and those that are drawn.
_TRIED = {
    1.0: ("one step", "flow", "flow, conservative", "flow, equal time"),
    0.5: ("one step", "flow", "flow, conservative", "flow, equal time"),
    0.0: ("one step", "sub-steps", "flow", "flow, equal time"),
}
_ADVECTED = {
    "one step": {},
    "sub-steps": {"steps": "auto"},
    "flow": {"trace": "flow"},
    "flow, conservative": {"trace": "flow", "conservative": True},
}
_DRAWN = {1.0: ("one step", "flow", "flow, conservative"), 0.0: ("one step", "sub-steps", "flow")}

#: Largest error of the mass along a flow without divergence, and most that the flow's style distance may be of that of
#: the paper's step.
_KEPT, _NEAR = 0.01, 1.05


@dataclass(frozen=True)
class _Measured:
    """What is measured of a run, relative to the frame where that makes sense."""

    before: float
    after: float
    mass: float
    sharpness: float
    largest_displacement: float


def make(setting: Setting) -> Made:
    """Stylize two frames in all ways, towards a picture and a channel, and measure loss, mass, sharpness and time."""
    picture = setting.style("fire") or "flames"
    towards = {"style": {"style": [picture]}, "channel": {"semantic": [_CHANNEL]}}
    rows, numbers, claims = [], {}, []
    for name, number in (("suzanne", 10), ("smokejet", 60)):
        frame = setting.smoke(name, number)[0]
        runs = {
            (goal, lam, way): _run(setting, name, frame, goal, keys, lam, way)
            for goal, keys in towards.items()
            for lam, ways in _TRIED.items()
            for way in ways
        }
        found = {key: _measured(frame, run) for key, run in runs.items()}
        times = _relative_times(frame.density, runs["style", 0.0, "flow"].velocity)
        numbers[name] = {"time of transport": times} | {
            f"{goal}, λ {lam:g}, {way}": asdict(m) for (goal, lam, way), m in found.items()
        }
        rows += _drawn(frame, runs, found, times)
        claims += _claims(name, found)
    return Made(rows, claims, numbers, [] if setting.style("fire") else ["The picture is one that ships."])


def _run(setting: Setting, name: str, frame: Frame, goal: str, keys: dict, lam: float, way: str) -> Run:
    label = f"transport-{name}-{goal}-{lam:g}-{way}".replace(", ", "-").replace(" ", "-")
    return setting.stylized(label, frame, lam=lam, **{**_KEYS[setting.size], **keys, **_WAYS[way]})


def _measured(frame: Frame, run: Run) -> _Measured:
    record = run.record["frames"][0]
    return _Measured(
        sum(record["terms_before"].values()),
        sum(record["terms_after"].values()),
        1 + mass_change(frame.density, run.density),
        sharpness(run.density) / sharpness(frame.density),
        float(np.linalg.norm(run.velocity, axis=-1).max()),
    )


def _relative_times(density: np.ndarray, v: np.ndarray, repeat: int = 5) -> dict[str, float]:
    """Time of transport by a velocity and its derivative in each way, measured in turns, relative to one step."""
    seconds: dict[str, list[float]] = {way: [] for way in _ADVECTED}
    for _, (way, keys) in itertools.product(range(repeat + 1), _ADVECTED.items()):
        given = mi.TensorXf(v)
        dr.enable_grad(given)
        dr.sync_thread()
        since = time.perf_counter()
        dr.backward(dr.sum(dr.square(advect(mi.TensorXf(density), given, **keys).array)))
        dr.eval(dr.grad(given))
        dr.sync_thread()
        seconds[way].append(time.perf_counter() - since)
    medians = {way: statistics.median(found[1:]) for way, found in seconds.items()}
    return {way: found / medians["one step"] for way, found in medians.items()}


def _drawn(frame: Frame, runs: dict, found: dict, times: dict[str, float]) -> list[list[Panel]]:
    """The frame and its stylizations towards the picture, a row for each λ."""
    first = runs["style", 1.0, "one step"]
    before = images_of(first, frame.density)[0]
    drawn = {(lam, way): runs["style", lam, way] for lam, ways in _DRAWN.items() for way in ways}
    images = {key: images_of(run, run.density)[0] for key, run in drawn.items()}
    box = smoke_box([before, *images.values()])
    rows = []
    for lam, ways in _DRAWN.items():
        row = [Panel(before[box], f"input, style distance {found['style', 1.0, 'one step'].before:.2f}")]
        for way in ways:
            m = found["style", lam, way]
            size = f"mass {m.mass:.3f}, sharpness × {m.sharpness:.2f}, time × {times[way]:.1f}"
            row.append(Panel(images[lam, way][box], f"λ = {lam:g}, {way}: {m.after:.2f}\n{size}"))
        rows.append(row)
    return rows


def _claims(name: str, found: dict) -> list[Claim]:
    paper, step, flow = (found["style", lam, way] for lam, way in ((1.0, "one step"), (0.0, "one step"), (0.0, "flow")))
    channel = found["channel", 0.0, "flow"]
    worst = max(abs(flow.mass - 1), abs(channel.mass - 1))
    return [
        Claim(
            f"{name}: without divergence (λ = 0) the flow keeps the mass to {worst:.2%}, where one step loses "
            f"{1 - step.mass:.1%}, and the paper's recipe (one step, λ = 1) {1 - paper.mass:.1%}",
            worst <= _KEPT < abs(step.mass - 1),
        ),
        Claim(
            f"{name}: it comes as near to the style, from {paper.before:.2f} to {flow.after:.2f}, where the paper's "
            f"recipe reaches {paper.after:.2f}: {flow.after / paper.after:.2f} times",
            flow.after <= _NEAR * paper.after,
        ),
    ]


FIGURE = Figure(
    "One step, sub-steps, and the flow",
    "The paper transports by one MacCormack step along a straight line, of up to tens of cells. With velocities that "
    "have no divergence, smoke should neither be made nor lost.",
    make,
    "Not a figure of the paper: its step beside ours, which follows the velocity as a flow (docs/transport.md). The "
    "distance is the style loss of the result from three views; mass and sharpness (the mean difference of "
    "neighbouring cells) are relative to the input; time is that of transport and its derivative, without rendering "
    "and network, for v* of the flow, relative to one step.",
)

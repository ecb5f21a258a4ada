"""The mask: how far from the smoke are changes, and how does blending with the original weaken them? (supplement)"""

from __future__ import annotations

import numpy as np

from figures.figure import Claim, Figure, Made, Panel
from figures.measures import EMPTY, cells_outside
from figures.seen import images_of, smoke_box
from figures.setting import Setting

_KEYS = {
    "small": {"style": ["spirals"], "octaves": 2, "iterations": 15, "views": 3},
    "paper": {"style": ["spirals"], "octaves": 2, "iterations": 20, "views": 9},
}
_STRENGTHS, _BLENDS = (0.0, 1.0, 4.0), (0.25, 0.5)

#: Changes of density below this are not counted.
_CHANGED = 0.01


def make(setting: Setting) -> Made:
    """Stylize one frame with masks of three strengths, and with the paper's, blended with the original."""
    frame = setting.smoke("suzanne", 10)[0]
    keys = _KEYS[setting.size]
    masked = {power: setting.stylized(f"mask-{power:g}", frame, mask_strength=power, **keys) for power in _STRENGTHS}
    blended = {share: setting.stylized(f"mask-blend-{share:g}", frame, blend=share, **keys) for share in _BLENDS}
    distance = cells_outside(frame.density >= EMPTY)
    changes = {power: np.abs(run.density - frame.density) for power, run in masked.items()}
    reach = {power: int(distance[change > _CHANGED].max()) for power, change in changes.items()}
    outside = {power: float(change[distance > 0].sum() / change.sum()) for power, change in changes.items()}
    thin = frame.density < 0.5
    in_thin = {power: float(change[thin].sum() / change.sum()) for power, change in changes.items()}
    kept = {
        share: float(np.linalg.norm(run.density - frame.density) / np.linalg.norm(changes[1.0]))
        for share, run in blended.items()
    }

    images = {power: images_of(run, run.density)[0] for power, run in masked.items()}
    mixtures = {share: images_of(run, run.density)[0] for share, run in blended.items()}
    before = images_of(masked[1.0], frame.density)[0]
    box = smoke_box([before, *images.values()])
    first = [
        Panel(
            images[power][box], f"mask to the power {power:g}\nreaches {reach[power]} cells, {outside[power]:.1%} out"
        )
        for power in _STRENGTHS
    ]
    second = [Panel(image[box], f"blend {share:g}\nchange {kept[share]:.3f}") for share, image in mixtures.items()]
    return Made(
        [
            [Panel(before[box], "input"), *first],
            [Panel(before[box], "blend 0"), *second, Panel(images[1.0][box], "blend 1")],
        ],
        [
            Claim(
                "The stronger the mask, the nearer the changes: of all change, "
                + ", ".join(f"{outside[power]:.1%} (power {power:g})" for power in _STRENGTHS)
                + " lies outside the input's smoke, at most "
                + ", ".join(f"{reach[power]}" for power in _STRENGTHS)
                + " cells from it",
                outside[0.0] > outside[1.0] > outside[4.0] and reach[0.0] >= reach[1.0] >= reach[4.0],
            ),
            Claim(
                "The stronger the mask, the more of the change is in dense smoke: where density was below 1/2 lies "
                + ", ".join(f"{in_thin[power]:.0%} (power {power:g})" for power in _STRENGTHS),
                in_thin[0.0] > in_thin[1.0] > in_thin[4.0],
            ),
            Claim(
                "Blending keeps that share of the change: "
                + ", ".join(f"{kept[share]:.4f} for b = {share:g}" for share in _BLENDS),
                all(abs(kept[share] - share) < 1e-3 for share in _BLENDS),
            ),
        ],
        {
            "largest_distance_of_a_change": reach,
            "share_of_change_outside": outside,
            "share_of_change_in_thin_smoke": in_thin,
            "change_kept_by_blend": kept,
            "change_counted_above": _CHANGED,
        },
    )


FIGURE = Figure(
    "Mask and blending",
    "A soft mask made of the original smoke limits changes to the smoke and its border; a harder one, or blending the "
    "result with the original, tames edges that appear and disappear.",
    make,
    "The paper's supplement, which shows this, was not at hand. Our `mask_strength` is the power of the mask; the "
    "paper's is 1.",
)

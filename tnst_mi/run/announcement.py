"""What a run says before it starts: its device, network and memory, what it took for granted, and what to beware of."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from tnst_mi.fields.density_unit import is_unusual
from tnst_mi.io.interpretation.grid_names import listed
from tnst_mi.losses.pictures import read_image
from tnst_mi.machine import environment
from tnst_mi.machine.terminal import shortened, some_of
from tnst_mi.recipe.presets import PRESETS
from tnst_mi.recipe.quality import FINAL
from tnst_mi.recipe.targets import Target, targets_of
from tnst_mi.recipe.unused import unused_keys
from tnst_mi.rendering.levels import MOTIF_PIXELS, all_levels
from tnst_mi.rendering.looks import gamma
from tnst_mi.run.carry import VELOCITY, chosen
from tnst_mi.run.prepare import Prepared

#: Optical thickness of a cell from which on the inclusive sum shows less than 5% of what the cell emits.
_THICK = 3.0

#: Share of the steps of the frame with the most smoke in view below which a frame is practically left alone.
_FAINT = 1e-3

#: Share of the smoke from which on it is mentioned that images do not show it.
_CUT_OFF = 0.01

#: Motifs, one above the other, for which there should be room.
_ROOM = 2


def announcement(prepared: Prepared) -> Iterator[str]:
    """The lines, in the order of their interest."""
    recipe, model = prepared.recipe, prepared.network.model
    yield f"device: {environment.device_line(prepared.record['device']['variant'])}"
    yield f"network: {model.flavour}, {model.source}"
    yield from prepared.reading
    yield from _of_masks(prepared)
    yield from _of_other_grids(prepared)
    yield prepared.memory
    yield from _of_quality(prepared)
    if prepared.step != 1:
        yield f"note: frames are {prepared.step} apart, so their velocities, in cells per frame, are taken times that"
    for path in dict.fromkeys(path for target in targets_of(recipe) for path in _pictures(target)):
        picture = read_image(path)
        yield from (f"note: {picture.name} {remark}" for remark in picture.remarks)
    for key, reason in unused_keys(recipe, len(prepared.frames)).items():
        yield f"note: {key} has no effect: {reason}"
    preset = PRESETS.get(recipe.preset or "", {})
    if own := [key for key, value in preset.items() if getattr(recipe, key) != value]:
        yield f'note: preset = "{recipe.preset}" leaves {", ".join(own)} as the recipe gives them'
    yield from _of_camera(prepared)
    yield from _of_density(prepared)
    yield from _of_images(prepared)


def _of_quality(prepared: Prepared) -> Iterator[str]:
    """How far the run goes, and from where."""
    recipe, plan, begun = prepared.recipe, prepared.plan, prepared.record.get("from")
    octaves = len(plan.octaves)
    if recipe.quality != FINAL:
        last = (
            f"iteration {plan.iterations(octaves - 1)} of {recipe.iterations} in octave {octaves} of {recipe.octaves}"
        )
        yield f"quality: {recipe.quality}, which ends after {last}"
    if begun is not None:
        done = f"{begun['iterations']} iterations in octave {begun['octave'] + 1}"
        yield f"from: {begun['run']} ({begun['quality']}), after {done}"
    if (model := prepared.record.get("model")) is not None:
        refined = f"refined by {model['refine']} iterations" if model["refine"] else "in one pass"
        yield f"model: {model['file']}, {refined}"


def _pictures(target: Target) -> tuple[str, ...]:
    return (*target.recipe.style, *target.recipe.content)


def _of_masks(prepared: Prepared) -> Iterator[str]:
    """How much of the smoke each mask holds, in frames that have some."""
    for target, record in zip(targets_of(prepared.recipe), prepared.record.get("targets", ()), strict=False):
        shares = zip(prepared.measures, record["smoke_shares"], strict=True)
        with_smoke = [share for measure, share in shares if measure.mass > 0.0]
        if target.mask and with_smoke:
            least, most = _percent(min(with_smoke)), _percent(max(with_smoke))
            span = least if least == most else f"{least} to {most}"
            yield f"{target.name.removesuffix(': mask')}: {span} of the smoke"


def _percent(share: float) -> str:
    """A share in percent, with two digits where it is small."""
    return f"{share:.0%}" if share >= 0.1 else f"{100 * share:.2g}%"


def _of_other_grids(prepared: Prepared) -> Iterator[str]:
    """What moves with the smoke, and what does not."""
    carry, carried = prepared.recipe.carry, prepared.record["carried"]
    movable = dict.fromkeys(name for measure in prepared.measures for name in measure.movable)
    if (colours := prepared.plan.colours) is not None:
        yield f"colours of the smoke: written as grid {shortened(colours.written)}"
        # They are carried where they are made from those of the input.
        carried = [name for name in carried if name != colours.written or colours.names]
    names = listed(carried, in_quotes=False)
    if carried and prepared.recipe.parameterisation == "density":
        yield f"note: densities change in place, so other grids come back as they are: {names}"
    elif carried:
        yield f"carried with the smoke: {names} (--carry all|NAMES|none)"
    if carry == "all" and any(m.moves and VELOCITY not in m.movable for m in prepared.measures):
        yield (
            "note: velocities lie in other files than the densities, and stay there with the grids beside them: "
            "results come back without (tnst-mi convert puts density and velocity into one file)"
        )
    if lost := [name for name in chosen(carry, movable) if name not in carried]:
        yield f"note: {prepared.suffix} files do not hold other grids of such names: {listed(lost, in_quotes=False)}"


def _of_camera(prepared: Prepared) -> Iterator[str]:
    """Where the shot's camera sees the smoke from, and the frames in which it is among the smoke."""
    if not prepared.shots:
        return
    views = [shot.view for shot in prepared.shots]
    spans = [f"azimuth {_span(view[0] for view in views)}°", f"elevation {_span(view[1] for view in views)}°"]
    distances = [view[2] for view in views if len(view) == 3]
    spans += [f"{_span(distances)} cells from the grid's centre"] if distances else ["orthographic"]
    yield f"camera: {prepared.recipe.camera}: {', '.join(spans)}"
    pairs = zip(prepared.measures, prepared.shots, strict=True)
    if inside := [measure.name for measure, shot in pairs if shot.inside]:
        yield (
            f"warning: {some_of(inside)}: the camera is inside the grid; the smoke is seen from where its direction "
            "leaves the grid"
        )


def _span(values: Iterable[float]) -> str:
    low, *_, high = sorted(values) * 2
    return f"{low:.4g}" if f"{low:.4g}" == f"{high:.4g}" else f"{low:.4g} to {high:.4g}"


def _of_density(prepared: Prepared) -> Iterator[str]:
    """The range of the density, its factor, and whether the quadrature can cope with it."""
    recipe, scale = prepared.recipe, prepared.plan.density_scale
    densest, reference = max(measure.densest for measure in prepared.measures), prepared.record["reference_density"]
    auto = f", so that gamma is that of density {reference:.4g}" if recipe.density_scale == "auto" else ""
    if reference > 0:
        yield f"density: up to {densest:.4g}, taken times {scale:.4g} (density_scale){auto}"
    if recipe.gamma == "auto":
        value = gamma(recipe.look, prepared.plan.full.shape)
        yield f"gamma: auto, {value:.3g} per cell, as thick as smoke of density 1 is in the look {recipe.look}"
    thick = reference * scale
    if is_unusual(thick):
        yield (
            f"warning: the density of thick smoke is {thick:.4g} here, where mask and gamma mean that of 1: thin smoke "
            'is hardly changed, and dense smoke hides its inside; density_scale = "auto" makes it 1'
        )
    # Frames that are black altogether are named below.
    seen = zip(prepared.brightness, prepared.plan.frames, strict=True)
    thickness = max((bright.thickest for bright, plan in seen if not plan.still), default=0.0)
    if recipe.integrator == "emission_absorption" and recipe.quadrature == "paper" and thickness > _THICK:
        yield (
            f"warning: gamma times density and size of a cell is up to {thickness:.3g}: the paper's inclusive sum hides"
            ' such cells from the network, quadrature = "exact" does not; or lower gamma'
        )


def _of_images(prepared: Prepared) -> Iterator[str]:
    """Frames and smoke that images do not show, and motifs for which there is no room."""
    frames, recipe = prepared.plan.frames, prepared.recipe
    rows = all_levels(recipe, prepared.plan.shape)[-1].size[0]
    motifs = any(target.recipe.style or target.recipe.semantic or target.recipe.tag for target in targets_of(recipe))
    if motifs and rows < _ROOM * MOTIF_PIXELS:
        yield (
            f"note: the smoke is seen in {rows} rows, and a motif is drawn over some {MOTIF_PIXELS:g}: finer smoke, or "
            "motif_size = 0.25, has room for more than one (docs/motifs.md)"
        )
    for measure, plan in zip(prepared.measures, frames, strict=True):
        if plan.still and measure.mass > 0.0:
            yield f"warning: {measure.name} renders black at this gamma in the main view"
    cut_off = max(bright.cut_off for bright in prepared.brightness)
    if cut_off > _CUT_OFF:
        yield (
            f"warning: up to {cut_off:.0%} of the smoke is outside the images of views from the side; fit = true "
            "(--fit on) makes room for it"
        )
    if faint := [plan.name for plan in frames if 0 < plan.step_scale < _FAINT]:
        names = ", ".join(faint[:3]) + (f" and {len(faint) - 3} others" if len(faint) > 3 else "")
        yield f"warning: {names}: hardly changed, since in view is less than {_FAINT:.1%} of the smoke of another frame"

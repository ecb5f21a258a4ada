"""The keys of a recipe by section, each with its default, the kind of its values, and its documentation."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Annotated, Any, get_type_hints

from tnst_mi.choices import LOOKS, QUADRATURES, QUALITIES, STYLE_LOSSES, STYLE_STATISTICS, TRACES, WINDOW_WEIGHTS
from tnst_mi.io.files.frame_numbers import DIGITS
from tnst_mi.io.interpretation.conventions import VELOCITY_UNITS
from tnst_mi.network.shipped import PATTERNS
from tnst_mi.recipe.colouring import Colouring
from tnst_mi.recipe.keys import Choice, Integer, Kind, LayerWeights, Number, Range, Switch, Text, Texts
from tnst_mi.recipe.lengths import Length
from tnst_mi.recipe.name_lists import Names
from tnst_mi.recipe.optional_keys import Point, Unset
from tnst_mi.recipe.paragraphs import paragraphs_below_fields
from tnst_mi.recipe.region_keys import MaskKind, TargetsKind

#: Number of a frame or a sub-frame.
_NUMBER = rf"-?\d{{1,{DIGITS}}}(\.\d{{1,{DIGITS}}})?"


def _kinds() -> dict[str, Kind]:
    """The kinds of all keys, which are known once the sections are."""
    return KINDS


@dataclass(frozen=True)
class Goals:
    """What to stylize towards."""

    style: Annotated[tuple[str, ...], Texts("IMAGE", 'a list of picture files, such as ["fire.png"]')] = ()
    """Picture whose style the smoke takes on: a file (relative to the recipe), or the name of a picture
    that ships with the package (spirals, net, flames, cells). Repeatable."""
    style_layers: Annotated[dict[str, float], LayerWeights()] = field(
        default_factory=lambda: {"conv2/3x3": 1.0, "inception_3b/output": 1.0, "inception_4b/output": 1.0}
    )
    """Layers whose statistics are matched to the style pictures, with weights. Low layers give fine
    strokes, high layers large shapes."""
    style_loss: Annotated[str, Choice(STYLE_LOSSES)] = "gram"
    """What is compared with the style pictures (docs/losses.md): gram, the Gram matrices, relative to the picture's, so
    that layers of equal weight count equally; paper, the same divided by 4C²A² (Eq. 7; C channels, A positions), so
    that one layer outweighs the others; swd, the whole distribution of features (sliced Wasserstein distance); nnfm,
    each position with the one of the picture that resembles it most; histogram, gram and the histograms of channels."""
    style_statistics: Annotated[str, Choice(STYLE_STATISTICS)] = "image"
    """Which positions of an image count for the style: image, all of them, the empty background too; smoke, each by the
    opacity of the smoke there."""
    all_octaves: Annotated[bool, Switch()] = False
    """Compare images with the style in the sizes of coarser octaves too, not only in their own (docs/losses.md)."""
    semantic: Annotated[
        tuple[str, ...],
        Texts(
            "LAYER:CHANNEL[,CHANNEL…]",
            'a list of layers with channels, such as ["inception_4b/pool_proj:16"]',
            r"[^:]+:\d{1,6}(,\d{1,6})*",
        ),
    ] = ()
    """Channels of a layer to activate: the smoke takes on the motif that they recognise. Channel numbers are specific
    to one network. Repeatable."""
    tag: Annotated[tuple[str, ...], Texts("NAME", 'a list of class names, such as ["spiral"]')] = ()
    """Name of a class that the network should recognise in the smoke (tnst-mi weights --tags lists the classes of
    patterns, the network that ships with the package). Repeatable."""
    content: Annotated[tuple[str, ...], Texts("IMAGE", 'a list of picture files, such as ["face.png"]')] = ()
    """Picture whose features the smoke should match. Repeatable."""
    content_layers: Annotated[dict[str, float], LayerWeights()] = field(
        default_factory=lambda: {"inception_4d/output": 1.0}
    )
    """Layers whose features are matched to the content pictures, with weights; deep ones hold shapes rather than
    strokes."""
    match: Annotated[
        tuple[str, ...],
        Texts("LAYER:FILE.npz", 'a list of layers with files, such as ["inception_4b/output:map.npz"]', r"[^:]+:.+"),
    ] = ()
    """Map of features that a layer should match (Eq. 5): an array (C, H, W), or (C, 1, 1), in an npz file (relative to
    the recipe), named map or the only one; resampled to the layer in each octave. Repeatable."""
    style_weight: Annotated[float, Number(low=0.0)] = 1.0
    """Weight of the style terms, 0 or more."""
    semantic_weight: Annotated[float, Number(low=0.0)] = 1.0
    """Weight of the semantic, tag, content and match terms, 0 or more."""
    damping: Annotated[float, Number(low=0.0)] = 0.0
    """Weight of an L1 penalty on the other channels of a semantic layer, 0 or more."""
    mask: Annotated[Any, MaskKind()] = None
    """Where the smoke changes, from 0 (not at all) to 1: a grid of the input by its name, a file of the same grid for
    all frames or for each, or a table such as {height = [0.5, 2.0]} (as a flag, in quotes): a sphere or box in the
    scene, a ramp over the height, a picture painted over a view, a grid with a range of its values, with keyframes
    (docs/regions.md); in a recipe file also a list of these, whose product it is. If not set, everywhere."""
    target: Annotated[tuple[dict[str, Any], ...], TargetsKind(_kinds)] = ()
    """Several goals in regions of their own, in a recipe file: tables [[target]] with one of style, semantic, tag,
    content or match each, and with mask and weight (docs/regions.md)."""


@dataclass(frozen=True)
class Method:
    """How to get there."""

    preset: Annotated[str | None, Unset(Choice(("paper",)))] = None
    """Other defaults: paper takes the formulas of the paper where ours differ (docs/paper.md). Keys that are given, in
    the recipe or as flags, stay as they are given."""
    quality: Annotated[str, Choice(QUALITIES)] = "final"
    """How much of the work is done, for how good a picture: final is all of it; draft ends before the finest octave,
    and preview after three fifths of it. Both show where the motifs of the final will be, and --from goes on from them
    (docs/preview.md)."""
    lam: Annotated[float, Number(0.0, 1.0)] = 0.0
    """λ in v = λ∇Φ + (1−λ)∇×Ψ, from 0 to 1: 0 is divergence-free, so that smoke is kept, 1 lets it expand and
    contract."""
    gamma: Annotated[float | str, Number(above=0.0, high=1e4, words=("auto",))] = 0.1
    """Extinction γ for density 1 (see density_scale), above 0: the higher, the thicker the smoke looks. Per pixel of
    the images that the network sees, which is a full-resolution cell unless motif_size makes it another length. Lower
    it to stylize all through thin smoke, raise it for the surface of thick smoke; auto makes the smoke as thick as the
    final renderer will, see look."""
    look: Annotated[float | str, Number(above=0.0, high=1e6, words=LOOKS)] = "medium"
    """For gamma = auto: how thick the final renderer shows the smoke (docs/looks.md), as a look of render --look, or as
    the optical depth of smoke of density 1 along the longest edge of the grid."""
    density_scale: Annotated[float | str, Number(above=0.0, words=("auto",))] = "auto"
    """Factor by which all densities are multiplied before γ, mask and steps see them; results come back in the input's
    units. auto is 1 over the 99th percentile of the smoky cells of all frames; 1 takes the input as it is."""
    quadrature: Annotated[str, Choice(QUADRATURES)] = "paper"
    """Quadrature along the viewing rays: as in the paper's program, the exact integral, opacity alone, or the
    integrated transmittance, where smoke is dark and empty space bright."""
    octaves: Annotated[int, Integer(1, 16)] = 3
    """Number of resolutions, coarse to fine, 1 or more."""
    motif_size: Annotated[float | str, Number(0.01, 2.0, words=("auto", "cells"))] = "auto"
    """Size of motifs in parts of the grid's height, such as 0.25: the images that the network sees then have
    24/motif_size rows, whatever the grid, and gamma is per pixel of them. cells, as in the paper, makes a pixel a cell,
    so that motifs have 24 cells: a quarter of the height on 96 rows, half of that on 192. auto is 0.25 on grids of
    more than 96 rows, and cells on others, which have no detail for finer images. Raise it for bigger motifs."""
    scale_factor: Annotated[float, Number(above=1.0, high=8.0)] = 1.8
    """Ratio of the resolutions of neighbouring octaves, above 1."""
    iterations: Annotated[int, Integer(1, 100_000)] = 20
    """Iterations in each octave, 1 or more: more for a stronger style."""
    views: Annotated[int, Integer(1, 10_000)] = 9
    """Viewpoints per iteration, redrawn each time; the first is the main view. More for a camera that moves."""
    camera: Annotated[str | None, Text("FILE[#NAME]", "a file of cameras, and the name of one in it after #")] = None
    """Camera of the shot, still or moving (docs/cameras.md): TOML, JSON, or USD with the name of one of several. The
    main view of a frame is then from where it stands, and azimuth and elevation are offsets around that."""
    azimuth: Annotated[tuple[float, float], Range(-360.0, 360.0)] = (-10.0, 10.0)
    """Range of camera azimuths in degrees, + to the right; the main view is its centre. With a camera, offsets from
    it."""
    elevation: Annotated[tuple[float, float], Range(-90.0, 90.0)] = (-5.0, 5.0)
    """Range of camera elevations in degrees, + upwards; the main view is its centre. With a camera, offsets from it."""
    fit: Annotated[bool, Switch()] = False
    """Size of the images: off is the paper's, the columns and rows of the grid, beyond which views from the side are
    cut off; on has room for all of the grid in every view."""
    loss_scaling: Annotated[str, Choice(("gradient", "none"))] = "gradient"
    """Scale of a loss term before it is weighted: gradient divides it, in each octave, by the RMS of its first image
    gradient, so that terms of equal weight count equally; none leaves the weights plain factors (Eq. 1)."""
    sigma: Annotated[str, Choice(("step", "loss"))] = "step"
    """What the sum of the pixels of an image, the σ of Eq. 2, is a factor of: step scales η by that of the frame's
    main view, relative to the brightest frame; loss multiplies each view's loss, and is differentiated with it, which
    lowers a style loss by dimming the smoke."""
    eta: Annotated[float, Number(above=0.0, high=100.0)] = 0.002
    """Step size η, above 0: an iteration changes the potentials by η·h·H/2, for a grid of H rows and octave
    cells of size h, where the normalised gradient is 1. Raise it for a stronger style, up to where smoke is drawn out
    into threads."""
    pyramid_levels: Annotated[int, Integer(0, 16)] = 3
    """Bands of the Laplacian pyramid that normalises the gradient, 0 or more."""
    mask_strength: Annotated[float, Number(low=0.0, high=100.0)] = 1.0
    """Exponent of the mask that confines changes to the smoke, from 0 (changes everywhere except in obstacles) to 100;
    1 is the paper's, higher values confine changes to the dense interior and leave thin smoke alone."""
    window: Annotated[int, Integer(1, 99, odd=True)] = 1
    """Number of frames over which the stylization is kept coherent in time, odd; 1 turns this off. Raise it for a
    steadier sequence, such as to 9. Needs the frames' velocities."""
    window_weights: Annotated[str, Choice(WINDOW_WEIGHTS)] = "uniform"
    """Weights of the frames in a window: equal, or decreasing with distance in time."""
    window_average: Annotated[str, Choice(("smoke", "plain"))] = "smoke"
    """Average over a window: smoke counts a frame only where it has smoke; plain is the weighted sum of Eq. 9, which
    is smaller where smoke appears or leaves."""
    step_order: Annotated[str, Choice(("normalise_first", "align_first"))] = "normalise_first"
    """With a window, what is aligned and averaged: normalise_first takes the normalised, masked step of each frame;
    align_first the gradients, whose average is then normalised and masked (Algorithm 1). The latter needs
    window_average plain."""
    coherence: Annotated[float, Number(low=0.0)] = 0.0
    """With a window, size of the step that makes the change of the smoke move with the smoke, relative to the
    stylization's own step, 0 or more; 0, as in the paper, is none. Raise it for a steadier sequence, such as to 2.5."""
    steps: Annotated[int | str, Integer(1, 1000, word="auto")] = 1
    """With transport step, sub-steps of it: 1 is the paper's; auto takes one per cell of the longest displacement."""
    transport: Annotated[str, Choice(TRACES)] = "flow"
    """How smoke follows the velocity: flow follows it for one frame, and a velocity without divergence (lam 0) keeps
    the mass; step, as in the paper, looks back along a straight line, which loses smoke where the velocity turns. If
    not given, flow; but step with lam above 0 or sub-steps, unless it is conservative or has a number of stages."""
    stages: Annotated[int | str, Integer(1, 64, word="auto")] = "auto"
    """With transport flow, stages in which each path is traced, from 1 to 64; auto takes one for every three cells per
    frame of the largest velocity that a path meets, up to 32."""
    conservative: Annotated[bool, Switch()] = False
    """With transport flow, on makes smoke denser where it contracts and thinner where it expands (lam above 0), so
    that its mass is kept as far as the grid resolves this; off keeps the densities, as in the paper."""
    parameterisation: Annotated[str, Choice(("transport", "density"))] = "transport"
    """Optimise velocities that transport the smoke, or change density values in place."""
    integrator: Annotated[str, Choice(("emission_absorption", "prbvolpath"))] = "emission_absorption"
    """Renderer inside the optimisation: light emitted and absorbed by the smoke, or Mitsuba's scattering path tracer,
    to which albedo, anisotropy, light and spp apply."""
    albedo: Annotated[float, Number(0.0, 1.0)] = 0.9
    """prbvolpath: fraction of the extinguished light that is scattered, from 0 to 1."""
    anisotropy: Annotated[float, Number(-0.99, 0.99)] = 0.0
    """prbvolpath: mean cosine g of the Henyey-Greenstein phase function, from -0.99 (backward) to 0.99 (forward); 0 is
    isotropic."""
    light: Annotated[str, Text("FILE|key|environment", "a Mitsuba scene file, key or environment")] = "key"
    """prbvolpath: the light on the smoke: the emitters of a Mitsuba scene file, key (from the upper left, and some from
    all around) or environment (equally from all around)."""
    spp: Annotated[int, Integer(1, 4096)] = 16
    """prbvolpath: paths per pixel in each pass of an iteration, 1 or more."""
    reach: Annotated[str | float, Length()] = "off"
    """How far smoke may be moved at most: a share of the grid's height, such as 5%, a number of cells, or off. It holds
    exactly, in every cell and over all octaves together. For a gentler stylization."""
    keep_silhouette: Annotated[str | float, Length()] = "off"
    """How far the outline of the smoke in the main view may move: a share of the grid's height, such as 1%, a number of
    cells, or off. For a change inside an outline that is kept."""
    strength: Annotated[float, Number(0.0, 1.0)] = 1.0
    """Strength s of the stylization, from 0 (the input, bit for bit) to 1: the velocity of the result is s times the
    one that was found, so that smoke moves s times as far."""
    blend: Annotated[float, Number(0.0, 1.0)] = 1.0
    """Share b of the stylized density in the result d + b·(d* − d), from 0 to 1."""
    seed: Annotated[int, Integer(0, 2**32 - 1)] = 0
    """Seed of the random views, together with the number of the frame; equal seeds give bit-identical results."""


@dataclass(frozen=True)
class Resources:
    """What to read, compute with and write."""

    frames: Annotated[
        str | None,
        Text("FIRST:LAST", 'a range of frame numbers, such as "70:89"', rf"{_NUMBER}(:{_NUMBER})?"),
    ] = None
    """Numbers of the first and the last frame of a sequence to take, or of one; with decimal points, such as 1.0:2.5,
    sub-frames are taken too. All whole frames if not set."""
    context: Annotated[int, Integer(0, 1000)] = 0
    """How many frame numbers before and after those of frames are stylized too, but not written: what others stylize as
    neighbours of these, so that the parts of a sequence fit together (docs/cluster.md)."""
    weights: Annotated[
        str | None, Text(f"FILE|FOLDER|{PATTERNS}", f"a file or folder with GoogLeNet weights, or {PATTERNS}")
    ] = None
    """GoogLeNet weights: a file, a folder, or patterns, the network that ships with the package. If not set, they are
    searched for (tnst-mi weights lists the places)."""
    variant: Annotated[str | None, Unset(Choice(("cuda_ad_rgb", "llvm_ad_rgb")))] = None
    """Mitsuba variant: GPU or CPU. If not set, the GPU if one is available."""
    threads: Annotated[int | None, Unset(Integer(1, 1024))] = None
    """CPU threads of the network, which decide the last bits of what it computes: one per core if not set. A run that
    is resumed keeps those with which it began."""
    format: Annotated[str | None, Unset(Choice(("npz", "vol", "uni", "vdb")))] = None
    """File format of the results; the input's format if not set."""
    carry: Annotated[str, Names()] = "all"
    """Grids of the input that move with the smoke and come back with it: all, such as temperature, flame and velocity;
    those with the given names, separated by commas; or none. Vectors keep their directions, obstacles their places."""
    keep_octaves: Annotated[bool, Switch()] = False
    """Keep the states of all frames at the end of each octave too, from which --from RUN/octaves/1 goes on."""
    fps: Annotated[float | None, Unset(Number(above=0.0, high=240.0))] = None
    """Frames per second of a sequence, above 0: of its preview video (24 if not set), and of velocities per time, of
    which a frame lasts 1 / fps seconds, or 2.5 / fps of Mantaflow's units of time."""


@dataclass(frozen=True)
class Reading:
    """How to read the input's files; the default is what they declare or their format implies."""

    density: Annotated[str | None, Text("NAME", "the name of a grid", r"(?s:.*)")] = None
    """Name of the grid or array that is the density; NAME[1] is the second of that name."""
    velocity: Annotated[str | None, Text("NAME", "the name of a grid", r"(?s:.*)")] = None
    """Name of the grid of velocities, or what the names of its three components have in common, or these names
    separated by commas; none reads no velocity."""
    obstacle: Annotated[str | None, Text("NAME", "the name of a grid", r"(?s:.*)")] = None
    """Name of the grid of solid cells; none reads no obstacle."""
    up: Annotated[str | None, Unset(Choice(("y", "z")))] = None
    """Up axis of the files. If not set, z for .uni and the .vdb of programs that say so in their metadata (Blender,
    EmberGen), else y."""
    flip: Annotated[str | None, Text("AXES", "axes out of x, y and z, such as xz", "[xyz,]+")] = None
    """Axes to mirror, such as x or xz, once y is up."""
    units: Annotated[str | None, Unset(Choice(VELOCITY_UNITS))] = None
    """Unit of the velocities: cells per frame, or cells or scene units of length per unit of time. If not set,
    cells-per-time for .uni and Blender's .vdb, length-per-time for other .vdb, else cells-per-frame."""
    dt: Annotated[float | None, Unset(Number(above=0.0, high=1e9))] = None
    """Duration of a frame in that unit of time. If not set, it follows from fps, or is 0.1 for cells-per-time and 1/24
    for length-per-time."""
    scale: Annotated[float | None, Unset(Number(above=0.0, high=1e30))] = None
    """Factor of the densities as they are stored. If not set, 1, but 1/255 for arrays of unsigned bytes (uint8) and
    1/65535 for those of two (uint16), as in pictures; other whole numbers are taken as they are."""
    voxel_size: Annotated[float | None, Unset(Number(above=0.0, high=1e9))] = None
    """Edge of a cell in the scene's unit of length, with which .vdb files are written too. If not set, the file's."""
    origin: Annotated[tuple[float, float, float] | None, Unset(Point())] = None
    """Place in the scene of the origin of the files' coordinates, which is added to where their grids lie: Blender's
    caches lie at the scene's origin, wherever their domain is."""
    fog: Annotated[bool, Switch(bare=True)] = False
    """Take the inside of a level set as its density: from 0 at the surface to 1 where the narrow band ends."""
    crop: Annotated[bool, Switch()] = True
    """Crop the grid of .vdb files to the smoke of all frames and what the stylization reaches around it, or move it
    with the smoke, where that at least halves the number of cells; off takes the whole grid."""
    ignore_stray: Annotated[bool, Switch(bare=True)] = False
    """Leave out voxels of .vdb files that are far from the smoke and together have less than a thousandth of it."""
    skip_bad: Annotated[bool, Switch(bare=True)] = False
    """Leave out the frames of a sequence that cannot be read, rather than stop before the work begins."""


#: The parts of a recipe, in the order of its file.
SECTIONS = (Goals, Method, Colouring, Resources, Reading)

#: The kind of value that each key of a recipe holds, in the order of the file.
KINDS: dict[str, Kind] = {
    name: hint.__metadata__[0]
    for section in SECTIONS
    for name, hint in get_type_hints(section, include_extras=True).items()
}


@functools.cache
def documentation() -> dict[str, str]:
    """The documentation of each key, one paragraph: the text below its field in this file."""
    return {name: text for section in SECTIONS for name, text in paragraphs_below_fields(section).items()}

"""The recipe of a stylization: one flat, documented set of keys for TOML files and the command line.

Every field of `Recipe` is a TOML key and, with dashes for underscores, a flag of `tnst-mi stylize`. Values
are taken from the defaults, then from the recipe file, then from the flags; the last one given wins.
"""

from __future__ import annotations

import ast
import dataclasses
import difflib
import functools
import inspect
import itertools
import re
import reprlib
import textwrap
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import tomlkit

from tnst_mi.errors import InputError
from tnst_mi.quadrature import QUADRATURES
from tnst_mi.recipe_keys import Choice, Integer, Kind, LayerWeights, Number, Range, Text, Texts
from tnst_mi.shipped import PATTERNS

#: Style pictures that ship with the package; a recipe names them without folder and extension.
STYLES = Path(__file__).parent / "data" / "styles"

#: Mitsuba scenes whose emitters light the smoke, likewise.
LIGHTS = Path(__file__).parent / "data" / "lights"

_LARGEST_FILE = 1 << 20


@dataclass(frozen=True)
class Goals:
    """What to stylize towards."""

    style: Annotated[tuple[str, ...], Texts("IMAGE", 'a list of picture files, such as ["fire.png"]')] = ()
    """Picture whose style the smoke takes on: a file (relative to the recipe), or the name of a picture
    that ships with the package (spirals, net, flames, cells). Repeatable."""
    style_layers: Annotated[dict[str, float], LayerWeights()] = field(
        default_factory=lambda: {"conv2/3x3": 1.0, "inception_3b/output": 1.0, "inception_4b/output": 1.0}
    )
    """Layers whose Gram matrices are matched to the style pictures, with weights. Low layers give fine
    strokes, high layers large shapes."""
    semantic: Annotated[
        tuple[str, ...],
        Texts(
            "LAYER:CHANNEL[,CHANNEL…]",
            'a list of layers with channels, such as ["inception_4b/pool_proj:16"]',
            r"[^:]+:\d{1,6}(,\d{1,6})*",
        ),
    ] = ()
    """Channels of a layer to make fire: the smoke takes on the motif that they recognise. Their numbers
    hold for one network alone. Repeatable."""
    tag: Annotated[tuple[str, ...], Texts("NAME", 'a list of class names, such as ["spiral"]')] = ()
    """Class that the network shall see in the smoke, by its name (tnst-mi weights --tags lists those of the
    network patterns, which ships with the package). Repeatable."""
    content: Annotated[tuple[str, ...], Texts("IMAGE", 'a list of picture files, such as ["face.png"]')] = ()
    """Picture whose features (of inception_4d/output) the smoke shall match. Repeatable."""
    style_weight: Annotated[float, Number(low=0.0)] = 1.0
    """Weight of the style terms, 0 or more."""
    semantic_weight: Annotated[float, Number(low=0.0)] = 1.0
    """Weight of the semantic, tag and content terms, 0 or more."""
    damping: Annotated[float, Number(low=0.0)] = 0.0
    """Weight of an L1 penalty on the other channels of a semantic layer, 0 or more."""


@dataclass(frozen=True)
class Method:
    """How to get there."""

    lam: Annotated[float, Number(0.0, 1.0)] = 1.0
    """λ in v = λ∇Φ + (1−λ)∇×Ψ, from 0 to 1: 1 moves smoke apart and together, 0 is free of
    divergence."""
    gamma: Annotated[float, Number(above=0.0, high=1e4)] = 0.1
    """Extinction γ for density 1, per full-resolution cell, above 0: the higher, the thicker the smoke
    looks."""
    quadrature: Annotated[str, Choice(QUADRATURES)] = "paper"
    """Sum along the viewing rays: the paper's program, the exact integral, or opacity alone."""
    octaves: Annotated[int, Integer(1, 16)] = 3
    """Number of resolutions, coarse to fine, 1 or more."""
    scale_factor: Annotated[float, Number(above=1.0, high=8.0)] = 1.8
    """Ratio of the resolutions of neighbouring octaves, above 1."""
    iterations: Annotated[int, Integer(1, 100_000)] = 20
    """Iterations in each octave, 1 or more."""
    views: Annotated[int, Integer(1, 10_000)] = 9
    """Viewpoints per iteration, redrawn each time; the first is the main view."""
    azimuth: Annotated[tuple[float, float], Range(-360.0, 360.0)] = (-10.0, 10.0)
    """Range of camera azimuths in degrees, + to the right; the main view is its centre."""
    elevation: Annotated[tuple[float, float], Range(-90.0, 90.0)] = (-5.0, 5.0)
    """Range of camera elevations in degrees, + upwards; the main view is its centre."""
    eta: Annotated[float, Number(above=0.0, high=100.0)] = 0.002
    """Step size η, above 0: an iteration changes the potentials by η·h·H/2, for a grid of H rows and octave
    cells of size h, where the normalised gradient is 1."""
    pyramid_levels: Annotated[int, Integer(0, 16)] = 3
    """Bands of the Laplacian pyramid that normalises the gradient, 0 or more."""
    window: Annotated[int, Integer(1, 99, odd=True)] = 1
    """Frames over which the motion is kept coherent, odd; 1 is none."""
    steps: Annotated[int | str, Integer(1, 1000, word="auto")] = 1
    """Sub-steps of the transport: 1 is the paper's; auto takes one per cell of the longest
    displacement."""
    parameterisation: Annotated[str, Choice(("transport", "density"))] = "transport"
    """Optimise velocities that transport the smoke, or change density values in place."""
    integrator: Annotated[str, Choice(("emission_absorption", "prbvolpath"))] = "emission_absorption"
    """Renderer inside the optimisation: light emitted by the smoke, or Mitsuba's scattering path tracer, for
    which the next four are."""
    albedo: Annotated[float, Number(0.0, 1.0)] = 0.9
    """prbvolpath: scattered share of the extinguished light, from 0 to 1."""
    anisotropy: Annotated[float, Number(-0.99, 0.99)] = 0.0
    """prbvolpath: mean cosine g of the phase function (Henyey and Greenstein's), from -0.99 (back) to 0.99
    (on); 0 scatters evenly."""
    light: Annotated[str, Text("FILE|key|environment", "a Mitsuba scene file, key or environment")] = "key"
    """prbvolpath: where light comes from: the emitters of a Mitsuba scene file, or key (upper left, and some
    from everywhere) or environment (from everywhere alike)."""
    spp: Annotated[int, Integer(1, 4096)] = 16
    """prbvolpath: paths per pixel in each pass of an iteration, 1 or more."""
    blend: Annotated[float, Number(0.0, 1.0)] = 1.0
    """Share b of the stylized density in the result d + b·(d* − d), from 0 to 1."""
    seed: Annotated[int, Integer(0, 2**32 - 1)] = 0
    """Seed of the random views; equal seeds give equal bits."""


@dataclass(frozen=True)
class Resources:
    """What to read, compute with and write."""

    frames: Annotated[
        str | None, Text("FIRST:LAST", 'a range of frame numbers, such as "70:89"', r"\d{1,9}:\d{1,9}")
    ] = None
    """Numbers of the first and the last frame of a sequence to stylize; all where not set."""
    weights: Annotated[
        str | None, Text(f"FILE|FOLDER|{PATTERNS}", f'a file or folder with GoogLeNet weights, or "{PATTERNS}"')
    ] = None
    """GoogLeNet weights: a file, a folder, or patterns, the network that ships with the package. Searched for
    where not set (tnst-mi weights lists the places)."""
    variant: Annotated[
        str | None, Text("cuda_ad_rgb|llvm_ad_rgb", "cuda_ad_rgb or llvm_ad_rgb", "cuda_ad_rgb|llvm_ad_rgb")
    ] = None
    """Mitsuba variant: GPU or CPU; the GPU where not set and one answers."""
    format: Annotated[str | None, Text("npz", "npz", "npz")] = None
    """File format of the results; the input's where not set."""


@dataclass(frozen=True)
class Recipe(Resources, Method, Goals):
    """Everything that decides a stylization, apart from the frames themselves.

    Raises:
        InputError: a value has the wrong type or is out of range.
    """

    def __post_init__(self) -> None:
        """Check every value and bring it into its normal form."""
        for name in KINDS:
            object.__setattr__(self, name, _checked(name, getattr(self, name), "recipe: "))
        if self.frames is not None and self.frame_range[0] > self.frame_range[1]:
            raise InputError(f"recipe: frames = {self.frames!r}: expected the smaller number first")

    @classmethod
    def from_toml(cls, path: str | Path) -> Recipe:
        """Read a recipe file; relative paths in it count from its folder.

        Raises:
            InputError: the file is missing or no TOML, a key is unknown, a value has the wrong type or is out
                of range, or a picture does not exist.
        """
        path = Path(path)
        try:
            if path.stat().st_size > _LARGEST_FILE:
                raise InputError(f"{path}: {path.stat().st_size} bytes, expected a recipe of at most 1 MiB")
            values = tomllib.loads(path.read_text("utf-8"))
        except FileNotFoundError:
            raise InputError(f"{path}: no such recipe file") from None
        except (OSError, UnicodeDecodeError, RecursionError) as error:
            raise InputError(f"{path}: cannot be read as a recipe ({error})") from None
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"{path}: not valid TOML ({error})") from None
        return cls.from_dict(values, source=f"{path}: ", folder=path.parent)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: str = "recipe: ", folder: Path | None = None) -> Recipe:
        """Make a recipe from TOML values; errors start with `source`, relative paths are in `folder`."""
        return cls().updated(values, source, folder or Path.cwd())

    def updated(self, values: Mapping[str, Any], source: str, folder: Path) -> Recipe:
        """Return a copy with some keys replaced (see `from_dict`)."""
        checked = {}
        for name, value in values.items():
            if name not in KINDS:
                nearest = difflib.get_close_matches(str(name), KINDS, n=1, cutoff=0.0)[0]
                raise InputError(f"{source}unknown key {name!r}; the nearest known key is {nearest!r}")
            checked[name] = _located(name, _checked(name, value, source), source, folder)
        return dataclasses.replace(self, **checked)

    def updated_by_flags(self, texts: Mapping[str, str | tuple[str, ...]]) -> Recipe:
        """Return a copy with keys replaced by texts of flags; relative paths are in the current folder."""
        recipe = self
        for name, text in texts.items():
            flag = "--" + name.replace("_", "-")
            try:
                value = KINDS[name].check(KINDS[name].read(text))
            except (ValueError, OverflowError):
                shown = text if isinstance(text, str) else " ".join(text)
                raise InputError(f"{flag} {shown}: expected {KINDS[name].expected}") from None
            recipe = recipe.updated({name: value}, f"{flag}: ", Path.cwd())
        return recipe

    def to_toml(self) -> str:
        """Write the recipe as TOML, every key under its documentation; keys that are not set are comments."""
        document = tomlkit.document()
        for name, text in documentation().items():
            for line in textwrap.wrap(text, 100):
                document.add(tomlkit.comment(line))
            value = getattr(self, name)
            if value is None:
                document.add(tomlkit.comment(f"{name} is not set"))
            elif isinstance(value, dict):
                document.add(name, tomlkit.inline_table())
                document[name].update(value)
            elif name in ("style", "content"):
                document.add(name, [_shipped_name(path) for path in value])
            else:
                document.add(name, list(value) if isinstance(value, tuple) else value)
            document.add(tomlkit.nl())
        return tomlkit.dumps(document)

    @property
    def main_view(self) -> tuple[float, float]:
        """The centre of the camera ranges, (azimuth, elevation) in degrees."""
        return sum(self.azimuth) / 2.0, sum(self.elevation) / 2.0

    @property
    def frame_range(self) -> tuple[int, int] | None:
        """First and last frame number, both included, or None for all frames."""
        if self.frames is None:
            return None
        first, last = self.frames.split(":")
        return int(first), int(last)

    @property
    def semantic_channels(self) -> list[tuple[str, tuple[int, ...]]]:
        """The semantic targets as (layer, channels)."""
        targets = []
        for target in self.semantic:
            layer, _, channels = target.partition(":")
            targets.append((layer, tuple(int(channel) for channel in channels.split(","))))
        return targets


#: The kind of value that each key of a recipe holds, in the order of the file.
KINDS: dict[str, Kind] = {
    name: hint.__metadata__[0] for name, hint in get_type_hints(Recipe, include_extras=True).items()
}


@functools.cache
def documentation() -> dict[str, str]:
    """The documentation of each key, one paragraph: the text below its field in this file."""
    paragraphs = {}
    for section in (Goals, Method, Resources):
        (body,) = ast.parse(inspect.getsource(section)).body
        for field_node, text_node in itertools.pairwise(body.body):
            if isinstance(field_node, ast.AnnAssign):
                paragraphs[field_node.target.id] = " ".join(text_node.value.value.split())
    return paragraphs


def shipped_styles() -> list[str]:
    """Names of the style pictures that ship with the package."""
    return sorted(path.stem for path in STYLES.glob("*.png"))


def shipped_lights() -> list[str]:
    """Names of the lights that ship with the package."""
    return sorted(path.stem for path in LIGHTS.glob("*.xml"))


def _checked(name: str, value: Any, source: str) -> Any:
    try:
        return KINDS[name].check(value)
    except (ValueError, OverflowError):
        shown = reprlib.repr(value)
        raise InputError(f"{source}{name} = {shown}: expected {KINDS[name].expected}") from None


def _located(name: str, value: Any, source: str, folder: Path) -> Any:
    """Make the paths in a checked value absolute."""
    if name in ("style", "content"):
        return tuple(_picture(name, entry, source, folder) for entry in value)
    if name == "light" and value not in shipped_lights():
        if not (folder / value).is_file():
            raise InputError(f"{source}light = {value!r}: no such file, nor one of {', '.join(shipped_lights())}")
        return str((folder / value).resolve())
    if name == "weights" and value not in (None, PATTERNS) and (folder / value).exists():
        return str((folder / value).resolve())
    return value


def _picture(name: str, entry: str, source: str, folder: Path) -> str:
    path = folder / entry
    if path.exists():
        return str(path.resolve())
    if re.fullmatch(r"[\w-]+", entry) and (STYLES / f"{entry}.png").exists():
        return str(STYLES / f"{entry}.png")
    shipped = ", ".join(shipped_styles())
    raise InputError(f"{source}{name} = {entry!r}: no such picture ({path}); those shipped are {shipped}")


def _shipped_name(path: str) -> str:
    return Path(path).stem if Path(path).parent == STYLES else path

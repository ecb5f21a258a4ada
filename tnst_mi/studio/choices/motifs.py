"""The motifs that the page offers: style pictures, class tags and channels of layers, each with a thumbnail if any."""

from __future__ import annotations

import re
import threading
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np

from tnst_mi.atlas.layer_atlas import means_in
from tnst_mi.errors import InputError
from tnst_mi.io.atomic import make_folder, written_whole
from tnst_mi.losses.pictures import GreyImage, read_image
from tnst_mi.machine.gate import decoding
from tnst_mi.machine.terminal import one_line
from tnst_mi.network.class_names import class_names
from tnst_mi.network.googlenet import LAYERS, LOGITS
from tnst_mi.network.readers import read_weights
from tnst_mi.network.weights import find_weights
from tnst_mi.recipe.paths import STYLES, shipped_styles
from tnst_mi.studio.choices.atlas_channels import ATLAS, PICTURE, channels_of
from tnst_mi.studio.choices.examples import ATLASES, channel_of
from tnst_mi.studio.choices.similarity import COMPARED, PictureAnswer
from tnst_mi.studio.choices.uploads import picture_as_png, read_upload
from tnst_mi.studio.places import Places
from tnst_mi.studio.plain import is_plain

#: What the page shows at a time, at most: of tags, and of layers or channels.
_TAGS, _CHANNELS = 64, 64

#: Edge of a thumbnail in pixels.
_EDGE = 96

#: How many folders below the started one atlases are looked for.
_DEPTH = 3

#: Pictures that have been uploaded, at most.
_UPLOADS = 200


@dataclass(frozen=True)
class Motif:
    """Something to stylize towards.

    Attributes:
        kind: under which heading it is shown.
        key: of the recipe, "style", "tag" or "semantic".
        goal: the value of that key.
        title: as it is shown.
        thumbnail: URL of a picture; None if there is none.
    """

    kind: str
    key: str
    goal: str
    title: str
    thumbnail: str | None = None


class MotifBrowser:
    """Finds motifs by their names.

    Args:
        places: below which atlases are looked for.
        out: the folder of the studio, which need not exist; it has uploaded pictures, and atlases that were asked for.
    """

    def __init__(self, places: Places, out: Path) -> None:
        self._places, self._pictures = places, out / "pictures"
        self._made = Places(out / ATLASES)
        self._names: dict[str | None, list[str]] = {}
        self._reading = threading.Lock()

    def found(self, text: str, weights: str | None) -> list[dict[str, Any]]:
        """Motifs whose names have the text in them, or all to begin with.

        Args:
            text: as it was typed; "LAYER:CHANNEL" is a channel.
            weights: the recipe's key, which decides what tags there are.

        Raises:
            InputError: the weights cannot be used.
        """
        wanted = text.strip().lower()
        motifs = [motif for motif in self._styles() if wanted in motif.title.lower()]
        tags = len(self.tags(weights))
        motifs += self._tag_motifs("tags", range(tags), wanted, weights)
        motifs += _first(_CHANNELS, list(self._channels(wanted, tags > 0)))
        return [asdict(motif) for motif in motifs]

    def alike(self, text: str, weights: str | None, answer: PictureAnswer) -> list[dict[str, Any]]:
        """Tags and channels whose names have the text in them, the one that answers to a picture most strongly first.

        Tags are in the order of their scores. Channels of an atlas are in that of their share: how far the picture
        raises them above noise, where the picture that the atlas has made for them raises them by 100%. All others are
        in the order of how many standard deviations they are above what the reference pictures raise them to. Styles
        come last, as they are.

        Args:
            text: as in `found`.
            weights: the recipe's key.
            answer: of the network with these weights.

        Raises:
            InputError: the weights cannot be used.
        """
        wanted = text.strip().lower()
        scores = answer.means[LOGITS][: len(self.tags(weights))]
        motifs = self._tag_motifs("tags, by score", np.argsort(-scores, kind="stable").tolist(), wanted, weights)
        in_atlases = list(self._shares(wanted, find_weights(weights).flavour, answer))
        motifs += [motif for _, motif in sorted(in_atlases, key=lambda found: -found[0])][:_CHANNELS]
        seen = {motif.goal for _, motif in in_atlases}
        motifs += [motif for motif in _by_deviation(wanted, answer) if motif.goal not in seen]
        motifs += [motif for motif in self._styles() if wanted in motif.title.lower()]
        return [asdict(motif) for motif in motifs]

    def _tag_motifs(self, kind: str, numbers: Iterable[int], wanted: str, weights: str | None) -> list[Motif]:
        """The tags of classes by their numbers of which a name has the text in it."""
        pictures, tags, names = self._tag_pictures(weights), self.tags(weights), self._class_names(weights)
        found = [
            Motif(kind, "tag", tags[number], tags[number], pictures.get(number))
            for number in numbers
            if wanted in names[number].lower()
        ]
        return _first(_TAGS, found)

    def _shares(self, wanted: str, flavour: str, answer: PictureAnswer) -> Iterator[tuple[float, Motif]]:
        """Channels of atlases, each with its share."""
        layer, number = _layer_and_number(wanted)
        seen = set()
        for atlas in self._atlases():
            for found, picture in channels_of(atlas):
                goal = f"{found.layer}:{found.channel}"
                named = layer in found.layer.lower() and number in (None, found.channel) and found.layer != LOGITS
                if found.flavour != flavour or not named or goal in seen or (means := means_in(picture)) is None:
                    continue
                before, after = means
                of_layer = answer.means[found.layer]
                if after <= before or found.channel >= len(of_layer):
                    continue
                seen.add(goal)
                share = (float(of_layer[found.channel]) - before) / (after - before)
                title = _channel_title(found.layer, found.channel, f" {share:.0%}")
                yield share, Motif("channels of atlases, by share", "semantic", goal, title, self._picture_url(picture))

    def tags(self, weights: str | None) -> list[str]:
        """The class tags of the network with which a recipe is run; each by its first name that no other has.

        Raises:
            InputError: the weights cannot be used.
        """
        names = self._class_names(weights)
        first = Counter(name.split(",")[0].strip() for name in names)
        return [short if first[short := name.split(",")[0].strip()] == 1 else name for name in names]

    def _class_names(self, weights: str | None) -> list[str]:
        """All names of each class."""
        with self._reading:
            if weights not in self._names:
                self._names[weights] = class_names(read_weights(find_weights(weights).path))
            return self._names[weights]

    def _tag_pictures(self, weights: str | None) -> dict[int, str]:
        """URLs of the pictures of an atlas of the class scores of the network, by their numbers."""
        flavour = find_weights(weights).flavour
        return {
            found.channel: self._picture_url(picture)
            for atlas in self._atlases()
            for found, picture in channels_of(atlas)
            if (found.layer, found.flavour) == (LOGITS, flavour)
        }

    def _picture_url(self, picture: Path) -> str:
        if (made := self._made.relative(picture)) is not None:
            return f"thumbnail?{urlencode({'made': made})}"
        return f"thumbnail?{urlencode({'atlas': self._places.relative(picture) or ''})}"

    def thumbnail(self, style: str | None = None, atlas: str | None = None, made: str | None = None) -> bytes:
        """A small PNG of a style picture by its name, or of a picture of an atlas by its path.

        Args:
            style: the name.
            atlas: the path from the started folder.
            made: the path from that of the atlases that were asked for.

        Raises:
            InputError: there is none.
        """
        if style is not None:
            names = {motif.goal: file for motif, file in self._style_files()}
            if style not in names:
                raise InputError(one_line(f"{style!r}: no such style picture"))
            return _thumbnail(read_image(names[style]))
        path = self._places.within(atlas or "") if made is None else self._made.within(made)
        if not PICTURE.fullmatch(path.name) or not (path.parent.parent / ATLAS).is_file():
            raise InputError(one_line(f"{made or atlas!r}: is no picture of an atlas"))
        return _thumbnail(read_image(path))

    def upload(self, name: str, body: bytes) -> str:
        """Keep an uploaded picture, as what is read of it, with its colours and transparency; returns it as a goal.

        Raises:
            InputError: it cannot be read as a picture, or there are too many.
        """
        stem = re.sub(r"[^\w-]+", "_", Path(name.replace("\\", "/")).stem).strip("_")[:40] or "picture"
        image = read_upload(Path(name).name, body)
        make_folder(self._pictures)
        if len(list(self._pictures.glob("*.png"))) >= _UPLOADS:
            raise InputError(f"{self._pictures}: has {_UPLOADS} pictures already; remove some")
        file, number = self._pictures / f"{stem}.png", 2
        while file.exists():
            file, number = self._pictures / f"{stem}_{number}.png", number + 1
        with written_whole(file) as temporary:
            temporary.write_bytes(picture_as_png(image))
        return str(file.resolve())

    def require_offered(self, key: str, goal: str, weights: str | None) -> None:
        """Check that a goal is one of those that can be chosen: a style that is listed, a tag, or a channel.

        Args:
            key: of the recipe.
            goal: the value.
            weights: the recipe's key, which decides what tags there are.

        Raises:
            InputError: it is none, or the weights cannot be used.
        """
        if key != "style":
            channel_of([key, goal], self.tags(weights))
        elif all(goal != motif.goal for motif in self._styles()):
            raise InputError("studio: no such style; choose one of those on the left, or drop its picture there")

    def _styles(self) -> Iterator[Motif]:
        return (motif for motif, _ in self._style_files())

    def _style_files(self) -> Iterator[tuple[Motif, Path]]:
        """Uploaded pictures, the latest first, and those that ship with the package."""
        with decoding(self._pictures, "the folder of pictures"):
            uploaded = [file for file in self._pictures.glob("*.png") if is_plain(file)]
            uploaded.sort(key=lambda file: -file.stat().st_mtime)
        files = [(str(file.resolve()), file) for file in uploaded]
        files += [(name, STYLES / f"{name}.png") for name in shipped_styles()]
        for goal, file in files:
            yield Motif("styles", "style", goal, file.stem, f"thumbnail?{urlencode({'style': goal})}"), file

    def _channels(self, wanted: str, tags: bool) -> Iterator[Motif]:
        """Those of atlases, but for what is a tag already, and of other layers the one that is asked for."""
        layer, number = _layer_and_number(wanted)
        seen = set()
        for atlas in self._atlases():
            for found, picture in channels_of(atlas):
                goal = f"{found.layer}:{found.channel}"
                if tags and found.layer == LOGITS:
                    continue
                if layer in found.layer.lower() and number in (None, found.channel) and goal not in seen:
                    seen.add(goal)
                    title = _channel_title(found.layer, found.channel)
                    yield Motif("channels", "semantic", goal, title, self._picture_url(picture))
        if wanted and number is not None:
            for name in LAYERS:
                goal = f"{name}:{number}"
                if layer in name.lower() and goal not in seen:
                    yield Motif("channels", "semantic", goal, _channel_title(name, number))

    def _atlases(self) -> Iterator[Path]:
        for depth in range(1, _DEPTH + 1):
            for file in sorted(self._places.root.glob("/".join(["*"] * depth + [ATLAS]))):
                inside = self._places.relative(file) is not None
                if inside and self._made.relative(file) is None:
                    yield file.parent
        yield from (file.parent for file in sorted(self._made.root.glob(f"*/{ATLAS}")))


def _first(most: int, found: list[Motif]) -> list[Motif]:
    """The first of some that have a heading in common, which says so if there are more."""
    if len(found) <= most:
        return found
    return [
        replace(motif, kind=f"{motif.kind}: {most} of {len(found)}; search for the others") for motif in found[:most]
    ]


def _channel_title(layer: str, channel: int, measure: str = "") -> str:
    """What the page calls a channel: what tells it from others of its layer comes first, where narrow tiles show it."""
    return f"{channel}{measure} · {layer.removeprefix('inception_')}"


def _layer_and_number(wanted: str) -> tuple[str, int | None]:
    """A part of the name of a layer, and the number of a channel if "LAYER:CHANNEL" is asked for."""
    layer, _, channel = wanted.partition(":")
    return layer, int(channel) if channel.isascii() and channel.isdigit() and len(channel) < 6 else None


def _by_deviation(wanted: str, answer: PictureAnswer) -> Iterator[Motif]:
    """The channels that deviate most from what they are for the reference pictures."""
    layer, number = _layer_and_number(wanted)
    found = [
        (float(deviation), name, channel)
        for name in COMPARED
        if layer in name.lower()
        for channel, deviation in enumerate(answer.deviations[name])
        if number in (None, channel)
    ]
    for deviation, name, channel in sorted(found, key=lambda one: -one[0])[:_CHANNELS]:
        goal = f"{name}:{channel}"
        title = _channel_title(name, channel, f" {deviation:+.1f}σ")
        yield Motif("channels, by deviation", "semantic", goal, title)


def _thumbnail(image: GreyImage) -> bytes:
    return picture_as_png(image.fitted(_EDGE, _EDGE))

"""An atlas of a layer: what excites every channel, and how it stylizes smoke; a guide for choosing `--semantic`.

    OUT/atlas.html              a page to browse, self-contained
    OUT/atlas.png               all tiles with their numbers
    OUT/atlas.json              layer, network and settings: what the pictures depend on
    OUT/channels/016_*.png      picture and smoke of channel 16, each with the channel's mean before and after as text

The pictures in `channels` are made once and kept: each is written atomically, and depends only on atlas.json.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image, PngImagePlugin

from tnst_mi.atlas.excitation import Ascent, excite, noise
from tnst_mi.atlas.page import Channel, write_page, write_sheet
from tnst_mi.atlas.smoke_patch import PatchSettings, stylized_ball
from tnst_mi.errors import InputError
from tnst_mi.io.atomic import remove_unfinished, written_whole
from tnst_mi.io.pictures.png import eight_bits
from tnst_mi.losses.terms import Semantic
from tnst_mi.machine.backend import torch_device
from tnst_mi.machine.disk import require_writable
from tnst_mi.machine.gate import decoding
from tnst_mi.machine.interrupt import deferred_interrupt
from tnst_mi.network.googlenet import GoogLeNet


@dataclass(frozen=True)
class AtlasSettings:
    """How the two pictures of a channel are made."""

    ascent: Ascent = field(default_factory=Ascent)
    patch: PatchSettings = field(default_factory=PatchSettings)


class LayerAtlas:
    """The atlas of a layer in a folder; `make` adds the missing pictures."""

    def __init__(self, network: GoogLeNet, layer: str, out: Path, settings: AtlasSettings | None = None) -> None:
        """Begin an atlas, or continue the one in the folder.

        Args:
            network: the network.
            layer: a layer of it, or an alias.
            out: a new or empty folder, or one with an atlas of the same layer, network and settings.
            settings: how pictures are made.

        Raises:
            InputError: the layer is unknown, or the folder holds something else or is not writable.
        """
        self.layer = network.resolve(layer)
        self.out = out
        self._network = network.to(torch_device())
        self._settings = settings or AtlasSettings()
        described = out / "atlas.json"
        require_writable(out, remedy=None if described.is_file() else "give an empty or new one, or an atlas")
        if described.is_file():
            self._require_same(described)
        else:
            with written_whole(described) as temporary:
                temporary.write_text(json.dumps(self._key, indent=1) + "\n", "utf-8")
        remove_unfinished(out.resolve())
        remove_unfinished(out / "channels")

    def steps(self, smoke: bool = True) -> int:
        """Iterations that a channel takes, with its smoke or without."""
        return self._settings.ascent.steps + (self._settings.patch.steps if smoke else 0)

    def missing(self, channels: Sequence[int], smoke: bool = True) -> list[int]:
        """The given channels that are not finished, or have no picture of what excites them, in order."""
        if smoke:
            return [channel for channel in channels if self._finished(channel) is None]
        return [channel for channel in channels if means_in(self._file(channel, "picture")) is None]

    def make(
        self,
        channels: Sequence[int],
        on_iteration: Callable[[int, str], None] = lambda channel, what: None,
        smoke: bool = True,
    ) -> None:
        """Make the missing pictures of the given channels.

        Args:
            channels: their numbers.
            on_iteration: called after every iteration, with the channel and which of its pictures is being made.
            smoke: whether smoke is stylized too, which takes most of the time; a channel without is not finished.

        Raises:
            InputError: the layer has no such channel.
            KeyboardInterrupt: Ctrl-C was pressed; finished pictures are kept.
        """
        self._network.check_channels(self.layer, channels)
        with deferred_interrupt() as interrupt:
            for channel in channels:

                def advance(what: str, channel: int = channel) -> None:
                    on_iteration(channel, what)
                    if interrupt.requested:
                        raise KeyboardInterrupt

                if means_in(self._file(channel, "picture")) is None:
                    self._make_picture(channel, lambda advance=advance: advance("picture"))
                if smoke and means_in(self._file(channel, "smoke")) is None:
                    self._make_smoke(channel, lambda advance=advance: advance("smoke"))

    def publish(self) -> list[Channel]:
        """Write sheet and page of all finished channels, and return these in the order of their numbers."""
        numbers = range(self._network.channels(self.layer))
        channels = [channel for channel in map(self._finished, numbers) if channel is not None]
        if channels:
            network = f"Network {self._network.flavour} ({Path(self._network.source).name}, sha256 "
            write_sheet(self.out / "atlas.png", channels)
            write_page(self.out / "atlas.html", self.layer, f"{network}{self._network.sha256[:12]}…)", channels)
        return channels

    # ---------------------------------------------------------------- one channel

    def _make_picture(self, channel: int, on_iteration: Callable[[], None]) -> None:
        ascent = self._settings.ascent
        picture = excite(self._network, self.layer, channel, ascent, on_iteration)
        means = [self._mean(channel, image) for image in (noise(ascent, channel, ascent.size), picture)]
        self._write(self._file(channel, "picture"), picture, *means)

    def _make_smoke(self, channel: int, on_iteration: Callable[[], None]) -> None:
        patch = stylized_ball(self._network, self.layer, channel, self._settings.patch, on_iteration)
        self._write(self._file(channel, "smoke"), patch.image, patch.before, patch.after)

    def _mean(self, channel: int, picture: np.ndarray) -> float:
        """Mean of the channel for a picture."""
        bound = Semantic(self.layer, (channel,)).bind(self._network, *picture.shape)
        with torch.no_grad():
            return -float(bound(torch.from_numpy(picture)[None].to(torch_device())))

    # ---------------------------------------------------------------- files

    @property
    def _key(self) -> dict[str, Any]:
        """Everything that the pictures depend on."""
        key = {
            "layer": self.layer,
            "flavour": self._network.flavour,
            "weights": self._network.sha256,
            **dataclasses.asdict(self._settings),
        }
        return json.loads(json.dumps(key))

    def _require_same(self, described: Path) -> None:
        try:
            found = json.loads(described.read_text("utf-8"))
        except (OSError, ValueError, RecursionError):
            raise InputError(
                f"{described}: damaged, so it does not tell which atlas it is; give another --out"
            ) from None
        if found == self._key:
            return
        for name, what in (("layer", "layer"), ("weights", "network")):
            if not isinstance(found, dict) or found.get(name) != self._key[name]:
                raise InputError(f"{self.out}: holds the atlas of another {what}; give another --out")
        raise InputError(f"{self.out}: holds an atlas made with other settings; give another --out")

    def _file(self, channel: int, what: str) -> Path:
        return self.out / "channels" / f"{channel:03d}_{what}.png"

    def _finished(self, number: int) -> Channel | None:
        """A channel with both of its pictures; None if one is missing."""
        picture, smoke = (self._file(number, what) for what in ("picture", "smoke"))
        of_picture, of_smoke = means_in(picture), means_in(smoke)
        if of_picture is None or of_smoke is None:
            return None
        most, gained = (after - before for before, after in (of_picture, of_smoke))
        return Channel(number, picture, smoke, gained / most if most > 0.0 else 0.0)

    @staticmethod
    def _write(file: Path, image: np.ndarray, before: float, after: float) -> None:
        text = PngImagePlugin.PngInfo()
        text.add_text("before", repr(before))
        text.add_text("after", repr(after))
        with written_whole(file) as temporary:
            Image.fromarray(eight_bits(image)).save(temporary, pnginfo=text)


def means_in(file: Path) -> tuple[float, float] | None:
    """The channel's mean before and after, from the file of a picture; None if there is none, or it is damaged."""
    try:
        with decoding(file, "a picture of an atlas"), Image.open(file, formats=["PNG"]) as image:
            image.load()
            return float(image.info["before"]), float(image.info["after"])
    except InputError:
        return None


def channel_numbers(text: str, count: int) -> list[int]:
    """The channels that the text of --channels denotes, such as "0:16" or "6,16,40:47"; both ends are included.

    Raises:
        InputError: the text is malformed, or a number is not below `count`.
    """
    numbers: set[int] = set()
    for part in text.split(","):
        ends = re.fullmatch(r"([0-9]{1,6})(?::([0-9]{1,6}))?", part)
        if ends is None:
            raise InputError(f"--channels {text}: expected numbers or ranges FIRST:LAST, such as 0:15 or 6,16,40:47")
        low, high = int(ends[1]), int(ends[2] or ends[1])
        if not low <= high < count:
            raise InputError(f"--channels {text}: expected numbers from 0 to {count - 1}, the smaller first")
        numbers.update(range(low, high + 1))
    return sorted(numbers)

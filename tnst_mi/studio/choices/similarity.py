"""How strongly the network answers to a picture: the scores of its tags, and its channels on scales of their own.

Means of different channels cannot be compared as they are: some are large for every picture. So each is measured by its
mean over reference pictures, and by how much it varies among these: the style pictures that ship with the package,
whole and in quarters.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from tnst_mi.losses.evaluation import as_rgb
from tnst_mi.losses.pictures import GreyImage, read_image
from tnst_mi.machine.backend import torch_device
from tnst_mi.machine.turns import turn
from tnst_mi.network.googlenet import LAYERS, LOGITS, GoogLeNet
from tnst_mi.network.weights import find_weights
from tnst_mi.recipe.paths import STYLES, shipped_styles
from tnst_mi.studio.choices.uploads import read_upload

#: Rows and columns in which the network sees a picture: those of an atlas, whose means can be compared with these.
EDGE = 96

#: Layers whose channels are compared: those of the blocks, each channel once, as outputs repeat what the branches have.
COMPARED = tuple(layer for layer in LAYERS if layer.startswith("inception_") and not layer.endswith("/output"))

#: Pictures whose answers are kept.
_KEPT = 4


@dataclass(frozen=True, eq=False)
class PictureAnswer:
    """What a network answers to a picture.

    Attributes:
        means: by layer, the mean (C,) of each channel over the picture; of `LOGITS`, the score of each class.
        deviations: by layer of `COMPARED`, how far each mean (C,) is above that over the reference pictures, in
            standard deviations of these.
    """

    means: Mapping[str, np.ndarray]
    deviations: Mapping[str, np.ndarray]


class PictureAnswers:
    """Shows pictures to the network of a recipe; the latest network and answers are kept."""

    def __init__(self) -> None:
        self._network: tuple[Path, _ScaledNetwork] | None = None
        self._answers: OrderedDict[tuple[Path, bytes], PictureAnswer] = OrderedDict()
        self._asking = threading.Lock()

    def answer(self, name: str, body: bytes, weights: str | None) -> PictureAnswer:
        """What the network answers to a picture; the same bits each time.

        Args:
            name: that of its file.
            body: the bytes of the file.
            weights: the recipe's key.

        Raises:
            InputError: it cannot be read as a picture, or the weights cannot be used.
        """
        path = find_weights(weights).path
        key = path, hashlib.sha256(body).digest()
        with self._asking:
            if key not in self._answers:
                image = read_upload(Path(name).name, body)
                if self._network is None or self._network[0] != path:
                    self._network = path, _ScaledNetwork(GoogLeNet.from_file(path))
                self._answers[key] = self._network[1].answer(image)
            self._answers.move_to_end(key)
            while len(self._answers) > _KEPT:
                self._answers.popitem(last=False)
            return self._answers[key]


class _ScaledNetwork:
    """A network, and the scales of its channels."""

    def __init__(self, network: GoogLeNet) -> None:
        self._network = network.to(torch_device())
        seen = [self._means(picture) for picture in _references()]
        self._centres, self._spreads = {}, {}
        for layer in COMPARED:
            means = np.stack([of_picture[layer] for of_picture in seen])
            own = means.std(axis=0)
            self._centres[layer] = means.mean(axis=0)
            # So few pictures tell a channel's own spread but roughly: half of it is that of its layer.
            self._spreads[layer] = np.sqrt((own**2 + np.median(own) ** 2) / 2) + np.finfo(np.float32).tiny

    def answer(self, image: GreyImage) -> PictureAnswer:
        means = self._means(image)
        deviations = {layer: (means[layer] - self._centres[layer]) / self._spreads[layer] for layer in COMPARED}
        return PictureAnswer(means, deviations)

    def _means(self, image: GreyImage) -> dict[str, np.ndarray]:
        pixels = torch.from_numpy(image.fitted(EDGE, EDGE).grey)[None]
        with turn(), torch.no_grad():
            features = self._network(as_rgb(pixels.to(torch_device())), LAYERS)
            return {
                layer: (values if layer == LOGITS else values.mean((2, 3)))[0].numpy(force=True)
                for layer, values in features.items()
            }


def _references() -> Iterator[GreyImage]:
    """The style pictures that ship with the package, and their quarters."""
    for name in shipped_styles():
        whole = read_image(STYLES / f"{name}.png")
        yield whole
        rows, columns = (n // 2 for n in whole.grey.shape)
        for top in (slice(rows), slice(rows, None)):
            for left in (slice(columns), slice(columns, None)):
                yield GreyImage(name, whole.grey[top, left])

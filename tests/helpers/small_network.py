"""A small smooth network in float64 with GoogLeNet's interface, and pictures to show it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from tnst_mi.errors import InputError
from tnst_mi.losses.objective import Objective
from tnst_mi.losses.pictures import GreyImage
from tnst_mi.losses.style import Style
from tnst_mi.losses.terms import ClassTag, Content, Match, Semantic

HEIGHT, WIDTH = 12, 10
CHANNELS = {"shallow": 4, "deep": 6, "logits": 5}


class SmallNetwork(nn.Module):
    """The interface of GoogLeNet on three smooth layers; `asked` records every evaluation."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.first = nn.Conv2d(3, 4, 3, padding=1)
        self.second = nn.Conv2d(4, 6, 3, stride=2, padding=1)
        self.classifier = nn.Linear(6, 5)
        self.asked: list[list[str]] = []
        self.double().requires_grad_(False)

    def forward(self, x: Tensor, layers: list[str]) -> dict[str, Tensor]:
        self.asked.append(list(layers))
        shallow = 0.2 + torch.tanh(self.first(x))
        deep = torch.tanh(self.second(shallow)) - 0.1
        values = {"shallow": shallow, "deep": deep, "logits": self.classifier(deep.mean((2, 3)))}
        return {layer: values[self.resolve(layer)] for layer in layers}

    def channels(self, layer: str) -> int:
        return CHANNELS[self.resolve(layer)]

    def resolve(self, layer: str) -> str:
        name = {"alias_of_deep": "deep"}.get(layer, layer)
        if name not in CHANNELS:
            raise InputError(f"layer {layer!r}: unknown")
        return name

    def check_channels(self, layer: str, channels: tuple[int, ...]) -> None:
        if not all(0 <= channel < CHANNELS[self.resolve(layer)] for channel in channels):
            raise InputError(f"channel of layer {layer!r}: out of range")

    def class_index(self, tag: str) -> int:
        return ["cat", "dog", "volcano", "cloud", "tree"].index(tag)


def views(n: int = 3, seed: int = 0) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).random((n, HEIGHT, WIDTH)))


def picture(seed: int = 1, height: int = HEIGHT, width: int = WIDTH, name: str = "picture") -> GreyImage:
    return GreyImage(name, np.random.default_rng(seed).random((height, width)).astype(np.float32))


def features(net: SmallNetwork, images: Tensor, layer: str) -> np.ndarray:
    return net(images[:, None].repeat(1, 3, 1, 1), layers=[layer])[layer].numpy()


def value(objective: Objective, net: SmallNetwork, images: Tensor) -> float:
    return objective.bind(net, HEIGHT, WIDTH)(images).item()


def gradient(objective: Objective, net: SmallNetwork, images: Tensor) -> Tensor:
    images = images.clone().requires_grad_()
    return torch.autograd.grad(objective.bind(net, HEIGHT, WIDTH)(images), images)[0]


TERMS: dict[str, Objective] = {
    "semantic": Semantic("deep", (1, 4)),
    "channel 0": Semantic("shallow", (0,)),
    "damped": Semantic("deep", (5,), damping=0.3),
    "match": Match("deep", np.linspace(-1, 1, 6).reshape(6, 1, 1)),
    "tag": ClassTag("volcano"),
    "content": Content(picture(), "alias_of_deep"),
    "style": Style(picture(), {"shallow": 2.0, "deep": 0.5}),
    "style of the paper": Style(picture(), {"shallow": 2.0, "deep": 0.5}, "paper"),
    "swd": Style(picture(), {"shallow": 2.0, "deep": 0.5}, "swd"),
    "nnfm": Style(picture(), {"shallow": 2.0, "deep": 0.5}, "nnfm"),
    "histogram": Style(picture(), {"shallow": 2.0, "deep": 0.5}, "histogram"),
    "sum": Style(picture(), {"deep": 1.0}) + 0.5 * Semantic("shallow", (2,)) + -ClassTag("cat"),
}

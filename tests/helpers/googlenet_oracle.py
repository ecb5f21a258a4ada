"""GoogLeNet in plain numpy, float64, from the papers' and frameworks' formulas: the torch module's oracle.

It shares no code with the package: convolutions are windows times a matrix, padding rules are spelled out,
batch normalisation is not folded, local response normalisation is a loop over channels.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

BLOCKS = ("3a", "3b", "4a", "4b", "4c", "4d", "4e", "5a", "5b")
BATCH_NORM_EPSILON = 1e-3


def convolve(x: np.ndarray, weight: np.ndarray, bias: np.ndarray, rule: str, stride: int = 1) -> np.ndarray:
    """Cross-correlation of (C, H, W) with (O, C, k, k), zeros outside; Caffe's nets pad k // 2."""
    kernel = weight.shape[-1]
    pad = [same(size, kernel, stride) if rule == "same" else (kernel // 2,) * 2 for size in x.shape[1:]]
    windows = sliding_window_view(np.pad(x, ((0, 0), *pad)), (kernel, kernel), (1, 2))[:, ::stride, ::stride]
    return np.tensordot(weight, windows, ((1, 2, 3), (0, 3, 4))) + bias[:, None, None]


def same(size: int, kernel: int, stride: int) -> tuple[int, int]:
    """Padding of TensorFlow's SAME: ceil(size / stride) outputs, the odd cell at the end."""
    total = max((math.ceil(size / stride) - 1) * stride + kernel - size, 0)
    return total // 2, total - total // 2


def max_pool(x: np.ndarray, kernel: int, stride: int, rule: str) -> np.ndarray:
    """Caffe: as many windows as touch the image, none starting beyond it; stride 1 always pads one cell."""
    pad = []
    for size in x.shape[1:]:
        if rule == "same" or stride == 1:
            pad.append(same(size, kernel, stride))
        else:
            outputs = max(math.ceil((size - kernel) / stride) + 1, 1)
            pad.append((0, max((outputs - 1) * stride + kernel - size, 0)))
    x = np.pad(x, ((0, 0), *pad), constant_values=-np.inf)
    return sliding_window_view(x, (kernel, kernel), (1, 2))[:, ::stride, ::stride].max((3, 4))


def caffe_lrn(x: np.ndarray, size: int, alpha: float, beta: float) -> np.ndarray:
    """Caffe: x / (1 + alpha / size · Σ x²)^beta over `size` channels."""
    return tensorflow_lrn(x, depth_radius=size // 2, bias=1.0, alpha=alpha / size, beta=beta)


def tensorflow_lrn(x: np.ndarray, depth_radius: int, bias: float, alpha: float, beta: float) -> np.ndarray:
    """TensorFlow: x / (bias + alpha · Σ x²)^beta over 2 · depth_radius + 1 channels."""
    y = np.empty_like(x)
    for channel in range(len(x)):
        window = x[max(channel - depth_radius, 0) : channel + depth_radius + 1]
        y[channel] = x[channel] / (bias + alpha * (window**2).sum(0)) ** beta
    return y


INCEPTION5H_LRN = {"depth_radius": 5, "bias": 2.0, "alpha": 1e-4, "beta": 0.5}


def features(
    tensors: dict[str, np.ndarray],
    image: np.ndarray,
    flavour: str,
    stride: int,
    norms: tuple[dict, dict] = (INCEPTION5H_LRN, INCEPTION5H_LRN),
    batch_norm: dict[str, np.ndarray] | None = None,
) -> dict[str, np.ndarray]:
    """Every layer for an image (3, H, W) in 0..1; `batch_norm` is torchvision's state dict."""
    tensors = {name: tensor.astype(np.float64) for name, tensor in tensors.items()}
    rule = "same" if flavour == "inception5h" else "caffe"
    values: dict[str, np.ndarray] = {}

    def layer(name: str, x: np.ndarray, stride: int = 1) -> np.ndarray:
        y = convolve(x, tensors[f"{name}.weight"], tensors[f"{name}.bias"], rule, stride)
        if batch_norm is not None:
            y = normalise(y - tensors[f"{name}.bias"][:, None, None], batch_norm, torchvision_name(name))
        return y

    def relu(x: np.ndarray) -> np.ndarray:
        return np.maximum(x, 0)

    def norm(x: np.ndarray, index: int) -> np.ndarray:
        if flavour == "bvlc":
            return caffe_lrn(x, 5, 1e-4, 0.75)
        return tensorflow_lrn(x, **norms[index]) if flavour == "inception5h" else x

    x = values["conv1/7x7_s2"] = relu(layer("conv1/7x7_s2", prepare(image.astype(np.float64), flavour), stride))
    x = norm(max_pool(x, 3, 2, rule), 0)
    x = values["conv2/3x3_reduce"] = relu(layer("conv2/3x3_reduce", x))
    x = values["conv2/3x3"] = relu(layer("conv2/3x3", x))
    x = max_pool(norm(x, 1), 3, 2, rule)
    for block in BLOCKS:
        name = f"inception_{block}"
        if block == "4a":
            x = max_pool(x, 3, 2, rule)
        if block == "5a":
            x = max_pool(x, 2 if flavour == "torchvision" else 3, 2, rule)
        branches = {branch: layer(f"{name}/{branch}", x) for branch in ("1x1", "3x3_reduce", "5x5_reduce")}
        branches["3x3"] = layer(f"{name}/3x3", relu(branches["3x3_reduce"]))
        branches["5x5"] = layer(f"{name}/5x5", relu(branches["5x5_reduce"]))
        branches["pool_proj"] = layer(f"{name}/pool_proj", max_pool(x, 3, 1, rule))
        values |= {f"{name}/{branch}": value for branch, value in branches.items()}
        x = relu(np.concatenate([branches[branch] for branch in ("1x1", "3x3", "5x5", "pool_proj")]))
        values[f"{name}/output"] = x
    values["logits"] = tensors["loss3/classifier.weight"] @ x.mean((1, 2)) + tensors["loss3/classifier.bias"]
    return values


def prepare(image: np.ndarray, flavour: str) -> np.ndarray:
    """What each network was trained on."""
    if flavour == "bvlc":
        return 255 * image[::-1] - np.array([104.0, 117.0, 123.0])[:, None, None]
    if flavour in ("inception5h", "patterns"):
        return 255 * image - 117
    mean, deviation = np.array([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]])[:, :, None, None]
    normalised = (image - mean) / deviation
    return normalised * (deviation / 0.5) + (mean - 0.5) / 0.5  # transform_input=True


def normalise(y: np.ndarray, state: dict[str, np.ndarray], name: str) -> np.ndarray:
    """Batch normalisation with running statistics."""
    parts = ("weight", "bias", "running_mean", "running_var")
    gamma, beta, mean, variance = (state[f"{name}.bn.{part}"].astype(np.float64)[:, None, None] for part in parts)
    return (y - mean) / np.sqrt(variance + BATCH_NORM_EPSILON) * gamma + beta


def torchvision_name(layer: str) -> str:
    """`inception_4b/pool_proj` → `inception4b.branch4.1`."""
    stem = {"conv1/7x7_s2": "conv1", "conv2/3x3_reduce": "conv2", "conv2/3x3": "conv3"}
    if layer in stem:
        return stem[layer]
    block, branch = layer.split("/")
    numbers = {
        "1x1": "1",
        "3x3_reduce": "2.0",
        "3x3": "2.1",
        "5x5_reduce": "3.0",
        "5x5": "3.1",
        "pool_proj": "4.1",
    }
    return f"{block.replace('_', '')}.branch{numbers[branch]}"

"""Train the network that ships with the package, a GoogLeNet that tells families of drawn motifs apart.

    python scripts/train_patterns.py train [--pictures 356000] [--minutes 110]
    python scripts/train_patterns.py export
    python scripts/train_patterns.py evaluate
    python scripts/train_patterns.py figures

`train` goes on from its last checkpoint and stops when the pictures or the minutes are used up. Pictures are drawn on
the fly from consecutive seeds, so none is seen twice. `export` folds the batch normalisations into the convolutions
and writes the 8-bit file of the package. `evaluate` measures that file on pictures with unseen seeds; `figures` draws
one picture of each family, and the training curve, for docs/patterns.md.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import time
from pathlib import Path

import torch
import torch.nn.functional as F
from matplotlib.figure import Figure
from motifs import FAMILIES, draw
from motifs.canvas import blur
from PIL import Image, ImageDraw
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader, Dataset
from tqdm import tqdm

from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.network.readers.network_weights import (
    BLOCKS,
    BRANCH_LAYERS,
    CLASSIFIER,
    CONCATENATED,
    CONVOLUTIONS,
    STEM,
    NetworkWeights,
)
from tnst_mi.network.readers.quantised import write_quantised

CHECKOUT = Path(__file__).resolve().parents[1]
SHIPPED = CHECKOUT / "tnst_mi" / "data" / "googlenet_patterns.safetensors"
STATE = CHECKOUT / "build" / "patterns"
IMAGES = CHECKOUT / "docs" / "images"

SIZE = 64
"""Width and height of a drawn picture, in pixels."""
CROP = 48
"""What is shown of it while the learning rate is constant; all of it is shown while the rate falls."""
COPIES = 4
"""Pictures of each family on a sheet, which is one draw of all families."""
BATCH = 64
LEARNING_RATE = 1.5e-3
WEIGHT_DECAY = 0.05
WARM_UP = 500
"""Steps until the learning rate has risen to its full value."""
DECAY = 0.35
"""Fraction of the training, at its end, over which the learning rate falls to zero."""
NORM_MOMENTUM = 0.01
"""Share of a batch in the running statistics of the batch normalisations, which are those of both strides."""
FREEZE = 0.2
"""Fraction of the training, at its end, with fixed statistics of the batch normalisations."""
BODY_RADIUS = 8.0
"""Radius in pixels of the blur that leaves a body of smoke without its motif."""
LARGEST_PERTURBATION = 0.06
"""Greatest root mean square of what is added to a picture to mislead the network, while the rate falls."""
LABEL_SMOOTHING = 0.05
AVERAGE = 0.998
"""Decay of the exponential average of the weights, which is what is measured and shipped."""
UNSEEN = 1 << 40
"""Sheets from this number on are never trained on."""
CHECKPOINT_SECONDS = 240.0

STEM_WIDTHS = {"conv1/7x7_s2": (64, 7), "conv2/3x3_reduce": (64, 1), "conv2/3x3": (192, 3)}
"""Channels and kernel size of the first three convolutions."""
BLOCK_WIDTHS = (
    (64, 96, 128, 16, 32, 32),
    (128, 128, 192, 32, 96, 64),
    (192, 96, 208, 16, 48, 64),
    (160, 112, 224, 24, 64, 64),
    (128, 128, 256, 24, 64, 64),
    (112, 144, 288, 32, 64, 64),
    (256, 160, 320, 32, 128, 128),
    (256, 160, 320, 32, 128, 128),
    (384, 192, 384, 48, 128, 128),
)
"""Channels of each inception block's convolutions, in the order of `BRANCH_LAYERS` (Szegedy et al. 2015, table 1)."""


class Sheets(Dataset[tuple[Tensor, Tensor]]):
    """Sheet after sheet of pictures (families * COPIES, 3, SIZE, SIZE), uint8, and their classes, shuffled."""

    def __init__(self, first: int, count: int) -> None:
        """`count` sheets from number `first` on; the number decides what is drawn."""
        self.first, self.count = first, count

    def __len__(self) -> int:
        """Number of sheets."""
        return self.count

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        """One sheet."""
        seed = (self.first + index) * len(FAMILIES)
        pictures = torch.cat([draw(kind, COPIES, SIZE, seed + number) for number, kind in enumerate(FAMILIES)])
        classes = torch.arange(len(FAMILIES)).repeat_interleave(COPIES)
        order = torch.randperm(len(classes), generator=torch.Generator().manual_seed(seed))
        return (pictures[order] * 255.0).round().to(torch.uint8), classes[order]


# --- The network while it is trained ---


def random_weights() -> NetworkWeights:
    """Weights of He et al. (2015) for ReLU networks, as many classes as there are families."""
    tensors: dict[str, Tensor] = {}

    def add(layer: str, outputs: int, inputs: int, kernel: int) -> None:
        deviation = math.sqrt(2.0 / (inputs * kernel**2))
        tensors[f"{layer}.weight"] = deviation * torch.randn(outputs, inputs, kernel, kernel)
        tensors[f"{layer}.bias"] = torch.zeros(outputs)

    channels = 3
    for layer, (width, kernel) in STEM_WIDTHS.items():
        add(layer, width, channels, kernel)
        channels = width
    for block, widths in zip(BLOCKS, BLOCK_WIDTHS, strict=True):
        width = dict(zip(BRANCH_LAYERS, widths, strict=True))
        for layer in BRANCH_LAYERS:
            inputs = width[f"{layer}_reduce"] if layer in ("3x3", "5x5") else channels
            add(f"{block}/{layer}", width[layer], inputs, int(layer[0]) if layer in ("3x3", "5x5") else 1)
        channels = sum(width[layer] for layer in CONCATENATED)
    tensors[f"{CLASSIFIER}.weight"] = 0.01 * torch.randn(len(FAMILIES), channels)
    tensors[f"{CLASSIFIER}.bias"] = torch.zeros(len(FAMILIES))
    return NetworkWeights("patterns", tensors, class_names=tuple(", ".join(kind.names) for kind in FAMILIES))


def trainable_network() -> GoogLeNet:
    """The package's own GoogLeNet with random weights and a batch normalisation behind each convolution."""
    network = GoogLeNet(random_weights(), stride1=False)
    for layer in CONVOLUTIONS:
        convolution = network.convolutions[layer]
        convolution.bias = None
        norm = nn.BatchNorm2d(convolution.out_channels, momentum=NORM_MOMENTUM)
        network.convolutions[layer] = nn.Sequential(convolution, norm)
    return network.requires_grad_(True).train()


def folded(network: GoogLeNet) -> NetworkWeights:
    """The weights of a trained network, each batch normalisation multiplied into the convolution before it."""
    tensors = {}
    for layer in CONVOLUTIONS:
        convolution, norm = network.convolutions[layer]
        gain = norm.weight / torch.sqrt(norm.running_var + norm.eps)
        tensors[f"{layer}.weight"] = (convolution.weight * gain[:, None, None, None]).detach().contiguous()
        tensors[f"{layer}.bias"] = (norm.bias - norm.running_mean * gain).detach()
    tensors[f"{CLASSIFIER}.weight"] = network.classifier.weight.detach()
    tensors[f"{CLASSIFIER}.bias"] = network.classifier.bias.detach()
    return NetworkWeights("patterns", tensors, class_names=tuple(network.class_names))


def logits(network: GoogLeNet, pictures: Tensor, stride: int) -> Tensor:
    """Logits of pictures in 0 to 1 at either stride of the first convolution.

    At stride 1, the package's default, the pictures are halved first: the features then have the size, and the
    motifs the extent in them, that stride 2 gives. A network that has seen both is at home with either.
    """
    stem = network.convolutions[STEM[0]]
    (stem[0] if isinstance(stem, nn.Sequential) else stem).stride = (stride, stride)
    return network(F.avg_pool2d(pictures, 2) if stride == 1 else pictures, ["logits"])["logits"]


# --- Training ---


def faded(x: Tensor, generator: torch.Generator) -> Tensor:
    """Pictures (N, 3, H, W), half of them faded towards a blur that shows no motif, down to a tenth of their contrast.

    A smooth body of smoke on its way to a motif looks like that. A network that has seen only plain motifs says nothing
    of what would make such a body more like one; this one's gradients there point to the motif.
    """
    body = blur(x.flatten(0, 1), BODY_RADIUS).reshape(x.shape)
    fading = (2.0 * torch.rand(len(x), 1, 1, 1, generator=generator) - 1.0).clamp(min=0.0)
    return body + 10.0**-fading * (x - body)


def misleading(network: GoogLeNet, x: Tensor, classes: Tensor, stride: int, generator: torch.Generator) -> Tensor:
    """Pictures (N, 3, H, W) changed a little, in the direction that raises the loss most; a third not at all.

    A network that withstands this is steered by shapes and not by faint textures (Tsipras et al. 2019, Robustness May
    Be at Odds with Accuracy): its gradients with respect to the picture show what a person would look for. The change
    is grey and blurred, as changes of smoke are.
    """
    x.requires_grad_()
    (gradient,) = torch.autograd.grad(F.cross_entropy(logits(network, x, stride), classes, reduction="sum"), x)
    direction = blur(gradient.mean(1), 1.0)
    direction = direction / direction.square().mean((1, 2), keepdim=True).sqrt().clamp(min=1e-12)
    span = torch.rand(len(x), 1, 1, generator=generator)
    amplitude = LARGEST_PERTURBATION * (1.5 * span - 0.5).clamp(min=0.0)
    return (x.detach() + (amplitude * direction)[:, None]).clamp(0.0, 1.0)


def learning_rate(step: int, steps: int) -> float:
    """Fraction of the full rate: a short rise, a plateau, and a straight fall to zero.

    As the plateau does not depend on the length of the training, an interrupted one can be made longer.
    """
    return min((step + 1) / WARM_UP, 1.0, (steps - step) / (DECAY * steps))


def train(pictures: int, minutes: float) -> None:
    """Train until this many pictures have been seen in all, or for this long, whichever comes first."""
    torch.manual_seed(0)
    network = trainable_network()
    average = AveragedModel(network, multi_avg_fn=get_ema_multi_avg_fn(AVERAGE), use_buffers=True)
    weights = [parameter for parameter in network.parameters() if parameter.ndim > 1]
    vectors = [parameter for parameter in network.parameters() if parameter.ndim == 1]
    groups = [{"params": weights, "weight_decay": WEIGHT_DECAY}, {"params": vectors, "weight_decay": 0.0}]
    optimiser = torch.optim.AdamW(groups, lr=LEARNING_RATE, fused=True)
    parts = {"network": network, "average": average, "optimiser": optimiser}
    first = restore(parts)
    per_sheet = COPIES * len(FAMILIES)
    sheets, steps_per_sheet = math.ceil(pictures / per_sheet), per_sheet // BATCH
    steps, started, saved = sheets * steps_per_sheet, time.monotonic(), time.monotonic()
    frozen = round((1.0 - FREEZE) * steps)
    network.train(first * steps_per_sheet <= frozen)
    losses: list[float] = []
    loader = DataLoader(Sheets(first, sheets - first), batch_size=None, num_workers=1, prefetch_factor=4)
    bar = tqdm(enumerate(loader, first), total=sheets, initial=first, unit="sheet", mininterval=5.0)
    for sheet, (images, classes) in bar:
        crops = torch.Generator().manual_seed(sheet)
        for part, (x, y) in enumerate(zip(images.split(BATCH), classes.split(BATCH), strict=True)):
            step = sheet * steps_per_sheet + part
            rate = learning_rate(step, steps)
            for group in optimiser.param_groups:
                group["lr"] = rate * LEARNING_RATE
            if step < (1.0 - DECAY) * steps:
                top, left = torch.randint(SIZE - CROP + 1, (2,), generator=crops).tolist()
                x = x[:, :, top : top + CROP, left : left + CROP]
            if step == frozen:
                measure_statistics(network)
                network.eval()
                for fixed, statistic in zip(average.module.buffers(), network.buffers(), strict=True):
                    fixed.copy_(statistic)
            x = x.float() / 255.0
            if step >= (1.0 - DECAY) * steps:
                x = faded(x, crops)
                if part < steps_per_sheet // 2:
                    x = misleading(network, x, y, 1 + step % 2, crops)
            loss = F.cross_entropy(logits(network, x, 1 + step % 2), y, label_smoothing=LABEL_SMOOTHING)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            average.update_parameters(network)
            losses.append(loss.item())
        now, last = time.monotonic(), sheet + 1 == sheets
        if last or now - saved > CHECKPOINT_SECONDS or now - started > 60.0 * minutes:
            report = {"pictures": (sheet + 1) * per_sheet, "loss": sum(losses) / len(losses), "rate": rate}
            report |= {f"top1_stride{s}": accuracy(average.module, s, 1)[0] for s in (1, 2)}
            save(parts, sheet + 1, report)
            bar.set_postfix_str(f"loss {report['loss']:.3f}, top-1 {report['top1_stride1']:.1%}")
            losses, saved = [], now
            if now - started > 60.0 * minutes:
                break


@torch.no_grad()
def measure_statistics(network: GoogLeNet, sheets: int = 4) -> None:
    """Set the statistics of all batch normalisations to the mean over whole pictures at both strides.

    Trained on with these fixed, the network is at its best with what will be folded into it: the statistics that it has
    seen so far were those of the batch, at one stride, and the running ones lag behind the weights.
    """
    norms = [module for module in network.modules() if isinstance(module, nn.BatchNorm2d)]
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None  # the mean of all batches
    network.train()
    for images, _ in DataLoader(Sheets(0, sheets), batch_size=None):
        for number, x in enumerate(images.split(BATCH)):
            logits(network, x.float() / 255.0, 1 + number % 2)
    for norm in norms:
        norm.momentum = NORM_MOMENTUM


def save(parts: dict[str, nn.Module | torch.optim.Optimizer], sheets: int, report: dict[str, float]) -> None:
    """Write a checkpoint in place of the last one, and a line of the training's history."""
    STATE.mkdir(parents=True, exist_ok=True)
    beside = STATE / "checkpoint.pt.part"
    torch.save({"sheets": sheets} | {name: part.state_dict() for name, part in parts.items()}, beside)
    os.replace(beside, STATE / "checkpoint.pt")
    with (STATE / "history.jsonl").open("a") as file:
        file.write(json.dumps(report) + "\n")


def restore(parts: dict[str, nn.Module | torch.optim.Optimizer]) -> int:
    """Load the last checkpoint, if there is one; the number of sheets it has seen."""
    path = STATE / "checkpoint.pt"
    if not path.exists():
        return 0
    state = torch.load(path, weights_only=True)
    for name, part in parts.items():
        part.load_state_dict(state[name])
    return state["sheets"]


# --- What came of it ---


@torch.no_grad()
def accuracy(network: GoogLeNet, stride: int, sheets: int) -> tuple[float, Tensor]:
    """Top-1 accuracy on sheets with unseen seeds, and the confusion matrix (true, predicted)."""
    was_training = network.training
    network.eval()
    confusion = torch.zeros(len(FAMILIES), len(FAMILIES), dtype=torch.int64)
    for images, classes in DataLoader(Sheets(UNSEEN, sheets), batch_size=None):
        for x, y in zip(images.split(BATCH), classes.split(BATCH), strict=True):
            predicted = logits(network, x.float() / 255.0, stride).argmax(1)
            confusion.index_put_((y, predicted), torch.ones_like(y), accumulate=True)
    network.train(was_training)
    return (confusion.trace() / confusion.sum()).item(), confusion


def export() -> None:
    """Write the averaged weights of the last checkpoint as the package's file."""
    network = trainable_network()
    average = AveragedModel(network, use_buffers=True)
    if restore({"average": average}) == 0:
        raise SystemExit(f"{STATE / 'checkpoint.pt'}: no checkpoint; run `train` first")
    weights = folded(average.module)
    write_quantised(SHIPPED, weights)
    print(f"{SHIPPED}: {SHIPPED.stat().st_size / 1e6:.2f} MB")
    exact, shipped = GoogLeNet(weights), GoogLeNet.load(SHIPPED)
    images = Sheets(UNSEEN, 1)[0][0][:32].float() / 255.0
    for layer in ("conv2/3x3", *(f"{block}/output" for block in BLOCKS), "logits"):
        expected, found = (net(images, [layer])[layer] for net in (exact, shipped))
        difference = ((found - expected).norm() / expected.norm()).item()
        print(f"{layer:22} relative difference of the 8-bit weights' features to float32's {difference:.2%}")


def evaluate(sheets: int) -> None:
    """Print the accuracy of the package's file on pictures with unseen seeds, and what it confuses."""
    network = GoogLeNet.load(SHIPPED)
    for stride in (1, 2):
        top1, confusion = accuracy(network, stride, sheets)
        print(f"stride {stride}: top-1 {top1:.2%} of {confusion.sum()} pictures")
        recall = confusion.diag() / confusion.sum(1)
        for number in recall.argsort()[:8].tolist():
            mistakes = confusion[number].clone()
            mistakes[number] = 0
            other = FAMILIES[int(mistakes.argmax())].name
            print(f"    {FAMILIES[number].name:14} {recall[number]:.0%}, taken for {other} {mistakes.max()} times")


def figures() -> None:
    """Draw the contact sheet and the training curve for docs/patterns.md."""
    size, columns, margin, caption = 128, 8, 4, 14
    rows = math.ceil(len(FAMILIES) / columns)
    sheet = Image.new("L", (columns * (size + margin), rows * (size + margin + caption)), 255)
    pen = ImageDraw.Draw(sheet)
    for number, kind in enumerate(FAMILIES):
        left, top = number % columns * (size + margin), number // columns * (size + margin + caption)
        # At its smallest and almost upright: most of it is in view.
        shown = dataclasses.replace(kind, span=(kind.span[1],) * 2, tilt=min(kind.tilt, 0.3))
        picture = draw(shown, 1, size, UNSEEN + number, shaded=False)[0, 0]
        sheet.paste(Image.fromarray((picture * 255.0).round().to(torch.uint8).numpy()), (left, top + caption))
        pen.text((left, top), kind.name, fill=0)
    sheet.save(IMAGES / "patterns_families.png", optimize=True)
    history = [json.loads(line) for line in (STATE / "history.jsonl").read_text().splitlines()]
    seen = [report["pictures"] / 1000 for report in history]
    figure = Figure(figsize=(6, 3), layout="constrained")
    axes = figure.add_subplot(xlabel="pictures seen (thousands)", ylabel="top-1, unseen seeds", ylim=(0, 1))
    for stride in (1, 2):
        axes.plot(seen, [report[f"top1_stride{stride}"] for report in history], label=f"stride {stride}")
    axes.legend()
    figure.savefig(IMAGES / "patterns_curve.png", dpi=100)


def main() -> None:
    """Run the subcommand given on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    training = commands.add_parser("train")
    training.add_argument("--pictures", type=int, default=356_000, help="length of the whole training (default 356000)")
    training.add_argument("--minutes", type=float, default=110.0, help="stop after this long (default 110)")
    commands.add_parser("export")
    evaluation = commands.add_parser("evaluate")
    evaluation.add_argument("--sheets", type=int, default=16, help=f"sheets of {COPIES} of each family (default 16)")
    commands.add_parser("figures")
    arguments = vars(parser.parse_args())
    {"train": train, "export": export, "evaluate": evaluate, "figures": figures}[arguments.pop("command")](**arguments)


if __name__ == "__main__":
    main()

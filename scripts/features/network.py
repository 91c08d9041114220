"""The compact network, its training on single frames, and its probes."""

# torch is not installed where types are checked.
# pyright: basic, reportMissingImports=false, reportCallIssue=false

import copy
import itertools
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

MEAN = (0.45, 0.45, 0.45)
STD = (0.25, 0.25, 0.25)
PLACES = 9
"""3 x 3 of them are left of 48 x 48 pixels."""
THUMBNAIL_PX = 12
"""Side of the picture that training paints from the features."""


class Block(nn.Module):
    """He and others' basic block (2015): two 3x3 convolutions beside an identity."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        """A block that shrinks both sides by `stride`."""
        super().__init__()
        self.first = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.first_norm = nn.BatchNorm2d(outputs)
        self.second = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.second_norm = nn.BatchNorm2d(outputs)
        self.aside = nn.Identity()
        if stride != 1 or inputs != outputs:
            self.aside = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs)
            )

    def forward(self, x: Tensor) -> Tensor:
        """`[N, inputs, H, W]` -> `[N, outputs, H / stride, W / stride]`."""
        y = functional.relu(self.first_norm(self.first(x)))
        return functional.relu(self.second_norm(self.second(y)) + self.aside(x))


class CompactResNet(nn.Module):
    """A stem of stride 2, four stages of two basic blocks each, and a few channels of each place.

    No mean over places: what is wanted of the features is where the lane lies.
    """

    def __init__(self, width: int = 16) -> None:
        """Random weights; `width` channels at first, eight times as many before the last layer."""
        super().__init__()
        self.size = PLACES * width
        self.stem = nn.Sequential(
            nn.Conv2d(3, width, 3, 2, 1, bias=False), nn.BatchNorm2d(width), nn.ReLU()
        )
        channels = [width, width, 2 * width, 4 * width, 8 * width]
        self.stages = nn.Sequential(
            *(
                nn.Sequential(Block(before, after, 1 if stage == 0 else 2), Block(after, after, 1))
                for stage, (before, after) in enumerate(itertools.pairwise(channels))
            )
        )

        self.last = nn.Sequential(nn.Conv2d(8 * width, width, 1, bias=False), nn.BatchNorm2d(width))

    def forward(self, x: Tensor) -> Tensor:
        """`[N, 3, 48, 48]`, preprocessed -> `[N, 9 * width]`."""
        return self.last(self.stages(self.stem(x))).flatten(1)


def preprocess(pixels: NDArray[np.uint8]) -> Tensor:
    """`[N, H, W, 3]` within 0 to 255 -> `[N, 3, H, W]`, as the model's metadata state it."""
    unit = torch.from_numpy(pixels).permute(0, 3, 1, 2).float() / 255
    return normalize(unit)


def normalize(unit: Tensor) -> Tensor:
    """`[N, 3, H, W]` within 0 to 1 -> about zero mean and unit variance."""
    return (unit - torch.tensor(MEAN)[:, None, None]) / torch.tensor(STD)[:, None, None]


def augment(unit: Tensor, generator: torch.Generator) -> Tensor:
    """Each frame in another light: colours, haze, blur, noise. `[N, 3, H, W]` within 0 to 1.

    Nothing is moved: where things are in the picture is what there is to learn.
    """
    n = len(unit)

    def draw(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(n, *shape, generator=generator)

    # Colours: each channel's brightness, contrast, saturation.
    x = unit * draw(0.6, 1.5, 1, 1, 1) * draw(0.75, 1.25, 3, 1, 1)
    middle = x.mean((1, 2, 3), keepdim=True)
    x = middle + (x - middle) * draw(0.6, 1.3, 1, 1, 1)
    grey = x.mean(1, keepdim=True)
    x = grey + (x - grey) * draw(0.0, 1.5, 1, 1, 1)
    # Haze, thickest at the horizon.
    rows = torch.arange(unit.shape[2])[None, None, :, None]
    thickness = draw(0, 0.4, 1, 1, 1) * torch.exp(-(((rows - 24) / draw(4, 20, 1, 1, 1)) ** 2))
    x = x + thickness * (draw(0.4, 1, 1, 1, 1) - x)
    # Blur by a 3x3 binomial, more or less of it.
    kernel = torch.tensor([1.0, 2.0, 1.0])
    kernel = (kernel[:, None] * kernel / 16).expand(3, 1, 3, 3)
    blurred = functional.conv2d(functional.pad(x, (1, 1, 1, 1), "replicate"), kernel, groups=3)
    x = x + draw(0, 0.7, 1, 1, 1) * (blurred - x)
    x = x + draw(0, 0.04, 1, 1, 1) * torch.randn(x.shape, generator=generator)
    return x.clamp(0, 1)


@dataclass(frozen=True)
class Recipe:
    """How to train."""

    width: int = 16
    epochs: int = 16
    batch: int = 128
    learning_rate: float = 4e-3
    weight_decay: float = 1e-3
    picture_share: float = 0.1
    """Of the loss: a linear layer paints the frame, 12 x 12, as it was before its light changed."""
    seed: int = 0


class Trainee(nn.Module):
    """The network with the two linear layers that only training has."""

    def __init__(self, recipe: Recipe, quantities: int) -> None:
        """Random weights."""
        super().__init__()
        self.network = CompactResNet(recipe.width)
        # Twice as fast on processors.
        self.network.to(memory_format=torch.channels_last)
        self.geometry = nn.Linear(self.network.size, quantities)
        self.picture = nn.Linear(self.network.size, 3 * THUMBNAIL_PX**2)

    def losses(self, unit: Tensor, shown: Tensor, generator: torch.Generator) -> tuple[Tensor, ...]:
        """Of geometry (`[N, quantities]` standardised, NaN: nothing there) and of the picture."""
        picture = normalize(augment(unit, generator)).contiguous(memory_format=torch.channels_last)
        # Convolutions in bfloat16 are twice as fast; what is compared is not rounded.
        with torch.autocast("cpu", torch.bfloat16):
            seen = self.network(picture)
        seen = seen.float()
        is_there = ~shown.isnan()
        misses = functional.smooth_l1_loss(
            self.geometry(seen), shown.nan_to_num(), beta=0.5, reduction="none"
        )
        # Each quantity counts the same, however seldom it is there.
        geometry = ((misses * is_there).sum(0) / is_there.sum(0).clamp(min=1)).mean()
        thumbnail = functional.avg_pool2d(normalize(unit), unit.shape[-1] // THUMBNAIL_PX)
        return geometry, functional.mse_loss(self.picture(seen), thumbnail.flatten(1))


def train(
    pixels: NDArray[np.uint8], shown: NDArray[np.float32], recipe: Recipe, checkpoint: Path
) -> Iterator[tuple[int, tuple[float, ...], CompactResNet]]:
    """Trains on single frames, one epoch after the other; goes on from `checkpoint` if it is there.

    Args:
        pixels: `[N, 48, 48, 3]`.
        shown: `[N, quantities]`, what there is to read in each; NaN where there is nothing.
        recipe: How.
        checkpoint: Written after every epoch.

    Yields:
        The epoch's number, its mean losses (geometry, picture), and the network as it stands.
    """
    torch.manual_seed(recipe.seed)
    trainee = Trainee(recipe, shown.shape[1])
    optimizer = torch.optim.AdamW(
        trainee.parameters(), recipe.learning_rate, weight_decay=recipe.weight_decay
    )
    per_epoch = len(pixels) // recipe.batch
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, recipe.learning_rate, total_steps=recipe.epochs * per_epoch, pct_start=0.15
    )
    parts = {"trainee": trainee, "optimizer": optimizer, "schedule": schedule}
    first = 0
    if checkpoint.exists():
        saved = torch.load(checkpoint, weights_only=True)
        if saved["recipe"] != asdict(recipe):
            raise SystemExit(f"{checkpoint} is of another recipe; remove it to start over")
        for name, part in parts.items():
            part.load_state_dict(saved[name])
        first = saved["epochs"]
        if first == recipe.epochs:
            yield first, (float("nan"),) * 2, trainee.network.eval()
    frames = torch.from_numpy(pixels).permute(0, 3, 1, 2).contiguous()
    quantities = torch.from_numpy((shown - np.nanmean(shown, 0)) / np.nanstd(shown, 0))
    for epoch in range(first, recipe.epochs):
        # Of the epoch alone, so that a run that was interrupted sees what it would have seen.
        generator = torch.Generator().manual_seed(recipe.seed * 1000 + epoch)
        order = torch.randperm(len(frames), generator=generator)
        trainee.train()
        total = np.zeros(2)
        for batch in order[: per_epoch * recipe.batch].view(per_epoch, -1):
            unit = frames[batch].float() / 255
            geometry, picture = trainee.losses(unit, quantities[batch], generator)
            optimizer.zero_grad(set_to_none=True)
            (geometry + recipe.picture_share * picture).backward()
            optimizer.step()
            schedule.step()
            total += geometry.item(), picture.item()
        torch.save(
            {name: part.state_dict() for name, part in parts.items()}
            | {"epochs": epoch + 1, "recipe": asdict(recipe)},
            checkpoint,
        )
        yield epoch + 1, tuple(total / per_epoch), copy.deepcopy(trainee.network).eval()


@torch.no_grad()
def features(network: nn.Module, pixels: NDArray[np.uint8]) -> NDArray[np.float64]:
    """`[N, H, W, 3]` -> `[N, D]`."""
    network.eval()
    batches = np.array_split(pixels, max(1, len(pixels) // 256))
    return np.concatenate([network(preprocess(batch)).numpy() for batch in batches]).astype(float)


def probe(
    fit: tuple[NDArray[np.float64], NDArray[np.float64]],
    held_out: tuple[NDArray[np.float64], NDArray[np.float64]],
    ridge: float = 1e-3,
) -> float:
    """R² of a linear regression on held-out rows. Features are standardised; ridge · N."""
    (x, y), (x_new, y_new) = fit, held_out
    mean, deviation = x.mean(0), x.std(0) + 1e-9
    x, x_new = (x - mean) / deviation, (x_new - mean) / deviation
    y_mean = y.mean()
    gram = x.T @ x + ridge * len(x) * np.eye(x.shape[1])
    weights = np.linalg.solve(gram, x.T @ (y - y_mean))
    residual = y_new - y_mean - x_new @ weights
    return float(1 - residual.var() / y_new.var())

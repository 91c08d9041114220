"""The compact network, its training without labels, and its probes."""

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
    """Another view of each frame: crop, colours, haze, blur, noise. `[N, 3, H, W]` within 0 to 1.

    Crops are tight (a pixel and a half, and 5 % of size): what is wanted of the features is where
    the lane lies, and a network that is taught to ignore places cannot tell.
    """
    n = len(unit)

    def draw(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(n, *shape, generator=generator)

    # Crop.
    theta = torch.zeros(n, 2, 3)
    zoom = draw(0.95, 1.05)
    theta[:, 0, 0], theta[:, 1, 1] = zoom, zoom
    theta[:, :, 2] = draw(-1.5, 1.5, 2) * 2 / unit.shape[-1]
    grid = functional.affine_grid(theta, list(unit.shape), align_corners=False)
    x = functional.grid_sample(unit, grid, padding_mode="border", align_corners=False)
    # Colours: each channel's brightness, contrast, saturation.
    x = x * draw(0.6, 1.5, 1, 1, 1) * draw(0.75, 1.25, 3, 1, 1)
    middle = x.mean((1, 2, 3), keepdim=True)
    x = middle + (x - middle) * draw(0.5, 1.4, 1, 1, 1)
    grey = x.mean(1, keepdim=True)
    x = grey + (x - grey) * draw(0.0, 1.5, 1, 1, 1)
    # Haze, thickest at the horizon.
    rows = torch.arange(unit.shape[2])[None, None, :, None]
    thickness = draw(0, 0.6, 1, 1, 1) * torch.exp(-(((rows - 24) / draw(4, 20, 1, 1, 1)) ** 2))
    x = x + thickness * (draw(0.4, 1, 1, 1, 1) - x)
    # Blur by a 3x3 binomial, more or less of it.
    kernel = torch.tensor([1.0, 2.0, 1.0])
    kernel = (kernel[:, None] * kernel / 16).expand(3, 1, 3, 3)
    blurred = functional.conv2d(functional.pad(x, (1, 1, 1, 1), "replicate"), kernel, groups=3)
    x = x + draw(0, 1, 1, 1, 1) * (blurred - x)
    x = x + draw(0, 0.05, 1, 1, 1) * torch.randn(x.shape, generator=generator)
    return x.clamp(0, 1)


@dataclass(frozen=True)
class Recipe:
    """How to train."""

    width: int = 16
    epochs: int = 6
    batch: int = 128
    learning_rate: float = 2e-3
    weight_decay: float = 1e-4
    projection: int = 256
    """Width of the layers that only training has."""
    invariance: float = 25.0
    variance: float = 25.0
    covariance: float = 1.0
    seed: int = 0


def vicreg(a: Tensor, b: Tensor, recipe: Recipe) -> Tensor:
    """Bardes, Ponce, LeCun: VICReg (2022), its equation (6), of two views' projections `[N, P]`."""
    n, width = a.shape
    loss = recipe.invariance * functional.mse_loss(a, b)
    for view in (a, b):
        deviation = torch.sqrt(view.var(0) + 1e-4)
        loss = loss + recipe.variance * functional.relu(1 - deviation).mean() / 2
        centred = view - view.mean(0)
        covariance = centred.T @ centred / (n - 1)
        off_diagonal = covariance.square().sum() - covariance.diagonal().square().sum()
        loss = loss + recipe.covariance * off_diagonal / width
    return loss


def train(
    pixels: NDArray[np.uint8], recipe: Recipe, checkpoint: Path
) -> Iterator[tuple[int, float, CompactResNet]]:
    """Trains on single frames, one epoch after the other; goes on from `checkpoint` if it is there.

    Yields:
        The epoch's number, its mean loss, and the network as it stands.
    """
    torch.manual_seed(recipe.seed)
    network = CompactResNet(recipe.width)
    # Twice as fast on processors.
    network.to(memory_format=torch.channels_last)
    wide = recipe.projection
    head = nn.Sequential(
        nn.Linear(network.size, wide, bias=False),
        nn.BatchNorm1d(wide),
        nn.ReLU(),
        nn.Linear(wide, wide, bias=False),
        nn.BatchNorm1d(wide),
        nn.ReLU(),
        nn.Linear(wide, wide, bias=False),
    )
    parameters = [*network.parameters(), *head.parameters()]
    optimizer = torch.optim.AdamW(
        parameters, recipe.learning_rate, weight_decay=recipe.weight_decay
    )
    per_epoch = len(pixels) // recipe.batch
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, recipe.learning_rate, total_steps=recipe.epochs * per_epoch, pct_start=0.1
    )
    parts = {"network": network, "head": head, "optimizer": optimizer, "schedule": schedule}
    first = 0
    if checkpoint.exists():
        saved = torch.load(checkpoint, weights_only=True)
        if saved["recipe"] != asdict(recipe):
            raise SystemExit(f"{checkpoint} is of another recipe; remove it to start over")
        for name, part in parts.items():
            part.load_state_dict(saved[name])
        first = saved["epochs"]
    frames = torch.from_numpy(pixels).permute(0, 3, 1, 2).contiguous()
    for epoch in range(first, recipe.epochs):
        # Of the epoch alone, so that a run that was interrupted sees what it would have seen.
        generator = torch.Generator().manual_seed(recipe.seed * 1000 + epoch)
        order = torch.randperm(len(frames), generator=generator)
        network.train()
        total = 0.0
        for batch in order[: per_epoch * recipe.batch].view(per_epoch, -1):
            unit = frames[batch].float() / 255
            views = [normalize(augment(unit, generator)) for _ in range(2)]
            pictures = torch.cat(views).contiguous(memory_format=torch.channels_last)
            # Convolutions in bfloat16 are twice as fast; what is compared is not rounded.
            with torch.autocast("cpu", torch.bfloat16):
                features_of_both = network(pictures)
            projected = head(features_of_both.float())
            loss = vicreg(*projected.chunk(2), recipe)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
            schedule.step()
            total += float(loss.detach())
            if schedule.last_epoch % 50 == 0:
                print(f"step {schedule.last_epoch}: loss {float(loss.detach()):.3f}", flush=True)
        torch.save(
            {name: part.state_dict() for name, part in parts.items()}
            | {"epochs": epoch + 1, "recipe": asdict(recipe)},
            checkpoint,
        )
        yield epoch + 1, total / per_epoch, copy.deepcopy(network).eval()


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

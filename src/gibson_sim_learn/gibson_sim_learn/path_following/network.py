"""The path-following network: relative pose of a recorded image, match probability, and a first estimate of free distances.

One small encoder computes features of both images. An all-pairs correlation gives the position in the recorded image of each position of the
present one; a few convolutions turn that into a pose. Its free distances, from the present image alone, are for the drives of DAgger; the network
of ``distances`` then replaces them.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from gibson_sim_learn.path_following.data import DIRECTIONS, FREE_EDGES
from gibson_sim_learn.path_following.drawing import HEIGHT, WIDTH

_ROWS, _COLUMNS = HEIGHT // 4, WIDTH // 4
"""Size of the features."""
_DROPOUT = 0.15
"""Dropout probability of the features before the head of free distances."""


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """Size of the network."""

    channels: int = 48
    """Channels of the features."""
    compared: int = 32
    """Channels of the correlated features."""
    joint: int = 64
    """Channels of the layers after the correlation."""
    free: int = 96
    """Channels of the head of free distances."""
    hidden: int = 128
    """Neurons of the last hidden layer."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Outputs for B pairs."""

    pose: Tensor
    """(B, 3): pose of the recorded camera in the present camera's frame: x ahead, y to the left, yaw; metres and radians."""
    scale: Tensor
    """(B, 3): predicted mean absolute error, same units."""
    match: Tensor
    """(B,): log-odds that both images show the same place."""


class PathNetwork(nn.Module):
    """Encoder, correlation and two heads."""

    def __init__(self, settings: NetworkSettings = NetworkSettings()) -> None:
        super().__init__()
        c, joint = settings.channels, settings.joint
        if _COLUMNS != DIRECTIONS:
            raise AssertionError("one bearing for each column of the features")
        self.encoder = nn.Sequential(
            convolution(3, c, kernel=8, stride=4, padding=2),
            _Residual(convolution(c, c), convolution(c, c, active=False)),
            _Residual(_separable(c), _separable(c, active=False)),
        )
        self._compared = settings.compared
        self.compared = nn.Conv2d(c, settings.compared, 1)
        self.sharpness = nn.Parameter(torch.tensor(10.0))
        goals = (_ROWS // 2) * (_COLUMNS // 2)
        self.joint = nn.Sequential(
            convolution(goals + 3 + c + 2, joint, kernel=2, stride=2, padding=0),
            convolution(joint, joint * 3 // 2, stride=2),
            nn.Flatten(),
            nn.Linear(joint * 3 // 2 * (_ROWS // 4) * (_COLUMNS // 4), settings.hidden),
            nn.ReLU(),
            nn.Linear(settings.hidden, 7),
        )
        wide = settings.free
        self.columns = nn.Sequential(
            nn.Conv2d(c, wide, (_ROWS, 3), padding=(0, 1)),
            nn.ReLU(),
            nn.Conv2d(wide, wide, (1, 5), padding=(0, 2)),
            nn.ReLU(),
            nn.Conv2d(wide, wide, (1, 5), padding=(0, 4), dilation=(1, 2)),
            nn.ReLU(),
            nn.Conv2d(wide, len(FREE_EDGES), 1),
        )
        self.grid: Tensor
        self.goal_grid: Tensor
        self.register_buffer("grid", _grid(_ROWS, _COLUMNS), persistent=False)
        self.register_buffer("goal_grid", _grid(_ROWS // 2, _COLUMNS // 2), persistent=False)

    def encode(self, images: Tensor) -> Tensor:
        """Returns features (B, C, 16, 24) of images (B, 64, 96, 3), uint8 or float, RGB; invariant to exposure and white balance."""
        features: Tensor = self.encoder(normalised(images))
        return features

    def compare(self, present: Tensor, recorded: Tensor) -> Estimate:
        """Returns the outputs for features (B, C, 16, 24) of present and recorded images."""
        # Channels stay last in memory, which avoids slow copies. No size depends on the batch, for the export.
        places, goals = len(self.grid), len(self.goal_grid)
        a = self.compared(present).permute(0, 2, 3, 1).reshape(-1, places, self._compared)
        b = functional.avg_pool2d(self.compared(recorded), 2).permute(0, 2, 3, 1).reshape(-1, goals, self._compared)
        correlation = torch.bmm(
            functional.normalize(a, dim=2), functional.normalize(b, dim=2).transpose(1, 2)
        )  # (B, places, goals)
        where = torch.softmax(correlation * self.sharpness, dim=2)
        moved = torch.matmul(where, self.goal_grid) - self.grid
        peak = (where * where).sum(dim=2, keepdim=True)
        grid = self.grid + torch.zeros_like(moved)
        seen = torch.cat([correlation, *(part.to(correlation.dtype) for part in (moved, peak, grid))], dim=2)
        stack = torch.cat([seen.view(-1, _ROWS, _COLUMNS, goals + 5).permute(0, 3, 1, 2), present], dim=1)
        out = self.joint(stack)
        return Estimate(out[:, :3], functional.softplus(out[:, 3:6]) + 0.005, out[:, 6])

    def free(self, present: Tensor) -> Tensor:
        """Returns (B, 24, bins + 1): logits of the range bin of the first obstacle, of ``FREE_EDGES`` and beyond them, leftmost bearing first."""
        # Distances overfit to the scenes; dropout counteracts that.
        first = self.columns[:2](functional.dropout(present, _DROPOUT, self.training))
        columns: Tensor = self.columns[2:](functional.dropout(first, _DROPOUT, self.training))
        return columns[:, :, 0].transpose(1, 2)


def normalised(images: Tensor) -> Tensor:
    """Returns images (B, H, W, 3), 0 to 255, as (B, 3, H, W) of mean 0 and deviation about 1 per channel: invariant to exposure and white balance."""
    x = images.permute(0, 3, 1, 2).to(torch.float32)
    mean = x.mean(dim=(2, 3), keepdim=True)
    deviation = ((x - mean) ** 2).mean(dim=(2, 3), keepdim=True).sqrt()
    return (x - mean) / (deviation + 4.0)


class _Residual(nn.Module):
    """Residual connection around some layers."""

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__()
        self.layers = nn.Sequential(*layers)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.layers(x))


def convolution(
    inputs: int, outputs: int, *, kernel: int = 3, stride: int = 1, padding: int = 1, active: bool = True
) -> nn.Sequential:
    """Returns a convolution with its normalisation, and ReLU unless it is not ``active``."""
    layers: list[nn.Module] = [
        nn.Conv2d(inputs, outputs, kernel, stride, padding, bias=False),
        nn.BatchNorm2d(outputs),
    ]
    return nn.Sequential(*layers, nn.ReLU()) if active else nn.Sequential(*layers)


def _separable(channels: int, *, active: bool = True) -> nn.Sequential:
    """Returns a depthwise convolution and a pointwise one."""
    layers: list[nn.Module] = [
        nn.Conv2d(channels, channels, 3, 1, 1, groups=channels, bias=False),
        nn.Conv2d(channels, channels, 1, bias=False),
        nn.BatchNorm2d(channels),
    ]
    return nn.Sequential(*layers, nn.ReLU()) if active else nn.Sequential(*layers)


def _grid(rows: int, columns: int) -> Tensor:
    """Returns (rows * columns, 2): x and y of positions in an image, -1 to 1, left to right and top to bottom, row by row."""
    y = (torch.arange(rows, dtype=torch.float32) + 0.5) * (2.0 / rows) - 1.0
    x = (torch.arange(columns, dtype=torch.float32) + 0.5) * (2.0 / columns) - 1.0
    return torch.stack([x.expand(rows, columns), y[:, None].expand(rows, columns)], dim=-1).reshape(-1, 2)

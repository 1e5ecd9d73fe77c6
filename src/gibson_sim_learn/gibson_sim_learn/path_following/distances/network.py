"""The network that predicts free distances from an image and an earlier one.

An encoder with a feature pyramid of four levels, merged from coarse to fine: a few pixels show where an obstacle meets the floor, much of the image
shows what is floor and what is obstacle. One column of features is one bearing. The earlier image is warped onto the present one by the floor
plane (``gibson_path_following.obstacles.floor_plane``), so that obstacles differ between them. Needs PyTorch.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from gibson_sim_learn.path_following.data import DIRECTIONS, FREE_EDGES
from gibson_sim_learn.path_following.drawing import HEIGHT, WIDTH
from gibson_sim_learn.path_following.network import convolution, normalised

_CHANNELS = 3 + 3 + 3 + 2
"""Channels of the present image, the earlier one, their difference, and the coordinates of a pixel."""
_DROPOUT = 0.1
"""Dropout probability of the features."""


class DistanceNetwork(nn.Module):
    """Encoder, feature pyramid, and a head on its columns.

    Args:
        channels: channels of the features at 1/2, 1/4, 1/8 and 1/16 of the image size.
        joined: channels of the merged features.
        hidden: channels of the head.
    """

    def __init__(self, channels: Sequence[int] = (24, 48, 80, 112), joined: int = 48, hidden: int = 96) -> None:
        super().__init__()
        half, quarter, eighth, sixteenth = channels
        if WIDTH // 4 != DIRECTIONS:
            raise AssertionError("one bearing for each column of the features")
        self.to_half = nn.Sequential(convolution(_CHANNELS, half, kernel=5, stride=2, padding=2), _Block(half))
        self.to_quarter = nn.Sequential(convolution(half, quarter, stride=2), _Block(quarter), _Block(quarter))
        self.to_eighth = nn.Sequential(convolution(quarter, eighth, stride=2), _Block(eighth), _Block(eighth))
        self.to_sixteenth = nn.Sequential(convolution(eighth, sixteenth, stride=2), _Block(sixteenth), _Block(sixteenth))
        self.of_quarter, self.of_eighth, self.of_sixteenth = (nn.Conv2d(c, joined, 1) for c in (quarter, eighth, sixteenth))
        self.join_eighth, self.join_quarter = convolution(joined, joined), convolution(joined, joined)
        self.columns = nn.Sequential(
            nn.Conv2d(joined, hidden, (HEIGHT // 4, 3), padding=(0, 1)),
            nn.ReLU(),
            nn.Conv2d(hidden, hidden, (1, 3), padding=(0, 1)),
            nn.ReLU(),
            nn.Conv2d(hidden, len(FREE_EDGES), 1),
        )
        self.grid: Tensor
        y = torch.linspace(-1.0, 1.0, HEIGHT)[:, None].expand(HEIGHT, WIDTH)
        x = torch.linspace(-1.0, 1.0, WIDTH).expand(HEIGHT, WIDTH)
        self.register_buffer("grid", torch.stack([x, y])[None], persistent=False)

    def forward(self, images: Tensor, earlier: Tensor) -> Tensor:
        """Returns (B, 24, bins + 1): logits of the range bin of the first obstacle, of ``FREE_EDGES`` and beyond them, leftmost bearing first.

        Args:
            images: (B, 64, 96, 3), uint8 or float, RGB.
            earlier: (B, 64, 96, 3), earlier images warped onto these; black where unknown.
        """
        x = normalised(images)
        known = (earlier.sum(dim=3) > 0).to(x.dtype)[:, None]
        before = normalised(earlier) * known
        parts = [x, before, (x - before).abs() * known, self.grid.expand(x.shape[0], -1, -1, -1)]
        x = torch.cat(parts, dim=1).contiguous(memory_format=torch.channels_last)
        quarter = self.to_quarter(self.to_half(x))
        eighth = self.to_eighth(quarter)
        joined = self.of_sixteenth(functional.dropout2d(self.to_sixteenth(eighth), _DROPOUT, self.training))
        joined = self.join_eighth(self.of_eighth(eighth) + functional.interpolate(joined, scale_factor=2.0, mode="nearest"))
        joined = self.join_quarter(self.of_quarter(quarter) + functional.interpolate(joined, scale_factor=2.0, mode="nearest"))
        columns: Tensor = self.columns(functional.dropout(joined, _DROPOUT, self.training))
        return columns[:, :, 0].transpose(1, 2)


class _Block(nn.Module):
    """Residual block of two convolutions."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(convolution(channels, channels), convolution(channels, channels, active=False))

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.layers(x))

"""The network that tells how far the floor is free, from an image and an earlier one.

An encoder with four sizes of features, joined from the coarsest to the finest: where a thing meets the floor is told by a few pixels, what is
floor and what a thing by much of the image. One column of features is one direction. The earlier image is brought onto the present one by the
plane of the floor (``gibson_path_following.floor_plane``), so that what stands on the floor differs between them. Needs PyTorch.
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
"""The present image, the earlier one, their difference, and where in the image a pixel is."""
_DROPPED = 0.1
"""Share of the features that are left out in training."""


class DistanceNetwork(nn.Module):
    """An encoder, its features joined, and columns of them told as distances.

    Args:
        channels: of the features at a half, a quarter, an eighth and a sixteenth of the image's size.
        joined: channels of the joined features.
        hidden: channels of the columns.
    """

    def __init__(self, channels: Sequence[int] = (24, 48, 80, 112), joined: int = 48, hidden: int = 96) -> None:
        super().__init__()
        half, quarter, eighth, sixteenth = channels
        if WIDTH // 4 != DIRECTIONS:
            raise AssertionError("one direction for each column of the features")
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
        """Returns (B, 24, bins + 1): log-odds of where the first thing stands, by bins of ``FREE_EDGES`` and beyond them, left to right.

        Args:
            images: (B, 64, 96, 3), uint8 or float, RGB.
            earlier: (B, 64, 96, 3), the same of earlier images, brought onto these; black where nothing is known.
        """
        x = normalised(images)
        known = (earlier.sum(dim=3) > 0).to(x.dtype)[:, None]
        before = normalised(earlier) * known
        parts = [x, before, (x - before).abs() * known, self.grid.expand(x.shape[0], -1, -1, -1)]
        x = torch.cat(parts, dim=1).contiguous(memory_format=torch.channels_last)
        quarter = self.to_quarter(self.to_half(x))
        eighth = self.to_eighth(quarter)
        joined = self.of_sixteenth(functional.dropout2d(self.to_sixteenth(eighth), _DROPPED, self.training))
        joined = self.join_eighth(self.of_eighth(eighth) + functional.interpolate(joined, scale_factor=2.0, mode="nearest"))
        joined = self.join_quarter(self.of_quarter(quarter) + functional.interpolate(joined, scale_factor=2.0, mode="nearest"))
        columns: Tensor = self.columns(functional.dropout(joined, _DROPPED, self.training))
        return columns[:, :, 0].transpose(1, 2)


class _Block(nn.Module):
    """Two convolutions whose output is added to their input."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(convolution(channels, channels), convolution(channels, channels, active=False))

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.layers(x))

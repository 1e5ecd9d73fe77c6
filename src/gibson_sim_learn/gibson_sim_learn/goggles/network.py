"""The network of Goggles: gains of the colours from a small copy of the image, and a small residual for noise and blur.

Most of what a light or a camera does to an image is a factor on each colour that changes slowly over the image, and with what is seen.
So the network looks at a copy of 96x64 pixels, yields a few maps of such factors, and chooses among them for each pixel by what is around
it. That takes images of any size; two more layers then mend what is left.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

SMALL = (64, 96)
"""Height and width of the small copy, pixels."""
_MAPS = 4
"""Maps of gains that are chosen among."""
_DETAIL = 24
"""Channels of the layers that see every pixel."""
_LEAK = 0.1
"""Slope below 0 of the layers that see every pixel: nothing normalises them, and with none a whole layer died."""
_LARGEST_GAIN = 3.0
"""Natural logarithm of the largest factor on a colour as it is in the file (not linear)."""


class GogglesNetwork(nn.Module):
    """Takes images of any even size."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Sequential(_convolution(3, 16, kernel=5, stride=2), _convolution(16, 32, stride=2), _Residual(32))  # 16x24
        self.deep = nn.Sequential(_convolution(32, 64, stride=2), _Residual(64), _Residual(64))  # 8x12
        self.whole = nn.Sequential(nn.Linear(64 + 6, 64), nn.ReLU(), nn.Linear(64, 64))
        self.back = nn.Conv2d(64, 32, 1)
        self.maps = nn.Sequential(_Residual(32), nn.Conv2d(32, 3 * _MAPS, 1))
        self.detail = nn.Sequential(nn.Conv2d(12, _DETAIL, 3, padding=1), nn.LeakyReLU(_LEAK))
        self.choice = nn.Conv2d(_DETAIL, 4 * _MAPS, 1)
        self.residual = nn.Sequential(
            nn.Conv2d(_DETAIL + 12, _DETAIL, 3, padding=1),
            nn.LeakyReLU(_LEAK),
            nn.Conv2d(_DETAIL, _DETAIL, 3, padding=1),
            nn.LeakyReLU(_LEAK),
            nn.Conv2d(_DETAIL, 12, 3, padding=1),
        )
        # Untrained, it returns its input.
        for last in (self.maps[-1], self.residual[-1]):
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def forward(self, image: Tensor, small: Tensor) -> Tensor:
        """Returns images (B, 3, H, W) in the simulator's look, 0 to 1, of images (B, H, W, 3), uint8 or float to 255, RGB.

        Args:
            image: H and W even.
            small: (B, 64, 96, 3), the same, smaller.
        """
        maps = self._gains(_planes(small))
        # Four pixels become channels of one: half the places, twice the reach.
        pixels = functional.pixel_unshuffle(_planes(image), 2)
        seen = self.detail(pixels)
        choice = self.choice(seen)
        spread = functional.interpolate(maps, size=pixels.shape[2:], mode="bilinear", align_corners=False)
        # (B, 4, h, w) for each map: one number for each of the four pixels.
        shares = torch.softmax(torch.stack(choice.split(4, dim=1)), dim=0)
        gain = sum(
            share.repeat(1, 3, 1, 1) * part.repeat_interleave(4, dim=1)
            for share, part in zip(shares, spread.split(3, dim=1), strict=True)
        )
        lit = pixels * torch.exp(gain)
        mended: Tensor = functional.pixel_shuffle(lit + self.residual(torch.cat([seen, lit], dim=1)), 2)
        return mended

    def _gains(self, small: Tensor) -> Tensor:
        """Returns (B, 3 maps, 16, 24): logarithms of factors on red, green, blue."""
        mean = small.mean(dim=(2, 3))
        deviation = ((small - mean[:, :, None, None]) ** 2).mean(dim=(2, 3)).sqrt()
        near = self.stem(small)
        far = self.deep(near)
        whole = self.whole(torch.cat([far.mean(dim=(2, 3)), mean, deviation], dim=1))
        wide = functional.interpolate(self.back(far + whole[:, :, None, None]), scale_factor=2.0, mode="bilinear")
        return _LARGEST_GAIN * torch.tanh(self.maps(near + wide))


def parameter_count(network: nn.Module) -> int:
    """Returns the number of weights."""
    return sum(parameter.numel() for parameter in network.parameters())


class _Residual(nn.Module):
    """Two layers whose output is added to their input."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(_convolution(channels, channels), _convolution(channels, channels, active=False))

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.layers(x))


def _planes(image: Tensor) -> Tensor:
    """Returns (B, 3, H, W), 0 to 1, of images (B, H, W, 3), 0 to 255."""
    return image.permute(0, 3, 1, 2).to(torch.float32) * (1.0 / 255.0)


def _convolution(inputs: int, outputs: int, *, kernel: int = 3, stride: int = 1, active: bool = True) -> nn.Sequential:
    layers: list[nn.Module] = [
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(outputs),
    ]
    return nn.Sequential(*layers, nn.ReLU()) if active else nn.Sequential(*layers)

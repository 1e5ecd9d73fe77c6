"""The network of Goggles: low-resolution maps of colour gains, as in bilateral-grid networks, and a full-resolution residual.

The effect of lighting and camera on an image is mostly a gain per colour channel that varies slowly over the image, and with its content.
The network predicts a few gain maps from a thumbnail of 96x64 pixels, and blends them at each pixel with softmax weights from its
neighbourhood. It takes images of any even size; a shallow residual branch corrects noise and blur.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

SMALL = (64, 96)
"""Height and width of the thumbnail, pixels."""
_MAPS = 4
"""Number of gain maps."""
_DETAIL = 24
"""Channels of the full-resolution layers."""
_LEAK = 0.1
"""Negative slope of the leaky ReLU of the full-resolution layers: without batch normalization, all units of a layer with ReLU died."""
_MAX_LOG_GAIN = 3.0
"""Largest natural logarithm of a gain, applied to sRGB values (not linear)."""


class GogglesNetwork(nn.Module):
    """Adapts images of any even size."""

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
        # The untrained network is the identity.
        for last in (self.maps[-1], self.residual[-1]):
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def forward(self, image: Tensor, small: Tensor) -> Tensor:
        """Returns adapted images, (B, 3, H, W) float32, sRGB, about 0 to 1, not clipped.

        Args:
            image: (B, H, W, 3), uint8 or float, sRGB, 0 to 255; H and W are even.
            small: (B, 64, 96, 3), thumbnails of the same images.
        """
        maps = self._log_gains(_to_nchw(small))
        # 2x2 pixels become channels of one: half the resolution, twice the receptive field.
        pixels = functional.pixel_unshuffle(_to_nchw(image), 2)
        features = self.detail(pixels)
        choice = self.choice(features)
        upsampled = functional.interpolate(maps, size=pixels.shape[2:], mode="bilinear", align_corners=False)
        # (maps, B, 4, h, w): blend weights of the four pixels.
        weights = torch.softmax(torch.stack(choice.split(4, dim=1)), dim=0)
        blended = sum(
            weight.repeat(1, 3, 1, 1) * log_gain.repeat_interleave(4, dim=1)
            for weight, log_gain in zip(weights, upsampled.split(3, dim=1), strict=True)
        )
        relit = pixels * torch.exp(blended)
        adapted: Tensor = functional.pixel_shuffle(relit + self.residual(torch.cat([features, relit], dim=1)), 2)
        return adapted

    def _log_gains(self, small: Tensor) -> Tensor:
        """Returns (B, 3 * maps, 16, 24): natural logarithms of the gains of red, green and blue."""
        mean = small.mean(dim=(2, 3))
        deviation = ((small - mean[:, :, None, None]) ** 2).mean(dim=(2, 3)).sqrt()
        near = self.stem(small)
        far = self.deep(near)
        whole = self.whole(torch.cat([far.mean(dim=(2, 3)), mean, deviation], dim=1))
        wide = functional.interpolate(self.back(far + whole[:, :, None, None]), scale_factor=2.0, mode="bilinear")
        return _MAX_LOG_GAIN * torch.tanh(self.maps(near + wide))


class _Residual(nn.Module):
    """A residual block of two convolutions."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(_convolution(channels, channels), _convolution(channels, channels, active=False))

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.layers(x))


def _to_nchw(image: Tensor) -> Tensor:
    """Returns images (B, H, W, 3), 0 to 255, as (B, 3, H, W), 0 to 1."""
    return image.permute(0, 3, 1, 2).to(torch.float32) * (1.0 / 255.0)


def _convolution(inputs: int, outputs: int, *, kernel: int = 3, stride: int = 1, active: bool = True) -> nn.Sequential:
    """Returns convolution, batch normalization and, if ``active``, ReLU."""
    layers: list[nn.Module] = [
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(outputs),
    ]
    return nn.Sequential(*layers, nn.ReLU()) if active else nn.Sequential(*layers)

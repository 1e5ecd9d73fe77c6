"""The network of the filler: a small U-Net at half resolution that corrects images whose holes push-pull has filled.

The input is pixel-unshuffled and the output pixel-shuffled. At the bottom, at an eighth of the size, dilated layers have a receptive field that
spans a large hole. No layer uses statistics of the whole image, so images of all sizes are processed alike.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from gibson_sim.filling.inputs import CHANNELS

_HALF, _QUARTER, _EIGHTH = 16, 32, 64
"""Channels at half, a quarter and an eighth of the size."""
_DILATIONS = (1, 2, 4, 8, 16, 1)
_SLOPE = 0.1


class FillerNetwork(nn.Module):
    """Network for inputs (B, 9, H, W) of ``filling.inputs``, H and W multiples of 16; untrained, it returns their colours."""

    def __init__(self) -> None:
        super().__init__()
        self.entrance = _convolution(4 * CHANNELS, _HALF)
        self.down_quarter = nn.Sequential(_convolution(_HALF, _QUARTER, stride=2), _Residual(_QUARTER))
        self.down_eighth = nn.Sequential(
            _convolution(_QUARTER, _EIGHTH, stride=2), *(_Dilated(_EIGHTH, dilation) for dilation in _DILATIONS)
        )
        self.to_quarter, self.join_quarter = nn.Conv2d(_EIGHTH, _QUARTER, 1), _convolution(2 * _QUARTER, _QUARTER)
        self.to_half, self.join_half = nn.Conv2d(_QUARTER, _HALF, 1), _convolution(2 * _HALF, _HALF)
        self.exit = nn.Conv2d(_HALF, 12, 3, padding=1)
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d):
                # PyTorch's default shrinks signals from layer to layer: a network without normalisation then learns several times more slowly.
                nn.init.kaiming_normal_(layer.weight, a=_SLOPE, nonlinearity="leaky_relu")
                assert layer.bias is not None
                nn.init.zeros_(layer.bias)
        nn.init.zeros_(self.exit.weight)

    def forward(self, values: Tensor) -> Tensor:
        """Returns images (B, 3, H, W), sRGB, about 0 to 1, not clipped."""
        half = self.entrance(functional.pixel_unshuffle(values, 2))
        quarter = self.down_quarter(half)
        eighth = self.down_eighth(quarter)
        quarter = self.join_quarter(torch.cat([quarter, _twice(self.to_quarter(eighth))], dim=1))
        half = self.join_half(torch.cat([half, _twice(self.to_half(quarter))], dim=1))
        image: Tensor = values[:, :3] + functional.pixel_shuffle(self.exit(half), 2)
        return image


def multiplications(network: nn.Module, side: int) -> int:
    """Returns the number of multiplications for a square image of ``side`` pixels."""
    total = 0

    def count(layer: nn.Module, _inputs: object, output: Tensor) -> None:
        nonlocal total
        assert isinstance(layer, nn.Conv2d)
        total += output[0].numel() * layer.weight[0].numel()

    hooks = [layer.register_forward_hook(count) for layer in network.modules() if isinstance(layer, nn.Conv2d)]
    with torch.inference_mode():
        network(torch.zeros(1, CHANNELS, side, side))
    for hook in hooks:
        hook.remove()
    return total


class _Residual(nn.Module):
    """A residual block of two convolutions."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(_convolution(channels, channels), nn.Conv2d(channels, channels, 3, padding=1))

    def forward(self, x: Tensor) -> Tensor:
        return functional.leaky_relu(x + self.layers(x), _SLOPE)


class _Dilated(nn.Module):
    """A residual block of one dilated convolution."""

    def __init__(self, channels: int, dilation: int) -> None:
        super().__init__()
        self.layer = nn.Conv2d(channels, channels, 3, padding=dilation, dilation=dilation)

    def forward(self, x: Tensor) -> Tensor:
        return x + functional.leaky_relu(self.layer(x), _SLOPE)


def _twice(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)


def _convolution(inputs: int, outputs: int, *, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, stride, 1), nn.LeakyReLU(_SLOPE))

"""Perceptual difference of two pictures. Pure; PSNR and SSIM are in ``gibson_sim.sensors.image_similarity``."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.colours import linear_from_srgb

F64 = NDArray[np.float64]
PIXELS_PER_DEGREE = 67.0
"""Pixels per degree of the observer: 0.7 m from a monitor 0.7 m wide with 3840 pixels, the default of the paper."""
_XYZ = np.array([[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]])
"""Linear sRGB to CIE XYZ, D65."""
_WHITE = _XYZ.sum(axis=1)
_SENSITIVITY = (
    ((1.0, 0.0047), (0.0, 1e-5)),
    ((1.0, 0.0053), (0.0, 1e-5)),
    ((34.1, 0.04), (13.5, 0.025)),
)
"""Weights and widths (degrees^2) of the Gaussians of the contrast sensitivity: achromatic, red-green, blue-yellow."""
_EXPONENT, _KNEE, _KNEE_VALUE = 0.7, 0.4, 0.95
"""Exponent of the colour difference; share of its largest value that is mapped to ``_KNEE_VALUE``."""
_FEATURE_WIDTH_DEG = 0.082
"""Width of the feature detectors, degrees."""


def flip_map(reference: NDArray[Any], test: NDArray[Any]) -> F64:
    """Returns the FLIP difference of two pictures at each pixel, (H, W), 0 = equal to 1.

    Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", Proc. ACM Comput. Graph. Interact. Tech. 3(2), 2020: what an observer
    sees who alternates between the pictures, ``PIXELS_PER_DEGREE`` away.

    Args:
        reference: (H, W, 3), sRGB, 0 to 255.
        test: the other picture, of the same size.
    """
    a, b = (_opponent(linear_from_srgb(np.asarray(image, dtype=np.float64) / 255.0) @ _XYZ.T) for image in (reference, test))
    color = _color_difference(_filtered(a), _filtered(b))
    features = _feature_difference((a[..., 0] + 16.0) / 116.0, (b[..., 0] + 16.0) / 116.0)
    return np.asarray(color ** (1.0 - features))


def _opponent(xyz: F64) -> F64:
    """Converts XYZ to YCxCz, a linear opponent space."""
    x, y, z = np.moveaxis(xyz / _WHITE, -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def _xyz_of_opponent(opponent: F64) -> F64:
    y = (opponent[..., 0] + 16.0) / 116.0
    return np.asarray(np.stack([y + opponent[..., 1] / 500.0, y, y - opponent[..., 2] / 200.0], axis=-1) * _WHITE)


def _filtered(opponent: F64) -> F64:
    """Returns Lab, adjusted after Hunt, of a picture as blurred as an observer sees it."""
    widest = max(width for gaussians in _SENSITIVITY for _, width in gaussians)
    radius = math.ceil(3.0 * math.sqrt(widest / (2.0 * math.pi**2)) * PIXELS_PER_DEGREE)
    squares = (np.arange(-radius, radius + 1) / PIXELS_PER_DEGREE) ** 2
    blurred = np.empty_like(opponent)
    for channel, gaussians in enumerate(_SENSITIVITY):
        kernel = np.sum(
            [
                weight * math.sqrt(math.pi / width) * np.exp(-(math.pi**2) * (squares[:, None] + squares) / width)
                for weight, width in gaussians
            ],
            axis=0,
        )
        blurred[..., channel] = cv2.filter2D(
            np.ascontiguousarray(opponent[..., channel]), -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE
        )
    rgb = np.clip(_xyz_of_opponent(blurred) @ np.linalg.inv(_XYZ).T, 0.0, 1.0)
    return _hunt_lab(rgb @ _XYZ.T)


def _hunt_lab(xyz: F64) -> F64:
    ratio = xyz / _WHITE
    delta = 6.0 / 29.0
    f = np.where(ratio > delta**3, np.cbrt(ratio), ratio / (3 * delta**2) + 4.0 / 29.0)
    lightness = 116.0 * f[..., 1] - 16.0
    a, b = 500.0 * (f[..., 0] - f[..., 1]), 200.0 * (f[..., 1] - f[..., 2])
    return np.stack([lightness, 0.01 * lightness * a, 0.01 * lightness * b], axis=-1)


def _hyab(a: F64, b: F64) -> F64:
    d = a - b
    return np.asarray(np.abs(d[..., 0]) + np.hypot(d[..., 1], d[..., 2]))


def _color_difference(a: F64, b: F64) -> F64:
    green, blue = (_hunt_lab(np.array(color) @ _XYZ.T) for color in ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    largest = float(_hyab(green, blue)) ** _EXPONENT
    difference = _hyab(a, b) ** _EXPONENT
    knee = _KNEE * largest
    above = _KNEE_VALUE + (difference - knee) / (largest - knee) * (1.0 - _KNEE_VALUE)
    return np.asarray(np.clip(np.where(difference < knee, _KNEE_VALUE / knee * difference, above), 0.0, 1.0))


def _feature_difference(a: F64, b: F64) -> F64:
    sigma = 0.5 * _FEATURE_WIDTH_DEG * PIXELS_PER_DEGREE
    radius = math.ceil(3.0 * sigma)
    x = np.arange(-radius, radius + 1, dtype=np.float64)
    gauss = np.exp(-(x[:, None] ** 2 + x**2) / (2.0 * sigma**2))
    edge, point = -x * gauss, (x**2 / sigma**2 - 1.0) * gauss
    kernels = [_balanced(edge), _balanced(point)]
    found = []
    for image in (a, b):
        found.append(
            [
                np.hypot(*(cv2.filter2D(image, -1, k, borderType=cv2.BORDER_REPLICATE) for k in (kernel, kernel.T)))
                for kernel in kernels
            ]
        )
    difference = np.maximum(*(np.abs(of_a - of_b) for of_a, of_b in zip(*found, strict=True)))
    return np.asarray(np.clip((difference / math.sqrt(2.0)) ** 0.5, 0.0, 1.0))


def _balanced(kernel: F64) -> F64:
    """Returns a kernel whose positive and negative weights each have the sum 1."""
    positive, negative = np.maximum(kernel, 0.0), np.maximum(-kernel, 0.0)
    return np.ascontiguousarray(positive / positive.sum() - negative / negative.sum())

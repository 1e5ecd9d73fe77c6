"""Assigns the error of a picture to its causes. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
MOVING, OUTSIDE, REFLECTION, LIGHT, TEXTURE = "moves", "outside", "reflection", "light", "texture and edges"
CAUSES = (MOVING, OUTSIDE, REFLECTION, LIGHT, TEXTURE)
"""Causes: pixels of moving things, of the view outside, of mirrors, glass and metal; slow and fast part of the error of all other pixels."""
_OUTSIDE_ALPHA = 0.5
"""Share of a pixel that the scene covers below which it shows the outside."""
_SLOW = 1.0 / 40.0
"""Standard deviation of the low-pass filter that separates light from texture, as a fraction of the picture's width."""


@dataclass(frozen=True, slots=True)
class CauseError:
    """The part of a squared error that has one cause."""

    pixels: float
    """Share of all pixels with this cause; light and texture have the same pixels."""
    mse: float
    """Mean squared error of these pixels, sRGB, 0 to 255."""
    share: float
    """Share of the squared error of the whole picture."""


def masks_of(moving: Bools, alpha: NDArray[np.floating], material: NDArray[np.uint8]) -> dict[str, Bools]:
    """Returns the pixels of each cause, (H, W); each pixel has one, light and texture share theirs.

    Args:
        moving: whether a pixel shows a moving link.
        alpha: share of it that the scene covers.
        material: kind of its material, 0 = matte.
    """
    outside = alpha < _OUTSIDE_ALPHA
    moves = moving & ~outside
    reflects = (material > 0) & ~outside & ~moves
    rest = ~(outside | moves | reflects)
    return {MOVING: moves, OUTSIDE: outside, REFLECTION: reflects, LIGHT: rest, TEXTURE: rest}


def errors_by_cause(ours: NDArray[np.uint8], truth: NDArray[np.uint8], masks: dict[str, Bools]) -> dict[str, CauseError]:
    """Returns the error of each cause; their shares add up to 1.

    The slow part of the error, after a Gaussian over the pixels of the static, matte scene, is light; the rest there is texture and edges.

    Args:
        ours: our picture, (H, W, 3), sRGB.
        truth: the traced one.
        masks: from ``masks_of``.
    """
    error = ours.astype(np.float64) - truth.astype(np.float64)
    squares = (error**2).mean(axis=2)
    slow_squares = (slow_part(error, masks[LIGHT]) ** 2).mean(axis=2)
    total = float(squares.sum())
    found = {}
    for cause in CAUSES:
        mask = masks[cause]
        parts = {LIGHT: slow_squares, TEXTURE: squares - slow_squares}.get(cause, squares)
        amount = float(parts[mask].sum())
        found[cause] = CauseError(float(mask.mean()), amount / max(int(mask.sum()), 1), amount / total if total else 0.0)
    return found


def slow_part(error: F64, mask: Bools) -> F64:
    """Returns the low-pass of an error, (H, W, 3), over the pixels of a mask; 0 elsewhere."""
    sigma = _SLOW * error.shape[1]
    weight = mask.astype(np.float64)
    blurred = cv2.GaussianBlur(np.dstack([error * weight[..., None], weight]), (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    return np.asarray(np.where(mask[..., None], blurred[..., :3] / np.maximum(blurred[..., 3:], 1e-9), 0.0))

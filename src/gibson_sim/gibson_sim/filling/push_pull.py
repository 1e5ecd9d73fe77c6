"""Fills holes of an image from what is around them, by a pyramid: *push-pull* (Gortler et al., The Lumigraph, 1996, section 3.4).

Push: an image of half the size holds the mean of the known ones of each four pixels, until all are known. Pull: from the smallest image
on, an unknown pixel takes the bilinear interpolation of the image of half the size. Known pixels do not change.
"""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
F32 = NDArray[np.float32]
Value = TypeVar("Value", np.uint8, np.float32)


def push_pull(values: NDArray[Value], hole: Bools, known: Bools | None = None) -> NDArray[Value]:
    """Returns a copy of an image with its holes filled; where nothing at all is known, an unchanged copy.

    Args:
        values: (H, W) or (H, W, C), uint8 or float32, finite where known.
        hole: (H, W), the pixels to fill.
        known: (H, W), the pixels to fill them from, none of them in a hole; None = all others.
    """
    known = ~hole if known is None else known
    out = values.copy()
    if not hole.any() or not known.any():
        return out
    filled = _filled(values, known)[hole]
    out[hole] = np.rint(filled) if values.dtype == np.uint8 else filled
    return out


def push_pull_depth(depth: F32, hole: Bools) -> F32:
    """Returns a copy of a depth image with its holes filled; planes stay planes, since inverse depth is linear in the image of a plane.

    Args:
        depth: (H, W), metres, above 0, +inf or NaN = nothing.
        hole: (H, W), the pixels to fill, from all others that have a depth.
    """
    known = ~hole & np.isfinite(depth)
    inverse = np.zeros_like(depth)
    np.divide(np.float32(1.0), depth, out=inverse, where=known)
    inverse = push_pull(inverse, hole, known)
    out = depth.copy()
    np.divide(np.float32(1.0), inverse, out=out, where=hole & (inverse > 0.0))
    return out


def _filled(values: NDArray[Value], known: Bools) -> F32:
    """Returns an image, float32, whose pixels are all known; at least one of them was."""
    weight = known.astype(np.float32)
    levels = [(_masked(values, known), weight)]
    while not weight.all():
        levels.append(_pushed(*levels[-1]))
        weight = levels[-1][1]
    out = levels[-1][0]
    for finer, weight in levels[-2::-1]:
        height, width = weight.shape
        twice = cv2.resize(out, (2 * out.shape[1], 2 * out.shape[0]), interpolation=cv2.INTER_LINEAR)
        out = np.array(twice[:height, :width], dtype=np.float32)
        cv2.copyTo(finer, weight.astype(np.uint8), out)
    return out


def _masked(values: NDArray[Value], known: Bools) -> F32:
    """Returns an image as float32, 0 where it is not known."""
    out = np.zeros(values.shape, dtype=np.float32)
    return np.asarray(cv2.copyTo(np.asarray(values, dtype=np.float32), known.astype(np.uint8), out))


def _pushed(values: F32, weight: F32) -> tuple[F32, F32]:
    """Returns the image of half the size, rounded up, and its weights: 1 = known, 0 = unknown, where the values are 0."""
    height, width = weight.shape
    half = ((width + 1) // 2, (height + 1) // 2)

    def halved(image: F32) -> F32:
        even = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_CONSTANT)
        return np.asarray(cv2.resize(even, half, interpolation=cv2.INTER_AREA), dtype=np.float32)

    mean, share = halved(values), halved(weight)
    some = share > 0.0
    divisor = np.where(some, share, np.float32(1.0))
    mean /= divisor if mean.ndim == 2 else divisor[:, :, None]
    return mean, some.astype(np.float32)

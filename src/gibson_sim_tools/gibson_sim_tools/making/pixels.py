"""Processes baked images: fills gaps, removes hidden texels, exposes and tone-maps. NumPy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.geometry.colours import LUMINANCE, srgb_from_linear

F32 = NDArray[np.float32]
_MIDDLE = 0.48
"""Linear brightness of a scene's middle tones before the tone curve."""
_BALANCE = 0.6
"""Fraction of the light's overall tint that white balance removes."""
_SHUT = 1e-6
_RUN = 3
_REACH = 16
"""Search radius for a covered pixel, pixels."""
_SHOULDER = 4.2
"""Linear brightness that maps to white."""


def filled(image: F32, covered: NDArray[np.bool_]) -> F32:
    """Returns an image (H, W, C) whose gaps are filled from their surroundings.

    Each chart is extended by its own colours, so that its neighbours do not bleed into it; the rest is filled by push-pull over an image pyramid.
    """
    image, weight = _grown(image, covered.astype(np.float32)[..., None])
    levels = [(image * weight, weight)]
    while min(levels[-1][0].shape[:2]) > 1:
        color, part = levels[-1]
        height, width = color.shape[0] // 2 * 2, color.shape[1] // 2 * 2
        summed = [a[:height, :width].reshape(height // 2, 2, width // 2, 2, -1).sum(axis=(1, 3)) for a in (color, part)]
        known = np.minimum(summed[1], 1.0)
        levels.append((summed[0] / np.maximum(summed[1], 1e-6) * known, known))
    result = levels[-1][0] / np.maximum(levels[-1][1], 1e-6)
    for color, part in reversed(levels[:-1]):
        above = result.repeat(2, axis=0).repeat(2, axis=1)
        short = [(0, max(0, color.shape[k] - above.shape[k])) for k in (0, 1)]
        above = np.pad(above, [*short, (0, 0)], mode="edge")
        result = color + above[: color.shape[0], : color.shape[1]] * (1 - part)
    return np.asarray(result, dtype=np.float32)


def mirrored(image: F32, covered: NDArray[np.bool_]) -> F32:
    """Returns an image (H, W, C) whose gaps are filled with their surroundings, mirrored at their edges.

    The gaps are then as noisy as their surroundings, and the denoiser sees no edge there. Pixels far from every chart are ``filled``.
    """
    rows, columns, found = _nearest(covered)
    height, width = covered.shape
    y, x = np.mgrid[:height, :width]
    across_y, across_x = np.clip(2 * rows - y, 0, height - 1), np.clip(2 * columns - x, 0, width - 1)
    there = covered[across_y, across_x]
    shown = image[np.where(there, across_y, rows), np.where(there, across_x, columns)]
    result = np.where(covered[..., None], image, np.where(found[..., None], shown, filled(image, covered)))
    return np.asarray(result, dtype=np.float32)


def _nearest(covered: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_]]:
    """Returns row and column of a nearby covered pixel of each pixel, and whether one is within about ``_REACH``, by jump flooding.

    Rong, Tan, "Jump Flooding in GPU with Applications to Voronoi Diagram and Distance Transform", I3D 2006.
    """
    y, x = np.mgrid[: covered.shape[0], : covered.shape[1]].astype(np.int32)
    rows, columns, found = y.copy(), x.copy(), covered.copy()
    step = min(_REACH, *(n - 1 for n in covered.shape))
    while step:
        for j, i in ((j, i) for j in (-step, 0, step) for i in (-step, 0, step) if j or i):
            here, there = _overlap(j, i, covered.shape)
            r, c, known = rows[there], columns[there], found[there]
            off = (r - y[here]) ** 2 + (c - x[here]) ** 2
            own = (rows[here] - y[here]) ** 2 + (columns[here] - x[here]) ** 2
            better = known & (~found[here] | (off < own))
            rows[here] = np.where(better, r, rows[here])
            columns[here] = np.where(better, c, columns[here])
            found[here] |= better
        step //= 2
    return rows, columns, found


def _overlap(j: int, i: int, shape: tuple[int, ...]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Returns the slices of the pixels with a neighbour ``j`` rows and ``i`` columns away, and of these neighbours."""
    pairs = [(slice(max(-k, 0), n - max(k, 0)), slice(max(k, 0), n - max(-k, 0))) for k, n in ((j, shape[0]), (i, shape[1]))]
    return (pairs[0][0], pairs[1][0]), (pairs[0][1], pairs[1][1])


def hidden(openness: F32, covered: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Returns the mask of texels inside other geometry, (H, W), as of a wall behind its skirting.

    These are runs of pixels without openness, and their partly hidden neighbours. In corners, single pixels are closed by chance, but seldom
    three in a row.

    Args:
        openness: (H, W): fraction of directions without near geometry, with its noise.
        covered: (H, W): mask of surfaces.
    """
    shut = covered & (openness <= _SHUT)
    runs = np.pad(_opened(shut, 0) | _opened(shut, 1), 1)
    beside = runs[:-2, 1:-1] | runs[2:, 1:-1] | runs[1:-1, :-2] | runs[1:-1, 2:]
    return np.asarray((runs[1:-1, 1:-1] | beside) & covered)


def _opened(mask: NDArray[np.bool_], axis: int) -> NDArray[np.bool_]:
    """Returns the mask of runs of at least ``_RUN`` pixels along an axis."""
    width = [(0, 0), (0, 0)]
    width[axis] = (_RUN - 1, _RUN - 1)
    padded = np.pad(mask, width)
    length = mask.shape[axis]
    starts = np.logical_and.reduce([padded.take(range(k, k + length + _RUN - 1), axis) for k in range(_RUN)])
    return np.asarray(np.logical_or.reduce([starts.take(range(k, k + length), axis) for k in range(_RUN)]))


def _grown(image: F32, covered: F32) -> tuple[F32, F32]:
    """Returns image and coverage (H, W, 1) with every chart dilated by one pixel."""
    padded, mask = (np.pad(a, [(1, 1), (1, 1), (0, 0)]) for a in (image * covered, covered))
    height, width = image.shape[:2]
    total, count = np.zeros_like(image), np.zeros_like(covered)
    for j in range(3):
        for i in range(3):
            total += padded[j : j + height, i : i + width]
            count += mask[j : j + height, i : i + width]
    return np.where(covered > 0, image, total / np.maximum(count, 1)), np.minimum(count, 1.0)


def doubled(image: F32) -> F32:
    """Returns an image (H, W, C) at twice the size, interpolated linearly between pixel centres."""
    for axis in (0, 1):
        before = np.concatenate([image.take([0], axis), image.take(range(image.shape[axis] - 1), axis)], axis)
        after = np.concatenate([image.take(range(1, image.shape[axis]), axis), image.take([-1], axis)], axis)
        pair = np.stack([0.75 * image + 0.25 * before, 0.75 * image + 0.25 * after], axis + 1)
        shape = list(image.shape)
        shape[axis] *= 2
        image = pair.reshape(shape)
    return image.astype(np.float32)


def exposure_of(samples: list[F32]) -> F32:
    """Returns the factors (3,) of red, green and blue for exposure and white balance.

    Args:
        samples: (N, 3) linear colours in their light. What lies in the dark, behind and below things, does not count.
    """
    values = np.concatenate([a.reshape(-1, 3) for a in samples]).astype(np.float64)
    bright = values @ LUMINANCE
    seen = bright > 0.06 * np.percentile(bright, 90)
    mean = values[seen].mean(axis=0)
    balance = (mean @ LUMINANCE / np.maximum(mean, 1e-6)) ** _BALANCE
    middle = np.exp(np.log(bright[seen]).mean())
    return np.asarray(balance * _MIDDLE / max(middle, 1e-6), dtype=np.float32)


def toned(linear: ArrayLike) -> NDArray[np.uint8]:
    """Returns 8-bit sRGB of linear colours, tone-mapped: linear in the shadows, compressed in the highlights.

    The curve is that of Reinhard et al., "Photographic Tone Reproduction for Digital Images" (2002), equation 4, on the brightest channel, mixed
    with the same on each channel, so that what is bright loses its colour.
    """
    color = np.maximum(np.asarray(linear, dtype=np.float32), 0.0)
    peak = np.maximum(color.max(axis=-1, keepdims=True), 1e-6)
    kept = color * (_curve(peak) / peak)
    srgb = srgb_from_linear(0.55 * kept + 0.45 * _curve(color))
    # Slightly more contrast in the middle tones, as in photographs.
    curved = srgb + 0.13 * (srgb - 0.5) * (1 - (2 * srgb - 1) ** 2) * 2
    return np.asarray(np.clip(np.round(curved * 255), 0, 255), dtype=np.uint8)


def _curve(value: F32) -> F32:
    return np.minimum(value * (1 + value / _SHOULDER**2) / (1 + value) * 1.06, 1.0)

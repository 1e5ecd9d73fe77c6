"""Processes baked images: fills gaps, detects hidden texels, sets the exposure, tone-maps. NumPy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.geometry.colours import LUMINANCE, srgb_from_linear

F32 = NDArray[np.float32]
_MIDDLE_GREY = 0.48
"""Linear brightness of a scene's geometric mean before the tone curve."""
_WHITE_BALANCE = 0.6
"""Fraction of the light's overall tint that white balance removes."""
_GAP_PX = 2
"""Depth up to which the texels of gaps and of insides are hidden, pixels; less than the distance of charts."""
_SEARCH_RADIUS = 16
"""Search radius for covered pixels, pixels."""
_WHITE_POINT = 4.2
"""Linear brightness that maps to white."""


def fill_gaps(image: F32, covered: NDArray[np.bool_]) -> F32:
    """Returns an image, (H, W, C), with gaps filled from their surroundings.

    Each chart is dilated by one pixel, so that its neighbours do not bleed into it; the rest is filled by push-pull over an image pyramid.
    ``covered``: mask of charts, (H, W).
    """
    image, weight = _dilated(image, covered.astype(np.float32)[..., None])
    levels = [(image * weight, weight)]
    while min(levels[-1][0].shape[:2]) > 1:
        color, part = levels[-1]
        height, width = color.shape[0] // 2 * 2, color.shape[1] // 2 * 2
        sums = [a[:height, :width].reshape(height // 2, 2, width // 2, 2, -1).sum(axis=(1, 3)) for a in (color, part)]
        known = np.minimum(sums[1], 1.0)
        levels.append((sums[0] / np.maximum(sums[1], 1e-6) * known, known))
    result = levels[-1][0] / np.maximum(levels[-1][1], 1e-6)
    for color, part in reversed(levels[:-1]):
        upsampled = result.repeat(2, axis=0).repeat(2, axis=1)
        padding = [(0, max(0, color.shape[k] - upsampled.shape[k])) for k in (0, 1)]
        upsampled = np.pad(upsampled, [*padding, (0, 0)], mode="edge")
        result = color + upsampled[: color.shape[0], : color.shape[1]] * (1 - part)
    return np.asarray(result, dtype=np.float32)


def fill_gaps_mirrored(image: F32, covered: NDArray[np.bool_]) -> F32:
    """Returns an image, (H, W, C), with gaps filled by mirroring the charts at their edges.

    The gaps are then as noisy as the charts, so that the denoiser sees no edge. Pixels far from all charts are filled by ``fill_gaps``.
    """
    rows, columns, is_found = _nearest(covered)
    height, width = covered.shape
    y, x = np.mgrid[:height, :width]
    mirror_y, mirror_x = np.clip(2 * rows - y, 0, height - 1), np.clip(2 * columns - x, 0, width - 1)
    is_covered = covered[mirror_y, mirror_x]
    nearby = image[np.where(is_covered, mirror_y, rows), np.where(is_covered, mirror_x, columns)]
    result = np.where(covered[..., None], image, np.where(is_found[..., None], nearby, fill_gaps(image, covered)))
    return np.asarray(result, dtype=np.float32)


def median_filtered(image: F32) -> F32:
    """Returns the median of each pixel of an image, (H, W, C), and its eight neighbours: less noise, the same edges."""
    padded = np.pad(image, [(1, 1), (1, 1), (0, 0)], mode="edge")
    height, width = image.shape[:2]
    return np.asarray(np.median([padded[j : j + height, i : i + width] for j in range(3) for i in range(3)], axis=0))


def limit_outliers(image: F32) -> F32:
    """Returns an image, (H, W, C), without single pixels far brighter than their neighbours, which a denoiser would spread to a stain.

    Each value is at most 3 times the second largest of the eight around it.
    """
    padded = np.pad(image, [(1, 1), (1, 1), (0, 0)], mode="edge")
    height, width = image.shape[:2]
    around = [padded[j : j + height, i : i + width] for j in range(3) for i in range(3) if (j, i) != (1, 1)]
    largest, second = around[0], np.full_like(image, -np.inf)
    for values in around[1:]:
        second = np.maximum(second, np.minimum(largest, values))
        largest = np.maximum(largest, values)
    return np.asarray(np.minimum(image, 3.0 * second))


def _nearest(covered: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_]]:
    """Returns row and column of the nearest covered pixel of each pixel, and whether one is within about ``_SEARCH_RADIUS``, by jump flooding.

    Rong, Tan, "Jump Flooding in GPU with Applications to Voronoi Diagram and Distance Transform", I3D 2006.
    """
    y, x = np.mgrid[: covered.shape[0], : covered.shape[1]].astype(np.int32)
    rows, columns, is_found = y.copy(), x.copy(), covered.copy()
    step = min(_SEARCH_RADIUS, *(n - 1 for n in covered.shape))
    while step:
        for j, i in ((j, i) for j in (-step, 0, step) for i in (-step, 0, step) if j or i):
            pixels, neighbours = _overlap(j, i, covered.shape)
            r, c, neighbour_found = rows[neighbours], columns[neighbours], is_found[neighbours]
            new_distance = (r - y[pixels]) ** 2 + (c - x[pixels]) ** 2
            old_distance = (rows[pixels] - y[pixels]) ** 2 + (columns[pixels] - x[pixels]) ** 2
            is_nearer = neighbour_found & (~is_found[pixels] | (new_distance < old_distance))
            rows[pixels] = np.where(is_nearer, r, rows[pixels])
            columns[pixels] = np.where(is_nearer, c, columns[pixels])
            is_found[pixels] |= is_nearer
        step //= 2
    return rows, columns, is_found


def _overlap(j: int, i: int, shape: tuple[int, ...]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Returns the slices of all pixels that have a neighbour ``j`` rows and ``i`` columns away, and those of the neighbours."""
    pairs = [(slice(max(-k, 0), n - max(k, 0)), slice(max(k, 0), n - max(-k, 0))) for k, n in ((j, shape[0]), (i, shape[1]))]
    return (pairs[0][0], pairs[1][0]), (pairs[0][1], pairs[1][1])


def hidden_texels(inside: NDArray[np.bool_], near: NDArray[np.bool_], covered: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Returns the mask, (H, W), of texels whose light must not bleed onto visible ones.

    These are the texels inside solids, as on a wall behind its skirting, and in narrow gaps, as behind a wardrobe, that lie beside texels in the
    open; deeper in a gap, a camera can see that it is dark.

    Args:
        inside: mask of texels inside solids, (H, W).
        near: mask of texels with other surfaces closely around them, (H, W).
        covered: mask of surfaces, (H, W).
    """
    in_the_open = np.pad(covered & ~inside & ~near, _GAP_PX)
    height, width = covered.shape
    shifts = range(2 * _GAP_PX + 1)
    beside = np.logical_or.reduce([in_the_open[j : j + height, i : i + width] for j in shifts for i in shifts])
    return np.asarray(covered & (inside | near) & beside)


def _dilated(image: F32, covered: F32) -> tuple[F32, F32]:
    """Returns image and coverage, (H, W, 1), with all charts dilated by one pixel."""
    padded, mask = (np.pad(a, [(1, 1), (1, 1), (0, 0)]) for a in (image * covered, covered))
    height, width = image.shape[:2]
    total, count = np.zeros_like(image), np.zeros_like(covered)
    for j in range(3):
        for i in range(3):
            total += padded[j : j + height, i : i + width]
            count += mask[j : j + height, i : i + width]
    return np.where(covered > 0, image, total / np.maximum(count, 1)), np.minimum(count, 1.0)


def exposure_factors(samples: list[F32]) -> F32:
    """Returns factors, (3,), of red, green and blue for exposure and white balance.

    Args:
        samples: lit colours, linear, (N, 3) arrays; dark ones, behind and below objects, are ignored.
    """
    values = np.concatenate([a.reshape(-1, 3) for a in samples]).astype(np.float64)
    luminance = values @ LUMINANCE
    is_lit = luminance > 0.06 * np.percentile(luminance, 90)
    mean = values[is_lit].mean(axis=0)
    balance = (mean @ LUMINANCE / np.maximum(mean, 1e-6)) ** _WHITE_BALANCE
    middle = np.exp(np.log(luminance[is_lit]).mean())
    return np.asarray(balance * _MIDDLE_GREY / max(middle, 1e-6), dtype=np.float32)


def tone_map(linear: ArrayLike) -> NDArray[np.uint8]:
    """Tone-maps linear colours to 8-bit sRGB: linear in the shadows, compressed in the highlights.

    The curve is that of Reinhard et al., "Photographic Tone Reproduction for Digital Images" (2002), equation 4, on the brightest channel, mixed
    with the same curve on each channel, so that highlights are desaturated.
    """
    color = np.maximum(np.asarray(linear, dtype=np.float32), 0.0)
    peak = np.maximum(color.max(axis=-1, keepdims=True), 1e-6)
    hue_preserving = color * (_reinhard(peak) / peak)
    srgb = srgb_from_linear(0.55 * hue_preserving + 0.45 * _reinhard(color))
    # Slightly more contrast in the middle tones, as in photographs.
    contrasted = srgb + 0.13 * (srgb - 0.5) * (1 - (2 * srgb - 1) ** 2) * 2
    return np.asarray(np.clip(np.round(contrasted * 255), 0, 255), dtype=np.uint8)


def _reinhard(value: F32) -> F32:
    return np.minimum(value * (1 + value / _WHITE_POINT**2) / (1 + value) * 1.06, 1.0)

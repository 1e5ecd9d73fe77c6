"""Finishes baked light maps: smooths narrow charts, stitches seams, fills the gaps between charts, and encodes the light as 16-bit images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import cg

from gibson_sim.formats.light_maps import WHITE, encoded_light_map
from gibson_sim.geometry.triangle_meshes import unit_normals
from gibson_sim.writing import write_file
from gibson_sim_tools.making.blender.charts import chart_map
from gibson_sim_tools.making.pixels import F32, fill_gaps

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
_CODE_STEP = 16
"""Codes are multiples of it: 12 significant bits are enough, and the files are half as large."""
_NARROW_CHART_PX = 12
"""Width up to which the light of a chart is smoothed, texels."""
_SMOOTH_ANGLE_COS = float(np.cos(np.radians(42.0)))
"""Cosine of the angle between triangles up to which a surface is smooth."""
_SEAM_WEIGHT, _SMOOTHNESS, _FIDELITY = 20.0, 0.4, 0.02
"""Weights in the correction of seams: equality at seams, equal correction of neighbouring texels, small correction."""
_MIN_AREA = 1e-10
"""Twice the area in the light map, of edge 1, up to which a triangle is a line."""
_MAX_SAMPLES = 64
"""Maximum number of samples on one edge of a triangle."""


def smooth_small_charts(light: F32, charts: I64) -> None:
    """Smooths the light along narrow charts, which have too few texels for the denoiser.

    Args:
        light: light on white, linear, (H, W, 4); the last channel is 1 on visible surfaces; modified in place.
        charts: column and row of the lower left texel, columns and rows of each chart, (C, 4).
    """
    for x, y, width, height in charts.tolist():
        if min(width, height) > _NARROW_CHART_PX:
            continue
        region = light[y : y + height, x : x + width]
        known = (region[..., 3:] > 0.5).astype(np.float32)
        sigma_across, sigma_along = min(0.8, min(width, height) / 8), 2.5
        sigma_x, sigma_y = (sigma_along, sigma_across) if width >= height else (sigma_across, sigma_along)
        blurred = cv2.GaussianBlur(
            np.concatenate([region[..., :3] * known, known], axis=2), (0, 0), sigma_x, None, sigma_y, cv2.BORDER_CONSTANT
        )
        region[..., :3] = np.where(known > 0, blurred[..., :3] / np.maximum(blurred[..., 3:], 1e-3), region[..., :3])


def fill_hidden(light: F32) -> None:
    """Fills all texels that show no visible surface from those that do. ``light``: (H, W, 4), as above; modified in place."""
    light[..., :3] = fill_gaps(light[..., :3], light[..., 3] > 0.5)


def dilate_charts(light: F32, charts: I64) -> None:
    """Fills the texels between charts from the charts beside them, so that smaller versions of the image mix few others. Arguments as above."""
    covered = np.zeros(light.shape[:2], dtype=bool)
    for x, y, width, height in charts.tolist():
        covered[y : y + height, x : x + width] = True
    for _ in range(2):
        light[..., :3] = fill_gaps(light[..., :3], covered)
        covered = cv2.dilate(covered.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0


def stitch_seams(lights: Sequence[F32], corners: F64, atlas: I64, uv: F64, charts: I64) -> int:
    """Makes the light equal on both sides of the edges at which the charts of a smooth surface meet.

    The correction of all texels minimises the differences at samples on these edges, its differences between neighbouring texels of a chart, and
    its size (linear least squares, conjugate gradients); see Iwanicki, "Lighting technology of The Last of Us", SIGGRAPH 2013 talks.

    Args:
        lights: light maps, (H, W, 4) of equal size, row 0 at the bottom; the last channel is 1 on visible surfaces, -1 on hidden ones; the others
            are modified in place.
        corners: corners of the triangles, (F, 3, 3), m.
        atlas: index of the light map of each triangle, (F,); -1 = none.
        uv: coordinates of the corners in the light map, (F, 3, 2), 0 to 1 from the lower left.
        charts: index of the light map, column and row of the lower left texel, columns and rows of each chart, (C, 5).

    Returns:
        The number of edges.
    """
    first, second = _seams(corners, atlas, uv)
    if not len(first):
        return 0
    height, width = lights[0].shape[:2]
    samples = _samples(first, second, width, height, np.concatenate([light[..., 3].ravel() >= 0.0 for light in lights]))
    used = np.unique(samples.col)
    chart = np.concatenate([chart_map(charts, k, width).ravel() for k in range(len(lights))])
    # Only charts with seams change; rounding puts a little weight on their borders.
    changes = np.isin(chart, np.unique(chart[used])) & (chart >= 0)
    changes[used] = True
    active = np.flatnonzero(changes)
    index = np.full(len(chart), -1)
    index[active] = np.arange(len(active))
    seams = coo_matrix((samples.data, (samples.row, index[samples.col])), (samples.shape[0], len(active))).tocsr()
    rows, columns = [], []
    for step in (1, width):
        neighbour = active[active + step < len(chart)] + step
        own = neighbour - step
        linked = (chart[own] == chart[neighbour]) & (chart[own] >= 0) & ((neighbour % width > 0) | (step > 1))
        rows.append(index[own[linked]])
        columns.append(index[neighbour[linked]])
    a, b = np.concatenate(rows), np.concatenate(columns)
    count = len(active)
    links = coo_matrix((np.ones(len(a)), (a, b)), (count, count)).tocsr()
    links = links + links.T
    laplacian = diags(np.asarray(links.sum(axis=1)).ravel()) - links
    matrix = _SEAM_WEIGHT * (seams.T @ seams) + _SMOOTHNESS * laplacian + _FIDELITY * diags(np.ones(count))
    inverse_diagonal = diags(1.0 / matrix.diagonal())
    flat = np.concatenate([light[..., :3].reshape(-1, 3) for light in lights]).astype(np.float64)
    for channel in range(3):
        right = -_SEAM_WEIGHT * (seams.T @ (seams @ flat[active, channel]))
        correction, _ = cg(matrix, right, rtol=1e-4, maxiter=300, M=inverse_diagonal)
        flat[active, channel] = np.maximum(flat[active, channel] + correction, 0.0)
    for light, values in zip(lights, flat.reshape(len(lights), height, width, 3), strict=True):
        light[..., :3] = values
    return len(first)


def _seams(corners: F64, atlas: I64, uv: F64) -> tuple[F64, F64]:
    """Returns the ends of the edges at which charts of a smooth surface meet, in both charts: (E, 2, 3) each, index of the light map, u, v."""
    # Chamfers have no texels of their own; they would join the charts of sharp edges.
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    lit = np.flatnonzero((atlas >= 0) & (np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) > _MIN_AREA))
    points = np.round(corners[lit].reshape(-1, 3) * 1e5)
    vertex = np.asarray(np.unique(points, axis=0, return_inverse=True)[1]).reshape(-1, 3)
    ends = np.stack([vertex, np.roll(vertex, -1, axis=1)], axis=-1).reshape(-1, 2)
    placed = np.concatenate([np.broadcast_to(atlas[lit][:, None, None], (len(lit), 3, 1)), uv[lit]], axis=2)
    places = np.stack([placed, np.roll(placed, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    normals = np.repeat(unit_normals(corners[lit]), 3, axis=0)
    is_reversed = ends[:, 0] > ends[:, 1]
    ends[is_reversed], places[is_reversed] = ends[is_reversed][:, ::-1], places[is_reversed][:, ::-1]
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, places, normals = ends[order], places[order], normals[order]
    is_shared = (ends[1:] == ends[:-1]).all(axis=1) & (ends[1:, 0] != ends[1:, 1])
    is_smooth = (normals[1:] * normals[:-1]).sum(axis=1) > _SMOOTH_ANGLE_COS
    is_seam = (np.abs(places[1:] - places[:-1]) > 1e-6).any(axis=(1, 2))
    found = np.flatnonzero(is_shared & is_smooth & is_seam)
    return places[found], places[found + 1]


def _samples(first: F64, second: F64, width: int, height: int, visible: NDArray[np.bool_]) -> coo_matrix:
    """Returns the matrix of the differences at samples on edges, rows: samples, columns: texels of all light maps.

    ``visible``: mask of the texels that are not hidden; samples that hidden texels determine on either side have no entries.
    """
    size = np.array([width, height])
    longest = np.maximum(*(np.abs((e[:, 1, 1:] - e[:, 0, 1:]) * size).max(axis=1) for e in (first, second)))
    counts = np.clip(np.ceil(1.5 * longest), 2, _MAX_SAMPLES).astype(np.int64)
    edge = np.repeat(np.arange(len(first)), counts)
    place = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    t = ((place + 0.5) / counts[edge])[:, None]
    texels = np.zeros((2, len(edge), 4), dtype=np.int64)
    weights = np.zeros((2, len(edge), 4))
    for side, ends in enumerate((first, second)):
        pixels = (ends[edge, 0, 1:] * (1 - t) + ends[edge, 1, 1:] * t) * size - 0.5
        low = np.floor(pixels).astype(np.int64)
        part = pixels - low
        for k, (j, i) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
            x, y = np.clip(low[:, 0] + i, 0, width - 1), np.clip(low[:, 1] + j, 0, height - 1)
            texels[side, :, k] = ends[edge, 0, 0].astype(np.int64) * (width * height) + y * width + x
            weights[side, :, k] = (part[:, 0] if i else 1 - part[:, 0]) * (part[:, 1] if j else 1 - part[:, 1])
    is_seen = (weights * visible[texels]).sum(axis=2).min(axis=0) > 0.5
    weights[1] *= -1.0
    rows = np.broadcast_to(np.arange(len(edge))[None, :, None], texels.shape)
    chosen = np.broadcast_to(is_seen[None, :, None], texels.shape) & (weights != 0.0)
    return coo_matrix((weights[chosen], (rows[chosen], texels[chosen])), (len(edge), len(visible)))


def write_light(path: Path, light: F32, intensity: float) -> None:
    """Writes a light map. ``light``: radiance of white surfaces, (H, W, 3), linear, row 0 at the bottom; ``intensity``: the largest."""
    codes = np.round(np.sqrt(np.clip(light / intensity, 0.0, 1.0)) * (WHITE / _CODE_STEP)) * _CODE_STEP
    write_file(path, encoded_light_map(np.minimum(codes, WHITE).astype(np.uint16)[::-1]), durable=False)


def sample_light(light: NDArray[Any], uv: F64) -> F32:
    """Returns the values of an image, (H, W, 3 or more), at coordinates (N, 2), 0 to 1 from row 0, interpolated bilinearly, (N, 3)."""
    height, width = light.shape[:2]
    pixels = uv * [width, height] - 0.5
    low = np.clip(np.floor(pixels), 0, [width - 2, height - 2]).astype(np.int64)
    part = np.clip(pixels - low, 0.0, 1.0).astype(np.float32)
    result = np.zeros((len(uv), 3), dtype=np.float32)
    for j in (0, 1):
        for i in (0, 1):
            weight = (part[:, 0] if i else 1 - part[:, 0]) * (part[:, 1] if j else 1 - part[:, 1])
            result += weight[:, None] * light[low[:, 1] + j, low[:, 0] + i, :3]
    return result

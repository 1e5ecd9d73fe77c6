"""Detects the floors of a scan and replaces their noisy triangles by boxes with level tops."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.geometry.rasterise import Grid
from gibson_sim.geometry.triangle_meshes import areas_of, components, unit_normals

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

SMALLEST_AREA = 1.5
"""Minimum area of a floor, square metres; a smaller level patch, such as the tread of a stair, keeps its triangles."""
LARGEST_BAND = 0.025
"""Maximum half width of the height band of a floor, metres; triangles outside it are not part of the floor."""
SMALLEST_BAND = 0.005
"""Minimum half width of the height band of a floor, metres."""
THICKNESS = 0.1
"""Thickness of the boxes, metres."""
_CELL = 0.025
"""Edge of the grid cells from which boxes are formed, metres."""
_BIN = 0.005
"""Bin width of the histogram of triangle heights, metres."""
_UP = 0.7
"""Minimum z of the unit normal of a floor's triangles; low, since noise tilts small triangles."""
_SIGMAS = 3.0
"""Half width of the height band of a floor, standard deviations of its heights."""
_MAX_ROUGHNESS = 0.012
"""Maximum standard deviation of the heights of a floor, metres; a rougher patch is a slope or a cushion."""
_SPECK, _LARGE_SPECK = 0.02, 0.1
"""Areas below which an isolated component of the mesh near a floor is noise, square metres. Between the two, it is noise only if the share of
its vertices outside the height band is below ``_FEW``."""
_FEW = 0.3
"""Maximum share of the vertices outside the height band for a component between the two areas."""
_SMALLEST_BOX = 9
"""Minimum edge of the square from which a box is grown, cells."""


@dataclass(frozen=True, slots=True)
class Slab:
    """An axis-aligned box with a level top, ``THICKNESS`` high, world frame."""

    low: tuple[float, float]
    """Minimum x and y, metres."""
    high: tuple[float, float]
    """Maximum x and y, metres."""
    top: float
    """Height of its upper face, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class Flattened:
    """A mesh whose floors are replaced by slabs."""

    slabs: tuple[Slab, ...]
    """Interior of all floors."""
    vertices: F64
    """Vertex positions, (V, 3), metres: those of the original mesh, with the vertices of floors moved to the height of the floor."""
    triangles: I64
    """Vertex indices of the triangles that the slabs do not replace, (F, 3)."""
    flat: Bools
    """Mask of the vertices that were moved to the height of a floor, (V,)."""


def flatten_floors(vertices: F64, triangles: I64) -> Flattened:
    """Returns the mesh with slabs in place of the interior of its floors.

    Triangles at the border of a floor are kept, with their corners at its height, so that walls and floor remain connected. Thresholds,
    steps and stairs do not change.

    Args:
        vertices: (V, 3), welded, world metres.
        triangles: (F, 3), facing out of the solid, which is up on floors.
    """
    vertices = vertices.copy()
    keep = np.ones(len(triangles), dtype=bool)
    flat = np.zeros(len(vertices), dtype=bool)
    slabs: list[Slab] = []
    for height, band, region in _levels(vertices, triangles):
        floor = keep & region & (np.abs(vertices[triangles, 2] - height) <= band).all(axis=1)
        floor |= keep & _specks(vertices, triangles, keep & ~floor, height, band)
        at_height = np.unique(triangles[floor])
        grid = Grid.around(vertices[at_height, :2], _CELL)
        mask = grid.cover(vertices[triangles[floor]][:, :, :2])
        mask = np.asarray(ndimage.binary_closing(np.pad(mask, 2), np.ones((3, 3)))[2:-2, 2:-2])
        boxes, covered = _rectangles(np.asarray(ndimage.binary_erosion(mask, np.ones((3, 3)))))
        slabs += [_slab(grid, box, height) for box in boxes]
        vertices[at_height, 2] = height
        flat[at_height] = True
        replaced = floor & _inside(vertices[triangles][:, :, :2], covered, grid)
        keep &= ~replaced
    return Flattened(tuple(slabs), vertices, triangles[keep], flat)


def _levels(vertices: F64, triangles: I64) -> list[tuple[float, float, Bools]]:
    """Returns the level patches, the largest first: height and half width of its band, metres, and a mask of its candidate triangles (F,)."""
    corners = vertices[triangles]
    up = np.flatnonzero(unit_normals(corners)[:, 2] > _UP)
    parts = components(triangles[up], len(vertices))
    areas, z = areas_of(corners[up]), corners[up][:, :, 2].mean(axis=1)
    levels = []
    totals = np.bincount(parts, weights=areas) if len(parts) else np.zeros(0)
    for part in np.flatnonzero(totals >= SMALLEST_AREA):
        members = np.flatnonzero(parts == part)
        while areas[members].sum() >= SMALLEST_AREA:
            height, spread = _peak(z[members], areas[members])
            if spread > _MAX_ROUGHNESS:
                break
            band = float(np.clip(_SIGMAS * spread, SMALLEST_BAND, LARGEST_BAND))
            near = np.abs(z[members] - height) <= band
            area = float(areas[members][near].sum())
            if area < SMALLEST_AREA:
                break
            region = np.zeros(len(triangles), dtype=bool)
            region[up[members[near]]] = True
            levels.append((area, height, band, region))
            # A second level in the same patch must be far from this one; else it is the adjacent slope.
            members = members[np.abs(z[members] - height) > 2 * LARGEST_BAND]
    return [(height, band, region) for _, height, band, region in sorted(levels, key=lambda level: -level[0])]


def _peak(z: F64, areas: F64) -> tuple[float, float]:
    """Returns the height with the largest area, and the standard deviation of the heights about it, metres; z and areas: (N,)."""
    bins = np.floor((z - z.min()) / _BIN).astype(np.int64)
    width = round(2 * LARGEST_BAND / _BIN)
    sums = np.convolve(np.bincount(bins, weights=areas), np.ones(width), mode="same")
    center = float(z.min() + (int(sums.argmax()) + 0.5) * _BIN)
    near = np.abs(z - center) <= LARGEST_BAND
    values, weights = z[near], areas[near]
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    height = float(values[order][int(np.searchsorted(total, 0.5 * total[-1]))])
    deviations = np.sort(np.abs(values - height))
    # The median absolute deviation is 0.6745 standard deviations of a normal distribution, and robust against outliers.
    return height, float(deviations[len(deviations) // 2]) / 0.6745


def _specks(vertices: F64, triangles: I64, others: Bools, height: float, band: float) -> Bools:
    """Returns a mask (F,) of the small isolated components of ``others`` (F,) near a height: bumps of a noisy floor."""
    rows = np.flatnonzero(others)
    out = np.zeros(len(triangles), dtype=bool)
    if not len(rows):
        return out
    parts = components(triangles[rows], len(vertices))
    corners = vertices[triangles[rows]]
    off = np.abs(corners[:, :, 2] - height)
    count = int(parts.max()) + 1
    area = np.bincount(parts, weights=areas_of(corners), minlength=count)
    farthest = np.zeros(count)
    np.maximum.at(farthest, parts, off.max(axis=1))
    vertex, first = np.unique(triangles[rows], return_index=True)
    part_of = parts[first // 3]
    off_floor = np.bincount(part_of, weights=np.abs(vertices[vertex, 2] - height) > band, minlength=count)
    share = off_floor / np.maximum(np.bincount(part_of, minlength=count), 1)
    is_speck = (farthest <= LARGEST_BAND) & ((area < _SPECK) | ((area < _LARGE_SPECK) & (share < _FEW)))
    out[rows[is_speck[parts]]] = True
    return out


def _rectangles(mask: Bools) -> tuple[list[tuple[int, int, int, int]], Bools]:
    """Returns rectangles (first row, first column, last row + 1, last column + 1) in a mask (H, W), and the mask of their cells (H, W).

    Repeatedly extends the largest remaining square on all sides within the mask. Rectangles do not overlap, since a contact with two
    boxes takes twice the time.
    """
    remaining = mask.copy()
    boxes: list[tuple[int, int, int, int]] = []
    while remaining.any():
        # Chessboard distance to the nearest cell outside the remaining mask; cells beyond the border count as outside.
        distance = np.asarray(cv2.distanceTransform(np.pad(remaining.astype(np.uint8), 1), cv2.DIST_C, 3))[1:-1, 1:-1]
        row, column = np.unravel_index(int(distance.argmax()), mask.shape)
        radius = int(distance[row, column]) - 1
        if 2 * radius + 1 < _SMALLEST_BOX:
            break
        box = _extended((int(row) - radius, int(column) - radius, int(row) + radius + 1, int(column) + radius + 1), remaining)
        boxes.append(box)
        remaining[box[0] : box[2], box[1] : box[3]] = False
    return boxes, np.asarray(mask & ~remaining)


def _extended(box: tuple[int, int, int, int], mask: Bools) -> tuple[int, int, int, int]:
    """Returns a rectangle extended up, down, left and right in turn, each as far as all its cells are in the mask (H, W)."""
    top, left, bottom, right = box
    above = np.asarray(mask[:top, left:right].all(axis=1))[::-1]
    top -= int(np.append(above, False).argmin())
    below = mask[bottom:, left:right].all(axis=1)
    bottom += int(np.append(below, False).argmin())
    beside_left = np.asarray(mask[top:bottom, :left].all(axis=0))[::-1]
    left -= int(np.append(beside_left, False).argmin())
    beside_right = mask[top:bottom, right:].all(axis=0)
    right += int(np.append(beside_right, False).argmin())
    return top, left, bottom, right


def _slab(grid: Grid, box: tuple[int, int, int, int], height: float) -> Slab:
    """Returns the slab on a rectangle of cells."""
    top, left, bottom, right = box
    x, y = grid.origin
    step = grid.resolution
    return Slab((x + left * step, y + top * step), (x + right * step, y + bottom * step), height)


def _inside(corners: F64, covered: Bools, grid: Grid) -> Bools:
    """Returns a mask (F,) of the triangles (F, 3, 2), world metres, whose bounding box lies in covered cells (H, W), seen from above."""
    low, high = (
        np.floor((f(corners, axis=1) - np.asarray(grid.origin)) / grid.resolution).astype(np.int64) for f in (np.min, np.max)
    )
    rows, columns = grid.shape
    sums = np.pad(np.cumsum(np.cumsum(covered, axis=0, dtype=np.int64), axis=1), ((1, 0), (1, 0)))
    within = (low >= 0).all(axis=1) & (high[:, 0] < columns) & (high[:, 1] < rows)
    low, high = np.where(within[:, None], low, 0), np.where(within[:, None], high, 0)
    (left, top), (right, bottom) = low.T, high.T + 1
    inside = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
    return np.asarray(within & (inside == (right - left) * (bottom - top)))

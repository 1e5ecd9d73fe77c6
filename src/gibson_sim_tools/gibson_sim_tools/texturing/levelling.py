"""Makes seams invisible: a smooth correction over whole patches, then the rest within a strip along each seam.

Global: one unknown colour for each vertex of each patch; across a seam the difference of the corrected colours is to vanish, within a patch the
correction is to be even: sparse least squares (Lempitsky and Ivanov, "Seamless Mosaicing of Image-Based Texture Maps", CVPR 2007).
Local: Poisson editing (Perez et al., 2003) within 20 pixels of the seam, as in Waechter et al., "Let There Be Color!", ECCV 2014: pixels at
the seam get the mean of both sides, and the change fades into the patch as a membrane.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gibson_sim_tools.texturing.atlas import Atlas
from gibson_sim_tools.texturing.quality import sampled
from gibson_sim_tools.texturing.solving import relax, solve
from gibson_sim_tools.texturing.surface import Adjacency

F16 = NDArray[np.float16]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

STRIPS_PX = (20, 6, 3)
"""Widths of the strips of the local levelling, pixels, one round each: what is left of a step after one changes fast along the seam."""
_ALONG = 7
"""Points on a seam edge at which both sides are compared."""
_MOST_ALONG = 65
"""Most points on a seam edge at which the local levelling compares."""
_EVEN = 0.1
"""Weight of the evenness of a correction within a patch, relative to a seam."""
_ZERO = 0.03
"""Weight of the correction itself: exposures are known already, so that corrections are small."""
_REAL_STEP = 0.1
"""Step over a seam that counts half, sRGB, 0 to 1: larger ones are edges that one of the photographs shows elsewhere."""


@dataclass(frozen=True, slots=True, eq=False)
class Seams:
    """Edges between triangles of different patches, both textured."""

    rows: I64
    """(S, 2): rows of ``Atlas.faces`` of the two triangles."""
    ends: I64
    """(S, 2): the vertices of the edge."""
    points: F64
    """(S, 2, 2, 2): side, end, column and row: the ends in the pages, pixels."""


def find_seams(atlas: Atlas, triangles: I64, adjacency: Adjacency) -> Seams:
    """Returns the seams of an atlas of triangles (F, 3)."""
    row = np.full(len(triangles), -1, dtype=np.int64)
    row[atlas.faces] = np.arange(len(atlas.faces))
    rows = row[adjacency.faces]
    both = np.asarray((rows >= 0).all(axis=1))
    both[both] = atlas.patch[rows[both, 0]] != atlas.patch[rows[both, 1]]
    rows, ends = rows[both], adjacency.edges[both]
    corner = (triangles[atlas.faces[rows]][:, :, None, :] == ends[:, None, :, None]).argmax(axis=3)
    points = np.take_along_axis(atlas.corners[rows], corner[..., None], axis=2)
    return Seams(rows, ends, points)


def colors_along(seams: Seams, atlas: Atlas, pages: list[F16], steps: int = _ALONG) -> F32:
    """Returns the colours (S, 2, T, 3) of both sides at points along the seams, sRGB, 0 to 1."""
    t = np.linspace(0.0, 1.0, steps)[:, None]
    points = seams.points[:, :, None, 0] * (1.0 - t) + seams.points[:, :, None, 1] * t
    page = atlas.page[atlas.patch[seams.rows]]
    out = np.zeros((*points.shape[:3], 3), dtype=np.float32)
    for number, picture in enumerate(pages):
        on = page == number
        out[on] = sampled(picture.astype(np.float32), points[on].astype(np.float32))
    return out


def mean_step(colors: F32) -> float:
    """Returns the mean difference of both sides of the seams, (S, 2, T, 3), over points and channels, in steps of 8 bits."""
    return float(np.abs(np.clip(colors[:, 0], 0, 1) - np.clip(colors[:, 1], 0, 1)).mean() * 255.0) if len(colors) else 0.0


def mean_edge_step(colors: F32) -> float:
    """Returns the same of the mean colours of each edge: without noise and what is finer than an edge, which global levelling cannot change."""
    return mean_step(colors.mean(axis=2, keepdims=True))


def global_levelling(atlas: Atlas, triangles: I64, seams: Seams, colors: F32) -> F32:
    """Returns the colours (N, 3, 3) to add at the corners of the textured triangles.

    Args:
        atlas: the atlas.
        triangles: (F, 3) of the surface.
        seams: its seams.
        colors: (S, 2, T, 3), of both sides along the seams.
    """
    vertices = triangles[atlas.faces]
    span = int(triangles.max()) + 1
    keys, node = np.unique(atlas.patch[:, None] * span + vertices, return_inverse=True)
    node = node.reshape(-1, 3)
    # Across seams: at both ends, the difference of the colours near that end.
    near = np.linspace(1.0, 0.0, colors.shape[2])[:, None]
    step = colors[:, 0] - colors[:, 1]
    across = np.searchsorted(keys, atlas.patch[seams.rows][:, :, None] * span + seams.ends[:, None, :])
    sides = np.concatenate([across[:, :, 0], across[:, :, 1]])
    wanted = np.concatenate([(step * near).sum(axis=1) / near.sum(), (step * near[::-1]).sum(axis=1) / near.sum()])
    weights = 1.0 / (1.0 + (wanted**2).sum(axis=1) / (3.0 * _REAL_STEP**2))
    within = np.unique(np.sort(np.concatenate([node[:, [0, 1]], node[:, [1, 2]], node[:, [2, 0]]]), axis=1), axis=0)
    A = sparse.diags(np.sqrt(weights)) @ _differences(sides, len(keys))
    B = _differences(within, len(keys))
    matrix = (A.T @ A + _EVEN**2 * (B.T @ B) + _ZERO**2 * sparse.identity(len(keys))).tocsr()
    right = -(A.T @ (np.sqrt(weights)[:, None] * wanted))
    return solve(matrix, right)[node].astype(np.float32)


def local_levelling(seams: Seams, atlas: Atlas, pages: list[F16], covers: list[I32]) -> None:
    """Changes the pages within the strips along the seams so that both sides agree there."""
    if len(seams.rows):
        for strip_px in STRIPS_PX:
            _level_strip(seams, atlas, pages, covers, strip_px)


def _level_strip(seams: Seams, atlas: Atlas, pages: list[F16], covers: list[I32], strip_px: int) -> None:
    length = np.linalg.norm(seams.points[:, :, 1] - seams.points[:, :, 0], axis=2).max()
    steps = int(np.clip(np.ceil(length) + 2, 3, _MOST_ALONG))
    colors = colors_along(seams, atlas, pages, steps)
    change = (colors[:, ::-1] - colors) / 2.0
    t = np.linspace(0.0, 1.0, steps)[:, None]
    points = np.rint(seams.points[:, :, None, 0] * (1.0 - t) + seams.points[:, :, None, 1] * t).astype(np.int64)
    page = np.broadcast_to(atlas.page[atlas.patch[seams.rows]][..., None], points.shape[:3])
    patch = np.broadcast_to(atlas.patch[seams.rows][..., None], points.shape[:3])
    for number, picture in enumerate(pages):
        on = page == number
        _fade(picture, covers[number], atlas, patch[on], points[on], change[on], strip_px)


def _fade(picture: F16, cover: I32, atlas: Atlas, patch: I64, points: I64, change: F32, strip_px: int) -> None:
    """Adds to a page the changes (M, 3) at pixels (M, 2) of patches (M,), fading to zero within the strip."""
    height, width = cover.shape
    index = points[:, 1] * width + points[:, 0]
    pixels, number = np.unique(index, return_inverse=True)
    count = np.bincount(number)
    border = np.stack([np.bincount(number, change[:, k]) / count for k in range(3)], axis=1)
    # The patch of each pixel: of the triangle that covers it, or of the seam that runs through it.
    owner = np.full(height * width, -1, dtype=np.int32)
    covered = np.flatnonzero(cover.ravel() >= 0)
    owner[covered] = atlas.patch[cover.ravel()[covered]]
    owner[index] = patch
    away = np.ones((height, width), dtype=np.uint8)
    away.ravel()[pixels] = 0
    near = cv2.distanceTransform(away, cv2.DIST_L2, 5).ravel() <= strip_px
    strip = np.flatnonzero((owner >= 0) & near & (away.ravel() > 0))
    # What is to change: the strip, then the seam, then one more whose change is 0, for all that is farther away.
    place = np.full(height * width, len(strip) + len(pixels), dtype=np.int32)
    place[strip] = np.arange(len(strip))
    place[pixels] = len(strip) + np.arange(len(pixels))
    values = np.concatenate([np.zeros((len(strip), 3)), border, np.zeros((1, 3))]).astype(np.float32)
    neighbours = np.full((len(strip), 4), -1, dtype=np.int32)
    x, y = strip % width, strip // width
    for k, (dx, dy) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
        inside = (x + dx >= 0) & (x + dx < width) & (y + dy >= 0) & (y + dy < height)
        other = np.where(inside, strip + dy * width + dx, strip)
        inside &= owner[other] == owner[strip]
        neighbours[inside, k] = place[other[inside]]
    relax(values, neighbours, (x + y) % 2 == 0, strip_px)
    changed = np.concatenate([strip, pixels])
    flat = picture.reshape(-1, 3)
    flat[changed] += values[:-1].astype(np.float16)


def _differences(pairs: I64, count: int) -> sparse.csr_matrix:
    """Returns the matrix (M, count) that takes values to the differences of pairs (M, 2) of them."""
    rows = np.arange(len(pairs))
    values = np.concatenate([np.ones(len(pairs)), -np.ones(len(pairs))])
    return sparse.csr_matrix((values, (np.tile(rows, 2), pairs.T.ravel())), shape=(len(pairs), count))

"""Seam levelling: global colour adjustment of the patches, then local Poisson blending along the seams.

Global (Lempitsky and Ivanov, "Seamless Mosaicing of Image-Based Texture Maps", CVPR 2007): one colour offset per vertex and patch. Sparse least
squares minimise the colour step across seams and the variation of the offsets within a patch.
Local (Perez et al., "Poisson Image Editing", SIGGRAPH 2003, as in Waechter et al., "Let There Be Color!", ECCV 2014): within 20 pixels of a seam.
Pixels on the seam get the mean of both sides; the correction decays into the patch as the solution of the Laplace equation (membrane).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gibson_sim_tools.texturing.atlas import Atlas
from gibson_sim_tools.texturing.linear_solvers import conjugate_gradients, relax_membrane
from gibson_sim_tools.texturing.quality import sample_bilinear
from gibson_sim_tools.texturing.surface import Adjacency

F16 = NDArray[np.float16]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

STRIPS_PX = (20, 6, 3)
"""Strip widths of the rounds of local levelling, pixels: the step that one round leaves varies fast along the seam and needs a narrower strip."""
_SAMPLES_PER_EDGE = 7
"""Samples along a seam edge."""
_MAX_SAMPLES_PER_EDGE = 65
"""Largest number of samples along a seam edge in the local levelling."""
_SMOOTHNESS_WEIGHT = 0.1
"""Weight of differences of the offset within a patch, relative to seams."""
_ZERO_WEIGHT = 0.03
"""Weight of the offsets themselves: exposures are compensated already, so that offsets are small."""
_TRUE_EDGE_STEP = 0.1
"""Colour step across a seam with weight 1/2, sRGB, 0 to 1: a larger step is an image edge that the two photographs show at different places."""


@dataclass(frozen=True, slots=True, eq=False)
class Seams:
    """S seam edges: mesh edges between textured triangles of different patches."""

    rows: I64
    """(S, 2), rows of ``Atlas.faces`` of the two triangles."""
    ends: I64
    """(S, 2), vertices at the ends of the edge."""
    points: F64
    """(S, 2, 2, 2), indices side, end, (column, row): ends of the edge in the pages, pixels."""


def find_seams(atlas: Atlas, triangles: I64, adjacency: Adjacency) -> Seams:
    """Returns the seam edges of an atlas of triangles (F, 3), vertex indices."""
    atlas_row = np.full(len(triangles), -1, dtype=np.int64)
    atlas_row[atlas.faces] = np.arange(len(atlas.faces))
    rows = atlas_row[adjacency.faces]
    is_seam = np.asarray((rows >= 0).all(axis=1))
    is_seam[is_seam] = atlas.patch[rows[is_seam, 0]] != atlas.patch[rows[is_seam, 1]]
    rows, ends = rows[is_seam], adjacency.edges[is_seam]
    corner = (triangles[atlas.faces[rows]][:, :, None, :] == ends[:, None, :, None]).argmax(axis=3)
    points = np.take_along_axis(atlas.corners[rows], corner[..., None], axis=2)
    return Seams(rows, ends, points)


def colors_along_seams(seams: Seams, atlas: Atlas, pages: list[F16], samples: int = _SAMPLES_PER_EDGE) -> F32:
    """Returns the colours of both sides of each seam edge, (S, 2, T, 3) float32, sRGB, 0 to 1, at T = ``samples`` points along it."""
    t = np.linspace(0.0, 1.0, samples)[:, None]
    points = seams.points[:, :, None, 0] * (1.0 - t) + seams.points[:, :, None, 1] * t
    page = atlas.page[atlas.patch[seams.rows]]
    out = np.zeros((*points.shape[:3], 3), dtype=np.float32)
    for number, image in enumerate(pages):
        on_page = page == number
        out[on_page] = sample_bilinear(image.astype(np.float32), points[on_page].astype(np.float32))
    return out


def mean_color_step(colors: F32) -> float:
    """Returns the mean absolute colour step across seams, from the colours of both sides (S, 2, T, 3), in 8-bit steps."""
    return float(np.abs(np.clip(colors[:, 0], 0, 1) - np.clip(colors[:, 1], 0, 1)).mean() * 255.0) if len(colors) else 0.0


def mean_edge_color_step(colors: F32) -> float:
    """Returns the mean step of the edges' mean colours, which excludes noise and detail that global levelling cannot change."""
    return mean_color_step(colors.mean(axis=2, keepdims=True))


def global_levelling(atlas: Atlas, triangles: I64, seams: Seams, colors: F32) -> F32:
    """Returns the colour offsets (N, 3, 3) float32, sRGB, 0 to 1, at the corners of the N textured triangles.

    Args:
        atlas: the atlas.
        triangles: (F, 3), vertex indices of the surface.
        seams: its seam edges.
        colors: (S, 2, T, 3), colours of both sides along the seams.
    """
    vertices = triangles[atlas.faces]
    span = int(triangles.max()) + 1
    keys, node = np.unique(atlas.patch[:, None] * span + vertices, return_inverse=True)
    node = node.reshape(-1, 3)
    # The target step at an end of a seam edge weights samples by their nearness to that end.
    end_weights = np.linspace(1.0, 0.0, colors.shape[2])[:, None]
    color_steps = colors[:, 0] - colors[:, 1]
    end_nodes = np.searchsorted(keys, atlas.patch[seams.rows][:, :, None] * span + seams.ends[:, None, :])
    node_pairs = np.concatenate([end_nodes[:, :, 0], end_nodes[:, :, 1]])
    target_steps = np.concatenate(
        [
            (color_steps * end_weights).sum(axis=1) / end_weights.sum(),
            (color_steps * end_weights[::-1]).sum(axis=1) / end_weights.sum(),
        ]
    )
    weights = 1.0 / (1.0 + (target_steps**2).sum(axis=1) / (3.0 * _TRUE_EDGE_STEP**2))
    patch_edges = np.unique(np.sort(np.concatenate([node[:, [0, 1]], node[:, [1, 2]], node[:, [2, 0]]]), axis=1), axis=0)
    A = sparse.diags(np.sqrt(weights)) @ _difference_matrix(node_pairs, len(keys))
    B = _difference_matrix(patch_edges, len(keys))
    matrix = (A.T @ A + _SMOOTHNESS_WEIGHT**2 * (B.T @ B) + _ZERO_WEIGHT**2 * sparse.identity(len(keys))).tocsr()
    rhs = -(A.T @ (np.sqrt(weights)[:, None] * target_steps))
    return conjugate_gradients(matrix, rhs)[node].astype(np.float32)


def local_levelling(seams: Seams, atlas: Atlas, pages: list[F16], face_maps: list[I32]) -> None:
    """Blends both sides of the seams within strips along them, in place; one round for each width of ``STRIPS_PX``."""
    if len(seams.rows):
        for strip_px in STRIPS_PX:
            _level_strip(seams, atlas, pages, face_maps, strip_px)


def _level_strip(seams: Seams, atlas: Atlas, pages: list[F16], face_maps: list[I32], strip_px: int) -> None:
    length = np.linalg.norm(seams.points[:, :, 1] - seams.points[:, :, 0], axis=2).max()
    samples = int(np.clip(np.ceil(length) + 2, 3, _MAX_SAMPLES_PER_EDGE))
    colors = colors_along_seams(seams, atlas, pages, samples)
    correction = (colors[:, ::-1] - colors) / 2.0
    t = np.linspace(0.0, 1.0, samples)[:, None]
    points = np.rint(seams.points[:, :, None, 0] * (1.0 - t) + seams.points[:, :, None, 1] * t).astype(np.int64)
    page = np.broadcast_to(atlas.page[atlas.patch[seams.rows]][..., None], points.shape[:3])
    patch = np.broadcast_to(atlas.patch[seams.rows][..., None], points.shape[:3])
    for number, image in enumerate(pages):
        on_page = page == number
        _blend_strip(image, face_maps[number], atlas, patch[on_page], points[on_page], correction[on_page], strip_px)


def _blend_strip(image: F16, face_map: I32, atlas: Atlas, patch: I64, points: I64, correction: F32, strip_px: int) -> None:
    """Adds a membrane to a page, in place: the corrections on the seam pixels, 0 at a distance of ``strip_px``.

    Args:
        image: (H, W, 3) float16, the page, sRGB, 0 to 1; changed.
        face_map: (H, W), of ``face_index_pages``.
        atlas: the atlas.
        patch: (M,), patch of each seam sample.
        points: (M, 2), column and row of each seam sample, pixels.
        correction: (M, 3), correction of each seam sample.
        strip_px: width of the strip, pixels.
    """
    height, width = face_map.shape
    index = points[:, 1] * width + points[:, 0]
    pixels, boundary_row = np.unique(index, return_inverse=True)
    count = np.bincount(boundary_row)
    boundary = np.stack([np.bincount(boundary_row, correction[:, k]) / count for k in range(3)], axis=1)
    # Patch of each pixel: that of its triangle, or of the seam sample on it.
    patch_map = np.full(height * width, -1, dtype=np.int32)
    covered = np.flatnonzero(face_map.ravel() >= 0)
    patch_map[covered] = atlas.patch[face_map.ravel()[covered]]
    patch_map[index] = patch
    off_seam = np.ones((height, width), dtype=np.uint8)
    off_seam.ravel()[pixels] = 0
    is_near = cv2.distanceTransform(off_seam, cv2.DIST_L2, 5).ravel() <= strip_px
    strip = np.flatnonzero((patch_map >= 0) & is_near & (off_seam.ravel() > 0))
    # Rows of ``values``: pixels of the strip (unknowns), seam pixels (boundary), then one zero for all pixels farther away (boundary).
    unknown_index = np.full(height * width, len(strip) + len(pixels), dtype=np.int32)
    unknown_index[strip] = np.arange(len(strip))
    unknown_index[pixels] = len(strip) + np.arange(len(pixels))
    values = np.concatenate([np.zeros((len(strip), 3)), boundary, np.zeros((1, 3))]).astype(np.float32)
    neighbours = np.full((len(strip), 4), -1, dtype=np.int32)
    x, y = strip % width, strip // width
    for k, (dx, dy) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
        is_inside = (x + dx >= 0) & (x + dx < width) & (y + dy >= 0) & (y + dy < height)
        neighbour = np.where(is_inside, strip + dy * width + dx, strip)
        is_inside &= patch_map[neighbour] == patch_map[strip]
        neighbours[is_inside, k] = unknown_index[neighbour[is_inside]]
    relax_membrane(values, neighbours, (x + y) % 2 == 0, strip_px)
    changed_pixels = np.concatenate([strip, pixels])
    flat = image.reshape(-1, 3)
    flat[changed_pixels] += values[:-1].astype(np.float16)


def _difference_matrix(pairs: I64, count: int) -> sparse.csr_matrix:
    """Returns the sparse matrix (M, count) that maps values (count,) to the differences of M pairs, (M, 2) indices."""
    rows = np.arange(len(pairs))
    values = np.concatenate([np.ones(len(pairs)), -np.ones(len(pairs))])
    return sparse.csr_matrix((values, (np.tile(rows, 2), pairs.T.ravel())), shape=(len(pairs), count))

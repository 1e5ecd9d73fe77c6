"""Texture atlas: crops the bounding rectangle of each patch from its photograph and packs the rectangles into pages.

A patch (texture chart) is a connected set of triangles with the same label: one photograph textures them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from gibson_sim_tools.scanning.posed_images import ScanError
from gibson_sim_tools.texturing.rasteriser import barycentric, rasterise_2d
from gibson_sim_tools.texturing.settings import LARGEST_PAGE

Bools = NDArray[np.bool_]
F16 = NDArray[np.float16]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

PADDING_PX = 4
"""Padding around a patch, pixels, so that texture filtering does not bleed colours of other patches."""
_AREA_SLACK = 1.1
"""Assumed area of a page per area of its patches."""
_DILATION_PX = 1.5
"""Dilation of the patches in the face maps, pixels; less than half the gap between two patches."""
_MULTIPLE = 4
"""Page sides are multiples of this, pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Atlas:
    """Placement of N textured triangles in P patches on the pages. Pixel centres are at whole numbers."""

    faces: I64
    """(N,), indices of the textured triangles, ascending."""
    patch: I64
    """(N,), patch of each textured triangle."""
    photograph: I64
    """(P,), photograph of each patch."""
    page: I64
    """(P,), page of each patch."""
    corner: I64
    """(P, 2), column and row of the rectangle's upper left pixel in its page."""
    origin: I64
    """(P, 2), column and row of the same pixel in the photograph; may lie outside the photograph."""
    size: I64
    """(P, 2), width and height of the rectangle, pixels."""
    corners: F64
    """(N, 3, 2), columns and rows of the triangle corners in their pages, pixels."""
    pages: tuple[tuple[int, int], ...]
    """Width and height of each page, pixels."""


def build_atlas(patch: I64, labels: I32, corners: F64, max_side: int = LARGEST_PAGE) -> Atlas:
    """Returns the atlas of the patches of F triangles.

    Args:
        patch: (F,), patch of each triangle, -1 = none.
        labels: (F,), photograph of each triangle.
        corners: (F, 3, 2), corners of each triangle in that photograph, pixels.
        max_side: longest side of a page, pixels.

    Raises:
        ScanError: a patch is larger than a page.
    """
    faces = np.flatnonzero(patch >= 0)
    face_patch = patch[faces]
    count = int(face_patch.max(initial=-1)) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, face_patch, corners[faces].min(axis=1))
    np.maximum.at(high, face_patch, corners[faces].max(axis=1))
    origin = np.floor(low).astype(np.int64) - PADDING_PX
    size = np.ceil(high).astype(np.int64) + PADDING_PX + 1 - origin
    photograph = np.zeros(count, dtype=np.int64)
    photograph[face_patch] = labels[faces]
    if count and int(size.max()) > max_side:
        raise ScanError(
            f"a patch has {int(size.max())} pixels on a side, a page at most {max_side}; give a larger page or smaller photographs"
        )
    page, corner, pages = pack_rectangles(size, max_side)
    page_corners = corners[faces] + (corner - origin)[face_patch][:, None]
    return Atlas(faces, face_patch, photograph, page, corner, origin, size, page_corners, pages)


def pack_rectangles(size: I64, max_side: int) -> tuple[I64, I64, tuple[tuple[int, int], ...]]:
    """Packs rectangles on shelves in order of decreasing height (next-fit decreasing height shelf packing).

    Args:
        size: (P, 2), width and height of the rectangles, pixels.
        max_side: longest side of a page, pixels.

    Returns:
        Page of each rectangle, (P,); its upper left pixel, (P, 2); width and height of each page, pixels.
    """
    count = len(size)
    page, corner = np.zeros(count, dtype=np.int64), np.zeros((count, 2), dtype=np.int64)
    if not count:
        return page, corner, ()
    # The page is about square if one page suffices.
    side = int(np.sqrt(_AREA_SLACK * float(size.prod(axis=1).sum())))
    width = min(_round_up(max(side, int(size[:, 0].max()))), max_side)
    heights: list[int] = []
    x = y = shelf = 0
    current_page = 0
    for k in np.lexsort((np.arange(count), -size[:, 0], -size[:, 1])).tolist():
        w, h = int(size[k, 0]), int(size[k, 1])
        if x + w > width:
            x, y, shelf = 0, y + shelf, 0
        if y + h > max_side:
            heights.append(y)
            current_page, x, y, shelf = current_page + 1, 0, 0, 0
        page[k], corner[k] = current_page, (x, y)
        x, shelf = x + w, max(shelf, h)
    heights.append(y + shelf)
    return page, corner, tuple((width, min(_round_up(h), max_side)) for h in heights)


def _round_up(size_px: int) -> int:
    return -(-size_px // _MULTIPLE) * _MULTIPLE


def blank_pages(atlas: Atlas) -> list[F16]:
    """Returns black pages, each (H, W, 3) float16, sRGB, 0 to 1."""
    return [np.zeros((height, width, 3), dtype=np.float16) for width, height in atlas.pages]


def copy_patches(atlas: Atlas, photograph: int, image: F32, pages: list[F16]) -> None:
    """Copies the rectangles of all patches of one photograph into the pages, in place; border pixels are replicated outside the photograph.

    Args:
        atlas: the atlas.
        photograph: number of the photograph.
        image: (H, W, 3) float32, sRGB, 0 to 1, of the photograph.
        pages: (H, W, 3) float16 each.
    """
    height, width = image.shape[:2]
    for k in np.flatnonzero(atlas.photograph == photograph).tolist():
        (w, h), (u, v), (x, y) = atlas.size[k].tolist(), atlas.origin[k].tolist(), atlas.corner[k].tolist()
        rows, columns = np.clip(np.arange(v, v + h), 0, height - 1), np.clip(np.arange(u, u + w), 0, width - 1)
        pages[int(atlas.page[k])][y : y + h, x : x + w] = image[rows[:, None], columns]


def face_index_pages(atlas: Atlas) -> list[I32]:
    """Returns the face map of each page, (H, W) int32: row of ``atlas.faces`` of the triangle that covers a pixel, -1 = none.

    Patches are dilated by ``_DILATION_PX``, because bilinear samples at their border read pixels whose centres lie outside.
    """
    face_maps = []
    for number, (width, height) in enumerate(atlas.pages):
        rows = np.flatnonzero(atlas.page[atlas.patch] == number)
        indices = rasterise_2d(atlas.corners[rows], width, height)
        face_map = np.where(indices >= 0, rows[indices], -1).astype(np.int32)
        # A triangle that covers no pixel centre gets the free pixels at its corners.
        uncovered = rows[np.bincount(indices[indices >= 0], minlength=len(rows)) == 0]
        x, y = np.rint(atlas.corners[uncovered].reshape(-1, 2)).astype(np.int64).T
        is_free = face_map[y, x] < 0
        face_map[y[is_free], x[is_free]] = np.repeat(uncovered, 3)[is_free]
        distance, (row, column) = distance_transform_edt(face_map < 0, return_indices=True)
        face_maps.append(np.where(distance <= _DILATION_PX, face_map[row, column], -1).astype(np.int32))
    return face_maps


def add_vertex_offsets(atlas: Atlas, pages: list[F16], face_maps: list[I32], offsets: F32) -> None:
    """Adds colour offsets, interpolated linearly over each triangle, to the pages, in place.

    Args:
        atlas: the atlas, with N triangles.
        pages: (H, W, 3) float16 each, sRGB, 0 to 1.
        face_maps: of ``face_index_pages``.
        offsets: (N, 3, 3), colour offset at each corner of each triangle, sRGB, 0 to 1.
    """
    for page, face_map in zip(pages, face_maps, strict=True):
        y, x = np.nonzero(face_map >= 0)
        for begin in range(0, len(x), 1_000_000):
            chunk = slice(begin, begin + 1_000_000)
            rows = face_map[y[chunk], x[chunk]]
            weights = barycentric(atlas.corners[rows], np.stack([x[chunk], y[chunk]], axis=1).astype(np.float64)).clip(0.0, 1.0)
            weights = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
            page[y[chunk], x[chunk]] += np.einsum("nk,nkc->nc", weights, offsets[rows]).astype(np.float16)


def fill_padding(atlas: Atlas, pages: list[F16], face_maps: list[I32]) -> None:
    """Fills the padding of each patch, in place, with the colour of the patch's nearest covered pixel (edge padding)."""
    for k in range(len(atlas.page)):
        (w, h), (x, y), number = atlas.size[k].tolist(), atlas.corner[k].tolist(), int(atlas.page[k])
        face_map = face_maps[number][y : y + h, x : x + w]
        is_empty = face_map < 0
        # A patch of sliver triangles may cover no pixel centre; it keeps the pixels of its photograph.
        if is_empty.all() or not is_empty.any():
            continue
        page = pages[number][y : y + h, x : x + w]
        row, column = distance_transform_edt(is_empty, return_distances=False, return_indices=True)
        page[is_empty] = page[row[is_empty], column[is_empty]]

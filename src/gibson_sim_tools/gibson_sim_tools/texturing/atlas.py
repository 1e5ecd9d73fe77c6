"""Texture pages: the part of a photograph that each patch needs, packed into few images.

A patch is a connected set of triangles that one photograph textures; its texture is the rectangle around it in the photograph.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from gibson_sim_tools.scanning.posed_rgbd import ScanError
from gibson_sim_tools.texturing.drawing import barycentric, draw_flat
from gibson_sim_tools.texturing.settings import LARGEST_PAGE

Bools = NDArray[np.bool_]
F16 = NDArray[np.float16]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

PADDING = 4
"""Pixels around a patch, so that filters of renderers see its colours alone."""
_SLACK = 1.1
"""A page is planned this many times as large as its patches."""
_RIM_PX = 1.5
"""Distance from a patch up to which pixels belong to it; less than half of what lies between two patches."""
_MULTIPLE = 4
"""Sides of pages are multiples of this, pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Atlas:
    """Where every textured triangle lies in the pages. Pixel centres are at whole numbers."""

    faces: I64
    """(N,): the textured triangles, ascending."""
    patch: I64
    """(N,): their patches."""
    photograph: I64
    """(P,): the photograph of each patch."""
    page: I64
    """(P,): the page of each patch."""
    corner: I64
    """(P, 2): column and row of the upper left pixel of the rectangle of each patch in its page."""
    origin: I64
    """(P, 2): the pixel of the photograph that lies there; may be outside of the photograph."""
    size: I64
    """(P, 2): width and height of the rectangle, pixels."""
    corners: F64
    """(N, 3, 2): corners of the triangles in their pages, pixels."""
    pages: tuple[tuple[int, int], ...]
    """Width and height of each page, pixels."""


def plan_atlas(patch: I64, labels: I32, corners: F64, largest: int = LARGEST_PAGE) -> Atlas:
    """Returns where the patches go.

    Args:
        patch: (F,), the patch of each triangle, -1 = none.
        labels: (F,), its photograph.
        corners: (F, 3, 2), its corners in that photograph, pixels.
        largest: longest side of a page, pixels.

    Raises:
        ScanError: a patch is larger than a page.
    """
    faces = np.flatnonzero(patch >= 0)
    of_face = patch[faces]
    count = int(of_face.max(initial=-1)) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, of_face, corners[faces].min(axis=1))
    np.maximum.at(high, of_face, corners[faces].max(axis=1))
    origin = np.floor(low).astype(np.int64) - PADDING
    size = np.ceil(high).astype(np.int64) + PADDING + 1 - origin
    photograph = np.zeros(count, dtype=np.int64)
    photograph[of_face] = labels[faces]
    if count and int(size.max()) > largest:
        raise ScanError(
            f"a patch has {int(size.max())} pixels on a side, a page at most {largest}; give a larger page or smaller photographs"
        )
    page, corner, pages = pack(size, largest)
    moved = corners[faces] + (corner - origin)[of_face][:, None]
    return Atlas(faces, of_face, photograph, page, corner, origin, size, moved, pages)


def pack(size: I64, largest: int) -> tuple[I64, I64, tuple[tuple[int, int], ...]]:
    """Places rectangles (P, 2), width and height, on shelves, the highest first.

    Returns:
        The page of each, (P,), its upper left pixel (P, 2), and width and height of each page, pixels.
    """
    count = len(size)
    page, corner = np.zeros(count, dtype=np.int64), np.zeros((count, 2), dtype=np.int64)
    if not count:
        return page, corner, ()
    # All pages together are about square, if one suffices.
    side = int(np.sqrt(_SLACK * float(size.prod(axis=1).sum())))
    width = min(_rounded(max(side, int(size[:, 0].max()))), largest)
    heights: list[int] = []
    x = y = shelf = 0
    now = 0
    for k in np.lexsort((np.arange(count), -size[:, 0], -size[:, 1])).tolist():
        w, h = int(size[k, 0]), int(size[k, 1])
        if x + w > width:
            x, y, shelf = 0, y + shelf, 0
        if y + h > largest:
            heights.append(y)
            now, x, y, shelf = now + 1, 0, 0, 0
        page[k], corner[k] = now, (x, y)
        x, shelf = x + w, max(shelf, h)
    heights.append(y + shelf)
    return page, corner, tuple((width, min(_rounded(h), largest)) for h in heights)


def _rounded(pixels: int) -> int:
    return -(-pixels // _MULTIPLE) * _MULTIPLE


def blank_pages(atlas: Atlas) -> list[F16]:
    """Returns black pages, (H, W, 3) float16, sRGB, 0 to 1."""
    return [np.zeros((height, width, 3), dtype=np.float16) for width, height in atlas.pages]


def copy_patches(atlas: Atlas, photograph: int, picture: F32, pages: list[F16]) -> None:
    """Copies the rectangles of all patches of one photograph, (H, W, 3), into the pages; beyond its edge, the edge is repeated."""
    height, width = picture.shape[:2]
    for k in np.flatnonzero(atlas.photograph == photograph).tolist():
        (w, h), (u, v), (x, y) = atlas.size[k].tolist(), atlas.origin[k].tolist(), atlas.corner[k].tolist()
        rows, columns = np.clip(np.arange(v, v + h), 0, height - 1), np.clip(np.arange(u, u + w), 0, width - 1)
        pages[int(atlas.page[k])][y : y + h, x : x + w] = picture[rows[:, None], columns]


def face_pages(atlas: Atlas) -> list[I32]:
    """Returns (H, W) for each page: the row of ``atlas.faces`` whose triangle covers each pixel or is nearest to it, -1 = none near.

    Pixels at the rim of a patch belong to it although their centres are outside: colours at the rim are read from them, too.
    """
    out = []
    for number, (width, height) in enumerate(atlas.pages):
        rows = np.flatnonzero(atlas.page[atlas.patch] == number)
        image = draw_flat(atlas.corners[rows], width, height)
        cover = np.where(image >= 0, rows[image], -1).astype(np.int32)
        # Triangles that cover no centre of a pixel: the pixels at their corners are theirs, unless they are of others.
        missing = rows[np.bincount(image[image >= 0], minlength=len(rows)) == 0]
        x, y = np.rint(atlas.corners[missing].reshape(-1, 2)).astype(np.int64).T
        free = cover[y, x] < 0
        cover[y[free], x[free]] = np.repeat(missing, 3)[free]
        away, (row, column) = distance_transform_edt(cover < 0, return_indices=True)
        out.append(np.where(away <= _RIM_PX, cover[row, column], -1).astype(np.int32))
    return out


def add_at_corners(atlas: Atlas, pages: list[F16], covers: list[I32], change: F32) -> None:
    """Adds colours (N, 3, 3), given at the corners of the triangles and linear between them, to the pixels that the triangles cover."""
    for page, cover in zip(pages, covers, strict=True):
        y, x = np.nonzero(cover >= 0)
        for start in range(0, len(x), 1_000_000):
            part = slice(start, start + 1_000_000)
            rows = cover[y[part], x[part]]
            weights = barycentric(atlas.corners[rows], np.stack([x[part], y[part]], axis=1).astype(np.float64)).clip(0.0, 1.0)
            weights = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
            page[y[part], x[part]] += np.einsum("nk,nkc->nc", weights, change[rows]).astype(np.float16)


def fill_padding(atlas: Atlas, pages: list[F16], covers: list[I32]) -> None:
    """Gives pixels that no triangle covers the colour of the nearest pixel of the same patch."""
    for k in range(len(atlas.page)):
        (w, h), (x, y), number = atlas.size[k].tolist(), atlas.corner[k].tolist(), int(atlas.page[k])
        cover = covers[number][y : y + h, x : x + w]
        empty = cover < 0
        # A patch of slivers may cover no centre of a pixel: it keeps its photograph.
        if empty.all() or not empty.any():
            continue
        page = pages[number][y : y + h, x : x + w]
        row, column = distance_transform_edt(empty, return_distances=False, return_indices=True)
        page[empty] = page[row[empty], column[empty]]

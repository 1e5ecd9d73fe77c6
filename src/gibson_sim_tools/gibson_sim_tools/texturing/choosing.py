"""Chooses the photographs that show most, where there are more than can be used: by their poses and the mesh, without reading one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.photographs.photographs import Photographs
from gibson_sim_tools.texturing.drawing import draw
from gibson_sim_tools.texturing.surface import Surface

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_WIDTH = 64
"""Width of the images in which is counted what photographs show, pixels."""
_CELLS = 24
"""Cells along the longest side of the mesh: what is shown is counted by cells."""
_COARSE = 6000
"""Triangles of the mesh that is drawn, about."""


def choose_photographs(
    surface: Surface, photographs: Photographs, most: int, progress: Callable[[float], None] = lambda _: None
) -> I64:  # fmt: skip
    """Returns the numbers of at most ``most`` photographs, ascending, that together show the surface best.

    One after the other, the photograph is taken that adds most, where what n others show already counts 1 / (1 + n): large parts of the surface
    are shown several times before small ones are once more.
    """
    count = len(photographs)
    if count <= most:
        return np.arange(count)
    cell = float(np.ptp(surface.vertices, axis=0).max()) / _CELLS + 1e-9
    coarse = _coarse(surface)
    # Cells of both sides of a wall differ, since the direction in which triangles face is a part of them.
    corners = coarse.corners
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    side = np.abs(normal).argmax(axis=1) * 2 + (
        np.take_along_axis(normal, np.abs(normal).argmax(axis=1)[:, None], axis=1)[:, 0] > 0
    )
    keys = np.concatenate([np.floor(corners.mean(axis=1) / cell).astype(np.int64), side[:, None]], axis=1)
    part = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    shown = np.zeros((count, int(part.max()) + 1), dtype=np.float32)
    for number, item in enumerate(photographs.items):
        lens = photographs.intrinsics(number)
        small = lens.resized(_WIDTH, max(round(_WIDTH * lens.height / lens.width), 1))
        face = draw(coarse, small, item.T_world_camera).face
        faces, pixels = np.unique(face[face >= 0], return_counts=True)
        facing = np.einsum("ij,ij->i", normal[faces], item.T_world_camera[:3, 3] - corners[faces, 0]) > 0.0
        np.add.at(shown[number], part[faces[facing]], pixels[facing] / face.size)
        progress((number + 1) / count)
    times = np.zeros(shown.shape[1])
    chosen: list[int] = []
    for _ in range(most):
        gain = shown @ (1.0 / (1.0 + times)).astype(np.float32)
        gain[chosen] = -1.0
        best = int(gain.argmax())
        chosen.append(best)
        # A cell that fills a hundredth of a photograph counts as shown once.
        times += np.minimum(100.0 * shown[best], 1.0)
    return np.sort(np.array(chosen))


def _coarse(surface: Surface) -> Surface:
    """Returns a surface of few triangles: vertices in one cell of a grid become one."""
    if len(surface.triangles) <= _COARSE:
        return surface
    # Area grows with the square of the edge: cells of which the area would fill about as many triangles.
    corners = surface.corners
    area = float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()) / 2.0
    edge = 2.0 * np.sqrt(area / _COARSE)
    cells, of_vertex = np.unique(np.floor(surface.vertices / edge).astype(np.int64), axis=0, return_inverse=True)
    of_vertex = of_vertex.ravel()
    number = np.bincount(of_vertex, minlength=len(cells))
    middle = np.stack([np.bincount(of_vertex, surface.vertices[:, k], len(cells)) / number for k in range(3)], axis=1)
    triangles = of_vertex[surface.triangles]
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return Surface(middle, np.unique(triangles[whole], axis=0))

"""Boards that close the floor where no image shows it, so that a robot does not fall out of a room that was scanned in part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from gibson_sim.description.shapes import Shape
from gibson_sim.formats.load_mesh import primitive_mesh
from gibson_sim.formats.mesh import Material, Mesh, MeshPart
from gibson_sim.geometry.rasterise import Grid
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.geometry.triangles import unit_normals
from gibson_sim.types import Pose

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]

_CELL = 0.05
"""Edge of a cell, metres."""
_BELOW, _THICK = 0.008, 0.1
"""Top of the boards below the floor, so that they lie under what was seen, and their thickness, metres."""
_LEVEL, _SAME = 0.95, 0.05
"""Least z component of the normal of a floor, and its largest distance from its height, metres."""
_LOW, _HIGH = -0.15, 2.0
"""Heights above the floor between which the scan says how far the room reaches; a level surface below is a stairwell, which stays open; metres."""
_STOOD = 0.4
"""Radius of the place of who held a camera, metres."""
_REACH = 1.0
"""Distance from floor that was seen, and from such places, up to which it is closed, metres: not whole rooms."""
_WELL = 0.25
"""Least area of a level surface below, square metres; less is noise."""
_COLOR = (0.55, 0.55, 0.55, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class ClosedFloor:
    """The boards."""

    mesh: Mesh
    area: float
    """Area that they close, square metres."""


def closed_floor(vertices: F64, triangles: NDArray[np.integer], eyes: F64, floor_z: float = 0.0) -> ClosedFloor | None:
    """Returns boards for the floor that a scan lacks within its outline; None if it lacks none.

    Args:
        vertices: (V, 3), metres, z up.
        triangles: (F, 3).
        eyes: (N, 3), places of the cameras, below which there was floor.
        floor_z: height of the floor, metres.
    """
    vertices, eyes = vertices - (0.0, 0.0, floor_z), eyes - (0.0, 0.0, floor_z)
    near = (vertices[:, 2] > _LOW) & (vertices[:, 2] < _HIGH)
    turn = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    stood = eyes[(eyes[:, 2] > 0.0) & (eyes[:, 2] < _HIGH), None, :2] + _STOOD * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    points = np.concatenate([vertices[near, :2], stood.reshape(-1, 2)])
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    grid = Grid.around(points, _CELL)
    rows, columns = np.indices(grid.shape)
    middles = np.stack([columns, rows], axis=-1) * _CELL + np.asarray(grid.origin) + _CELL / 2
    inside = (middles @ hull.equations[:, :2].T + hull.equations[:, 2] <= 0.0).all(axis=-1)
    corners = vertices[triangles]
    level = corners[unit_normals(corners)[:, 2] > _LEVEL]
    height = level[:, :, 2].mean(axis=1)
    seen = np.isfinite(grid.heights(level[np.abs(height) < _SAME], np.maximum))
    known = seen.copy()
    column, row = ((stood.reshape(-1, 2) - np.asarray(grid.origin)) / _CELL).astype(np.int64).T
    known[row, column] = True
    if not known.any():
        return None
    inside &= ndimage.distance_transform_edt(~known) * _CELL <= _REACH
    lacking = inside & ~seen & ~_wells(np.isfinite(grid.heights(level[height < _LOW], np.maximum)))
    if not lacking.any():
        return None
    # Boards reach under the rim of what was seen.
    boards = ndimage.binary_dilation(lacking) & inside
    mesh = Mesh((_joined([_board(grid, *box) for box in _rectangles(boards)]),))
    return ClosedFloor(mesh.transformed(matrix_from_pose(Pose((0.0, 0.0, floor_z)))), float(lacking.sum()) * _CELL**2)


def _wells(below: Bools) -> Bools:
    labels, count = ndimage.label(below)
    large = np.bincount(labels.ravel(), minlength=count + 1) * _CELL**2 >= _WELL
    large[0] = False
    return np.asarray(ndimage.binary_dilation(large[labels], iterations=3))


def _rectangles(mask: Bools) -> list[tuple[int, int, int, int]]:
    """Returns rectangles that cover a mask (H, W) without overlap: first row, row behind the last, and the same of the columns."""
    out: list[tuple[int, int, int, int]] = []
    started: dict[tuple[int, int], int] = {}
    for row in range(len(mask) + 1):
        line = np.zeros(mask.shape[1] + 2, dtype=np.int8)
        if row < len(mask):
            line[1:-1] = mask[row]
        edges = np.flatnonzero(np.diff(line))
        runs = set(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
        out += [(first, row, *run) for run, first in started.items() if run not in runs]
        started = {run: started.get(run, row) for run in runs}
    return sorted(out)


def _board(grid: Grid, top: int, bottom: int, left: int, right: int) -> MeshPart:
    size = ((right - left) * _CELL, (bottom - top) * _CELL, _THICK)
    x, y = grid.origin
    middle = (x + (left + right) / 2 * _CELL, y + (top + bottom) / 2 * _CELL, -_BELOW - _THICK / 2)
    return primitive_mesh(Shape("box", size)).transformed(matrix_from_pose(Pose(middle))).parts[0]


def _joined(parts: list[MeshPart]) -> MeshPart:
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return MeshPart(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.normals for part in parts]),
        None,
        np.concatenate([part.triangles + np.uint32(k) for part, k in zip(parts, first, strict=False)]).astype(np.uint32),
        Material("unseen_floor", _COLOR, unlit=True),
    )

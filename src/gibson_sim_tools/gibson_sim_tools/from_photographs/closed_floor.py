"""Fills unobserved floor with thin boxes (boards), so that a robot does not fall through the floor of a partly scanned room."""

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
from gibson_sim.geometry.triangle_meshes import unit_normals
from gibson_sim.types import Pose

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]

_CELL_SIZE = 0.05
"""Edge of a grid cell, metres."""
_OFFSET_BELOW_FLOOR, _THICKNESS = 0.008, 0.1
"""Depth of the boards' top below the floor, so that they lie under the observed floor, and their thickness, metres."""
_MIN_NORMAL_Z, _HEIGHT_TOLERANCE = 0.95, 0.05
"""Least z component of a floor triangle's normal, and its largest distance from the floor height, metres."""
_MIN_HEIGHT, _MAX_HEIGHT = -0.15, 2.0
"""Range of heights above the floor of the vertices that define the outline of the room, metres. A level surface below is a stairwell."""
_STANDING_RADIUS = 0.4
"""Radius of the floor that is assumed below each camera, metres."""
_MAX_DISTANCE = 1.0
"""Largest distance of filled floor from observed or assumed floor, metres; unobserved rooms are not filled."""
_MIN_STAIRWELL_AREA = 0.25
"""Least area of the level surface in a stairwell, square metres; smaller ones are noise."""
_COLOR = (0.55, 0.55, 0.55, 1.0)
"""Colour of the boards, sRGB and alpha, 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class ClosedFloor:
    """Boards that fill unobserved floor."""

    mesh: Mesh
    area: float
    """Filled area, square metres."""


def closed_floor(
    vertices: F64, triangles: NDArray[np.integer], camera_positions: F64, floor_z: float = 0.0
) -> ClosedFloor | None:
    """Returns boards for the unobserved floor within the convex outline of a scan; None = there is none.

    Args:
        vertices: (V, 3), metres, z up.
        triangles: (F, 3), vertex indices.
        camera_positions: (N, 3), metres; there is floor below each camera.
        floor_z: height of the floor, metres.
    """
    vertices, camera_positions = vertices - (0.0, 0.0, floor_z), camera_positions - (0.0, 0.0, floor_z)
    near = (vertices[:, 2] > _MIN_HEIGHT) & (vertices[:, 2] < _MAX_HEIGHT)
    angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    standing_points = camera_positions[
        (camera_positions[:, 2] > 0.0) & (camera_positions[:, 2] < _MAX_HEIGHT), None, :2
    ] + _STANDING_RADIUS * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = np.concatenate([vertices[near, :2], standing_points.reshape(-1, 2)])
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    grid = Grid.around(points, _CELL_SIZE)
    rows, columns = np.indices(grid.shape)
    cell_centres = np.stack([columns, rows], axis=-1) * _CELL_SIZE + np.asarray(grid.origin) + _CELL_SIZE / 2
    is_inside = (cell_centres @ hull.equations[:, :2].T + hull.equations[:, 2] <= 0.0).all(axis=-1)
    corners = vertices[triangles]
    level_triangles = corners[unit_normals(corners)[:, 2] > _MIN_NORMAL_Z]
    height = level_triangles[:, :, 2].mean(axis=1)
    is_observed = np.isfinite(grid.heights(level_triangles[np.abs(height) < _HEIGHT_TOLERANCE], np.maximum))
    is_known = is_observed.copy()
    column, row = ((standing_points.reshape(-1, 2) - np.asarray(grid.origin)) / _CELL_SIZE).astype(np.int64).T
    is_known[row, column] = True
    if not is_known.any():
        return None
    is_inside &= ndimage.distance_transform_edt(~is_known) * _CELL_SIZE <= _MAX_DISTANCE
    is_missing = (
        is_inside & ~is_observed & ~_stairwells(np.isfinite(grid.heights(level_triangles[height < _MIN_HEIGHT], np.maximum)))
    )
    if not is_missing.any():
        return None
    # Boards overlap the border of the observed floor.
    is_board = ndimage.binary_dilation(is_missing) & is_inside
    mesh = Mesh((_concatenate([_board(grid, *box) for box in _rectangles(is_board)]),))
    return ClosedFloor(mesh.transformed(matrix_from_pose(Pose((0.0, 0.0, floor_z)))), float(is_missing.sum()) * _CELL_SIZE**2)


def _stairwells(mask: Bools) -> Bools:
    """Returns the cells (H, W) of stairwells: large components of a mask of level surfaces below the floor, dilated by three cells."""
    labels, count = ndimage.label(mask)
    large = np.bincount(labels.ravel(), minlength=count + 1) * _CELL_SIZE**2 >= _MIN_STAIRWELL_AREA
    large[0] = False
    return np.asarray(ndimage.binary_dilation(large[labels], iterations=3))


def _rectangles(mask: Bools) -> list[tuple[int, int, int, int]]:
    """Returns disjoint rectangles that cover a mask (H, W): first row, last row + 1, first column, last column + 1."""
    rectangles: list[tuple[int, int, int, int]] = []
    open_runs: dict[tuple[int, int], int] = {}
    for row in range(len(mask) + 1):
        line = np.zeros(mask.shape[1] + 2, dtype=np.int8)
        if row < len(mask):
            line[1:-1] = mask[row]
        edges = np.flatnonzero(np.diff(line))
        runs = set(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
        rectangles += [(first_row, row, *run) for run, first_row in open_runs.items() if run not in runs]
        open_runs = {run: open_runs.get(run, row) for run in runs}
    return sorted(rectangles)


def _board(grid: Grid, top: int, bottom: int, left: int, right: int) -> MeshPart:
    size = ((right - left) * _CELL_SIZE, (bottom - top) * _CELL_SIZE, _THICKNESS)
    x, y = grid.origin
    centre = (x + (left + right) / 2 * _CELL_SIZE, y + (top + bottom) / 2 * _CELL_SIZE, -_OFFSET_BELOW_FLOOR - _THICKNESS / 2)
    return primitive_mesh(Shape("box", size)).transformed(matrix_from_pose(Pose(centre))).parts[0]


def _concatenate(parts: list[MeshPart]) -> MeshPart:
    vertex_offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return MeshPart(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.normals for part in parts]),
        None,
        np.concatenate([part.triangles + np.uint32(k) for part, k in zip(parts, vertex_offsets, strict=False)]).astype(np.uint32),
        Material("unseen_floor", _COLOR, unlit=True),
    )

"""The extent of a floor, for views of the whole floor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import SceneError
from gibson_sim.formats.load_mesh import MeshLoader, mesh_folders
from gibson_sim.formats.mesh import merge
from gibson_sim.geometry.rasterise import clip_to_slab
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.maps.floor_map import floor_at
from gibson_sim.maps.traversability import STOREY, find_floors
from gibson_sim.scenes.builder import estimate_floor
from gibson_sim.scenes.scene_meshes import collision_triangles
from gibson_sim.scenes.spec import DrawnScene, SceneSpec
from gibson_sim.scenes.views import FloorExtent

_WALLS = (0.5, 2.1)
"""Height range above the floor, metres, of the objects that bound it; lawns and pavements outside are lower."""
_ALL = (-0.1, _WALLS[1])
"""Height range for floors without walls, metres."""


def extent_of_scene(scene: SceneSpec) -> FloorExtent:
    """Returns the extent of the floor that robots start on, world metres: that of its named rooms, else that of all objects on it.

    Raises:
        SceneError: the scene has no surface at this height.
    """
    level = scene.floors.index(scene.floor_z)
    corners = [point for room in scene.rooms if room.floor == level for point in room.polygon]
    if corners:
        return _extent(np.array(corners, dtype=np.float64), scene.floor_z)
    return extent_of_triangles(*collision_triangles(scene), scene.floor_z)


def extent_of_drawn(scene: DrawnScene, z: float | None = None, roots: Sequence[Path] | None = None) -> FloorExtent:
    """Returns the extent of all objects on a floor of a scene, world metres, computed from its visuals.

    Args:
        scene: the scene, whose files must be on this machine.
        z: height of a point on the floor, such as a robot's, world metres; None = the lowest floor.
        roots: folders that meshes must lie in; None = the folders of the meshes.

    Raises:
        SceneError: a mesh cannot be read, or the scene has no surface at this height.
    """
    still = [visual for visual in scene.visuals if not visual.link]
    folders = roots or mesh_folders(visual.shape for visual in still)
    loader = MeshLoader(folders, textures=False)
    pieces = []
    for visual in still:
        vertices, triangles = loader.shape(visual.shape).merged()
        pieces.append((transform_points(matrix_from_pose(visual.pose), vertices), triangles))
    vertices, triangles = merge(pieces)
    floor_z = estimate_floor(vertices, triangles)
    if z is not None and z - floor_z >= STOREY:
        floors = [floor_z, *(height for height in find_floors(vertices, triangles) if height - floor_z >= STOREY)]
        floor_z = floors[floor_at(floors, z)]
    return extent_of_triangles(vertices, triangles, floor_z)


def extent_of_triangles(vertices: ArrayLike, triangles: ArrayLike, floor_z: float) -> FloorExtent:
    """Returns the extent of all objects on a floor, world metres; that of the floor itself if it is empty.

    Args:
        vertices: (V, 3), world metres.
        triangles: (F, 3), rows of ``vertices``.
        floor_z: height of the floor, world metres.

    Raises:
        SceneError: the scene has no surface at this height.
    """
    corners = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)[np.asarray(triangles, dtype=np.int64).reshape(-1, 3)]
    for low, high in (_WALLS, _ALL):
        inside = clip_to_slab(corners, floor_z + low, floor_z + high).reshape(-1, 2)
        if len(inside):
            return _extent(inside, floor_z)
    raise SceneError(f"the scene has no surface at the height of the floor, {floor_z:g} m; give the view a center and a span")


def _extent(points: NDArray[np.float64], z: float) -> FloorExtent:
    """Returns the bounding rectangle of points (N, 2), world metres."""
    (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return FloorExtent((x0, y0), (x1, y1), z)

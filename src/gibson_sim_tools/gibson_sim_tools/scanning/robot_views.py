"""Share of holes in the views of a robot in a fused mesh."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import Mat4, transform_points
from gibson_sim.maps.floor_map import make_floor_map
from gibson_sim_tools.scanning.coloured_mesh import ColouredMesh
from gibson_sim_tools.view_holes import ROBOT_HEIGHT, ROBOT_RADIUS, ViewHoles, view_holes


def robot_view_holes(
    mesh: ColouredMesh, T_level_mesh: Mat4, progress: Callable[[float], None] = lambda _: None
) -> ViewHoles | None:
    """Returns the share of holes in the views of a robot; None = no position on the floor is free.

    Args:
        mesh: mesh in any frame.
        T_level_mesh: (4, 4), takes its frame to one with z up and the floor at z = 0.
        progress: called with the fraction that is done, 0 to 1.
    """
    vertices = transform_points(T_level_mesh, mesh.vertices)
    try:
        floor = make_floor_map(vertices, mesh.triangles, floor_z=0.0, robot_height=ROBOT_HEIGHT)
    except SceneError:
        return None
    sides = np.ones(len(mesh.triangles), dtype=bool)
    return view_holes(vertices[mesh.triangles], sides, [floor], ROBOT_RADIUS, progress=progress)

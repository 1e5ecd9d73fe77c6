"""The static scene that a scanner sees, with all bodies at rest, and samples of its surface. Knows no OpenGL."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import merge
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.geometry.triangles import spread_over, unit_normals
from gibson_sim.maps.bodies import still_visuals
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import DrawnScene, SceneSpec, drawn_scene
from gibson_sim_tools.scanning.posed_rgbd import ScanError

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]

SOLID_ALPHA = 0.9
"""Least alpha of a surface that gives depth."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """Points spread evenly over a surface, world frame."""

    points: F64
    """(N, 3), metres."""
    normals: F64
    """(N, 3), unit length; either side may be the visible one."""

    def __len__(self) -> int:
        return len(self.points)


def still_scene(scene: SceneSpec, links: tuple[str, ...] = ()) -> DrawnScene:
    """Returns the scene for a renderer: without robots, all bodies static, with ``links`` for the rig."""
    return drawn_scene(replace(scene, visuals=still_visuals(scene), bodies=(), robots=()), links)


def solid_triangles(scene: SceneSpec) -> tuple[F64, NDArray[np.int32]]:
    """Returns all opaque visuals as one mesh in the world frame: vertices (V, 3), triangles (F, 3).

    Raises:
        ScanError: there are none.
    """
    visuals = still_visuals(scene)
    loader = MeshLoader(scene_roots(replace(scene, visuals=visuals)), textures=False)
    pieces = []
    for visual in visuals:
        if visual.color is not None and visual.color[3] < SOLID_ALPHA:
            continue
        for part in loader.shape(visual.shape).parts:
            material = part.material
            if visual.color is None and material.alpha_mode == "blend" and material.base_color[3] < SOLID_ALPHA:
                continue
            pieces.append((transform_points(matrix_from_pose(visual.pose), part.vertices), part.triangles))
    if not pieces:
        raise ScanError(f"scene {scene.name!r}: has no solid surface to scan")
    return merge(pieces)


def sample_surface(vertices: F64, triangles: NDArray[np.int32], count: int, rng: np.random.Generator) -> SurfacePoints:
    """Returns points spread over triangles with uniform density.

    Args:
        vertices: (V, 3), metres.
        triangles: (F, 3), rows of ``vertices``.
        count: number of points.
        rng: source of randomness.
    """
    corners = vertices[triangles]
    points, which = spread_over(corners, count, rng)
    if not len(points):
        raise ScanError("the mesh has no surface: all its triangles are without area")
    return SurfacePoints(points, unit_normals(corners[which]))


def seen_points(surface: SurfacePoints, depth: F32, K: F64, T_world_camera: F64, tolerance: float) -> NDArray[np.bool_]:
    """Returns which points of a surface a depth image shows, (N,).

    Args:
        surface: in the world frame.
        depth: (H, W), metres along the axis; NaN or infinite = none.
        K: (3, 3), pixels.
        T_world_camera: (4, 4), optical frame.
        tolerance: metres between a point and the depth at its pixel.
    """
    local = (surface.points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    ahead = np.flatnonzero(local[:, 2] > 1e-3)
    u = np.rint(K[0, 0] * local[ahead, 0] / local[ahead, 2] + K[0, 2])
    v = np.rint(K[1, 1] * local[ahead, 1] / local[ahead, 2] + K[1, 2])
    height, width = depth.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    ahead = ahead[inside]
    found = depth[v[inside].astype(np.int64), u[inside].astype(np.int64)]
    seen = np.zeros(len(surface), dtype=bool)
    with np.errstate(invalid="ignore"):
        seen[ahead] = np.abs(found - local[ahead, 2]) < tolerance
    return seen

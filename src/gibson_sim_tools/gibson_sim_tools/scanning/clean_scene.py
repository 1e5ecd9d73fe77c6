"""Ground truth of a scan: the static scene with all bodies at rest, its opaque triangles, and samples of its surface. No OpenGL."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import merge
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.geometry.triangle_meshes import spread_over, unit_normals
from gibson_sim.maps.bodies import still_visuals
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import DrawnScene, SceneSpec, drawn_scene
from gibson_sim_tools.scanning.posed_images import ScanError

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]

MIN_OPAQUE_ALPHA = 0.9
"""Least alpha of an opaque surface; only opaque surfaces return depth."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSamples:
    """Points sampled uniformly from a surface, world frame."""

    points: F64
    """(N, 3), metres."""
    normals: F64
    """(N, 3), unit length; either side may be the visible one."""

    def __len__(self) -> int:
        return len(self.points)


def static_scene(scene: SceneSpec, links: tuple[str, ...] = ()) -> DrawnScene:
    """Returns the scene for a renderer: without robots, all bodies static, with ``links`` for the rig."""
    return drawn_scene(replace(scene, visuals=still_visuals(scene), bodies=(), robots=()), links)


def opaque_triangles(scene: SceneSpec) -> tuple[F64, NDArray[np.int32]]:
    """Returns all opaque visuals as one mesh in the world frame: vertices (V, 3), triangles (F, 3).

    Raises:
        ScanError: there are none.
    """
    visuals = still_visuals(scene)
    loader = MeshLoader(scene_roots(replace(scene, visuals=visuals)), textures=False)
    pieces = []
    for visual in visuals:
        if visual.color is not None and visual.color[3] < MIN_OPAQUE_ALPHA:
            continue
        for part in loader.shape(visual.shape).parts:
            material = part.material
            if visual.color is None and material.alpha_mode == "blend" and material.base_color[3] < MIN_OPAQUE_ALPHA:
                continue
            pieces.append((transform_points(matrix_from_pose(visual.pose), part.vertices), part.triangles))
    if not pieces:
        raise ScanError(f"scene {scene.name!r}: has no solid surface to scan")
    return merge(pieces)


def sample_surface(vertices: F64, triangles: NDArray[np.integer], count: int, rng: np.random.Generator) -> SurfaceSamples:
    """Returns points sampled uniformly by area from triangles.

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
    return SurfaceSamples(points, unit_normals(corners[which]))


def visible_points(surface: SurfaceSamples, depth: F32, K: F64, T_world_camera: F64, tolerance: float) -> NDArray[np.bool_]:
    """Returns the mask (N,) of the samples that a depth image shows.

    Args:
        surface: samples, world frame.
        depth: (H, W), metres along the optical axis; NaN or infinite = none.
        K: (3, 3), intrinsic matrix, pixels.
        T_world_camera: (4, 4), optical frame.
        tolerance: largest difference between the depth of a sample and that of its pixel, metres.
    """
    points_camera = (surface.points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    in_front = np.flatnonzero(points_camera[:, 2] > 1e-3)
    u = np.rint(K[0, 0] * points_camera[in_front, 0] / points_camera[in_front, 2] + K[0, 2])
    v = np.rint(K[1, 1] * points_camera[in_front, 1] / points_camera[in_front, 2] + K[1, 2])
    height, width = depth.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    in_front = in_front[inside]
    measured = depth[v[inside].astype(np.int64), u[inside].astype(np.int64)]
    is_visible = np.zeros(len(surface), dtype=bool)
    with np.errstate(invalid="ignore"):
        is_visible[in_front] = np.abs(measured - points_camera[in_front, 2]) < tolerance
    return is_visible

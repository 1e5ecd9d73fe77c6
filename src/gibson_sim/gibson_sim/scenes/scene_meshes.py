"""Folders of a scene's meshes, and its collision shapes as triangles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.load_mesh import MeshLoader, mesh_folders
from gibson_sim.formats.mesh import merge
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec


def scene_roots(scene: SceneSpec) -> tuple[Path, ...]:
    """Returns the allowed folders of the scene's meshes, for a ``MeshLoader``.

    They include the folders of the shapes themselves, since the loader of the scene has already checked their paths.
    """
    return (scene.root, *mesh_folders([v.shape for v in scene.visuals] + [c.shape for c in scene.collisions]))


def shape_triangles(loader: MeshLoader, collision: CollisionSpec) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Returns a collision shape in the world frame: vertices (V, 3), metres, and triangles (F, 3)."""
    vertices, triangles = loader.shape(collision.shape).merged()
    return transform_points(matrix_from_pose(collision.pose), vertices), triangles


def collision_triangles(scene: SceneSpec, loader: MeshLoader | None = None) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Returns all static collision shapes as one mesh in the world frame: vertices (V, 3), metres, and triangles (F, 3).

    Args:
        scene: the scene.
        loader: reads the meshes; None = a new one.
    """
    mesh_loader = loader or MeshLoader(scene_roots(scene), textures=False)
    return merge([shape_triangles(mesh_loader, collision) for collision in scene.collisions])

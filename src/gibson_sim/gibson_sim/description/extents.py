"""Extents of a robot's shapes, computed from points on their surfaces. Pure; the caller provides a reader of mesh files."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf_model import UrdfCollision, UrdfModel, UrdfVisual
from gibson_sim.errors import MeshError
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, transform_points

MeshPoints = Callable[[Path], NDArray[np.float64]]
"""Function that returns the vertices of a mesh file, (N, 3), metres, in its own frame; raises MeshError."""

_CIRCLE = np.linspace(0.0, 2 * np.pi, 73)[:-1]
"""Angles of 72 points on a circle, radians."""


def shape_points(shape: Shape, points: MeshPoints | None = None) -> NDArray[np.float64] | None:
    """Returns points that span a shape, (N, 3), in its frame, metres; None = the mesh cannot be read.

    The points are exact along the axes of the shape: the corners of a box, circles of 72 points on round shapes.
    """
    if shape.kind == "mesh":
        if points is None:
            return None
        try:
            return np.asarray(points(Path(shape.mesh)) * np.array(shape.size), dtype=np.float64)
        except MeshError:
            return None
    if shape.kind == "box":
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return np.asarray(signs * np.array(shape.size) / 2, dtype=np.float64)
    circle = np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE), 0 * _CIRCLE], axis=-1)
    half_length = np.array([0.0, 0.0, shape.size[1] / 2])
    if shape.kind == "cone":
        return np.concatenate([shape.size[0] * circle - half_length, half_length[None]])
    if shape.kind == "cylinder":
        return np.concatenate([shape.size[0] * circle + h * half_length for h in (-1, 1)])
    circles = np.concatenate([circle, circle[:, [2, 0, 1]], circle[:, [1, 2, 0]]])
    if shape.kind == "ellipsoid":
        return np.asarray(circles * np.array(shape.size))
    sphere = shape.size[0] * circles
    if shape.kind == "sphere":
        return sphere
    return np.concatenate([sphere[sphere[:, 2] >= 0] + half_length, sphere[sphere[:, 2] <= 0] - half_length])


def radius_and_top(shape: Shape, T_root_shape: Mat4, points: MeshPoints | None = None) -> tuple[float, float] | None:
    """Returns (maximum distance from the z axis, maximum z), metres; None = unreadable mesh.

    They are exact, except for the radius of tilted cylinders, and for ellipsoids and cones, which are measured at points on their surface.
    """
    center, rotation = T_root_shape[:3, 3], T_root_shape[:3, :3]
    if shape.kind in ("sphere", "capsule"):
        # A capsule spans two spheres.
        offset = rotation[:, 2] * (shape.size[1] / 2 if shape.kind == "capsule" else 0.0)
        ends = center + np.array([[-1.0], [1.0]]) * offset
        return float(np.hypot(ends[:, 0], ends[:, 1]).max()) + shape.size[0], float(ends[:, 2].max()) + shape.size[0]
    local = shape_points(shape, points)
    if local is None:
        return None
    if shape.kind == "cylinder":
        # The farthest point of an off-axis cylinder is in the direction of its centre.
        angle = math.atan2(*(rotation.T @ center)[1::-1])
        ends = np.array([[math.cos(angle), math.sin(angle), h] for h in (-1, 1)]) * (
            shape.size[0],
            shape.size[0],
            shape.size[1] / 2,
        )
        local = np.concatenate([local, ends])
    world = local @ rotation.T + center
    return float(np.hypot(world[:, 0], world[:, 1]).max()), float(world[:, 2].max())


def link_points(
    shapes: Iterable[UrdfCollision | UrdfVisual], T_root_link: Mat4, points: MeshPoints | None = None
) -> NDArray[np.float64]:
    """Returns points that span the shapes of a link, (N, 3), in the root's frame, metres, without meshes that cannot be read."""
    point_sets = [np.zeros((0, 3))]
    for item in shapes:
        local = shape_points(item.shape, points)
        if local is not None:
            point_sets.append(transform_points(T_root_link @ matrix_from_pose(item.pose), local))
    return np.concatenate(point_sets)


def rigid_links(model: UrdfModel, name: str) -> list[str]:
    """Returns a link and its descendants that are connected to it by fixed joints only."""
    names = [name]
    for link in names:
        names += [joint.child for joint in model.joints if joint.kind == "fixed" and joint.parent == link]
    return names

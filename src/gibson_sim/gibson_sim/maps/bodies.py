"""The bodies of a scene at their start poses: collision shapes as triangles, and visuals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.description.urdf import UrdfJoint
from gibson_sim.formats.load_mesh import MeshLoader, mesh_folders
from gibson_sim.formats.mesh import merge
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, pose_from_matrix, transform_points
from gibson_sim.scenes.spec import SceneSpec

F64 = NDArray[np.float64]
Triangles = tuple[F64, NDArray[np.int32]]


def body_triangles(scene: SceneSpec) -> Triangles:
    """Returns vertices (V, 3), world metres, and triangles (F, 3) of the collision shapes of all bodies; convex hulls for meshes."""
    shapes = [c.shape for body in scene.bodies for link in body.model.links for c in link.collisions]
    # The loader of the bodies has already checked each path.
    loader = MeshLoader(mesh_folders(shapes), textures=False)
    known: dict[Shape, Triangles] = {}
    parts: list[Triangles] = []
    for body in scene.bodies:
        T_world_links = link_transforms(body)
        for link in body.model.links:
            for collision in link.collisions:
                if collision.shape not in known:
                    known[collision.shape] = _shape_triangles(loader, collision.shape)
                vertices, triangles = known[collision.shape]
                parts.append((transform_points(T_world_links[link.name] @ matrix_from_pose(collision.pose), vertices), triangles))
    return merge(parts)


def still_visuals(scene: SceneSpec) -> tuple[VisualSpec, ...]:
    """Returns all visuals except those of robots, fixed to the world; those of bodies are at their start poses."""
    out = list(scene.visuals)
    for body in scene.bodies:
        T_world_links = link_transforms(body)
        for visual in body.visuals:
            link = visual.link.removeprefix(f"{body.name}/")
            out.append(replace(visual, link="", pose=pose_from_matrix(T_world_links[link] @ matrix_from_pose(visual.pose))))
    return tuple(out)


def link_transforms(body: BodySpec) -> dict[str, Mat4]:
    """Returns T_world_link, (4, 4), of every link of a body at load."""
    positions = dict(body.joints)
    by_child = {joint.child: joint for joint in body.model.joints}
    out = {body.model.root: matrix_from_pose(body.start)}
    for link in body.model.links[1:]:
        joint = by_child[link.name]
        out[link.name] = out[joint.parent] @ matrix_from_pose(joint.pose) @ _joint_motion(joint, positions.get(joint.name, 0.0))
    return out


def _joint_motion(joint: UrdfJoint, position: float) -> Mat4:
    """Returns T_zero_child, (4, 4): the motion of a joint's child from position 0 to a position, radians or metres."""
    out = np.eye(4)
    axis = np.asarray(joint.axis, dtype=np.float64)
    if joint.kind == "prismatic":
        out[:3, 3] = axis * position
    elif position:
        across = np.cross(np.eye(3), axis)
        out[:3, :3] += math.sin(position) * across + (1.0 - math.cos(position)) * across @ across
    return out


def _shape_triangles(loader: MeshLoader, shape: Shape) -> Triangles:
    """Returns a shape in its own frame; a mesh as its convex hull, whose triangles face outwards."""
    vertices, triangles = loader.shape(shape).merged()
    if shape.kind != "mesh":
        return vertices, triangles
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError):  # flat, or too few corners
        return vertices, triangles
    # Qhull returns the corners of a triangle in either order, and its outward normal.
    a, b, c = (vertices[hull.simplices[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    return vertices, np.where(inwards[:, None], hull.simplices[:, ::-1], hull.simplices).astype(np.int32)

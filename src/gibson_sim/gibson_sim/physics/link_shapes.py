"""Which link of a rigid part a point on its surface belongs to: the engine knows parts alone, of links that fixed joints join. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from gibson_sim.geometry.transforms import Mat4, invert, matrix_from_pose
from gibson_sim.robots.rigid import RigidGroup
from gibson_sim.robots.spec import Shape
from gibson_sim.robots.urdf import UrdfModel
from gibson_sim.scenes.mesh import load_shape

F64 = NDArray[np.float64]


class LinkShapes:
    """The collision shapes of one rigid part, by link."""

    def __init__(self, model: UrdfModel, group: RigidGroup) -> None:
        """Takes the shapes of all links of the group."""
        self._first = group.name
        self._shapes = [
            (name, invert(T_group_link @ matrix_from_pose(item.pose)), item.shape, _planes(item.shape))
            for name, T_group_link in group.members.items()
            for item in model.link(name).collisions
        ]

    def nearest(self, point: F64) -> str:
        """Returns the link whose shape a point, (3,), metres, group's frame, is nearest to; the group's first where none has any."""
        if len({name for name, *_ in self._shapes}) < 2:
            return self._shapes[0][0] if self._shapes else self._first
        return min(self._shapes, key=lambda entry: _distance(entry[1], entry[2], entry[3], point))[0]


def _planes(shape: Shape) -> F64:
    """Returns the planes, (P, 4), outward, of the convex hull of a mesh; none for what is no mesh, or flat."""
    if shape.kind != "mesh":
        return np.zeros((0, 4))
    vertices, _ = load_shape(shape).merged()
    try:
        return np.asarray(ConvexHull(vertices).equations)
    except (QhullError, ValueError):
        return np.zeros((0, 4))


def _distance(T_shape_group: Mat4, shape: Shape, planes: F64, point: F64) -> float:
    """Returns how far a point in the group's frame is outside a shape, metres; below 0 inside."""
    local = T_shape_group[:3, :3] @ point + T_shape_group[:3, 3]
    if shape.kind == "sphere":
        return float(np.linalg.norm(local)) - shape.size[0]
    if shape.kind == "box":
        return _outside([abs(c) - size / 2 for c, size in zip(local.tolist(), shape.size, strict=True)])
    if shape.kind == "cylinder":
        return _outside([math.hypot(local[0], local[1]) - shape.size[0], abs(float(local[2])) - shape.size[1] / 2])
    return float((planes[:, :3] @ local + planes[:, 3]).max()) if len(planes) else math.inf


def _outside(beyond: Sequence[float]) -> float:
    """Returns the distance to a box, or to a cylinder, from how far a point is beyond each pair of sides."""
    return math.hypot(*(max(c, 0.0) for c in beyond)) + min(max(beyond), 0.0)

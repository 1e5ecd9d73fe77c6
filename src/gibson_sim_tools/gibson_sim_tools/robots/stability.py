"""How a robot stands: centre of mass, support polygon, static stability margin, tipping accelerations, footprint. Pure geometry.

All points are in the frame of the base at rest (x forward, y left), but z is the height above the floor. The static stability margin is that of
McGhee and Frank, "On the stability properties of quadruped creeping gaits" (1968): the distance from the projection of the centre of mass to the
nearest edge of the support polygon.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from gibson_sim.description.extents import MeshPoints, link_points, shape_points
from gibson_sim.description.rigid_groups import rigid_groups
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf_model import UrdfModel
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, transform_points

F64 = NDArray[np.float64]

GRAVITY = 9.81
"""m/s^2."""
TOUCHES = 0.002
"""Height above the floor up to which a point counts as standing on it, metres."""
_LOWEST = 0.0005
"""Height above the lowest point of a shape up to which its corners and vertices bear it, metres."""
_UPRIGHT = 1e-3
"""Sine of the angle of a cylinder's axis to the vertical below which its whole rim is its lowest point."""
_DIRECTIONS = 16
"""Directions in which a footprint is measured: it has at most this number of corners."""
_SAME_CORNER = 0.001
"""Distance below which two corners of a polygon are one, or a corner is on an edge, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class Stability:
    """How a robot stands on a level floor."""

    mass: float
    """kg."""
    center_of_mass: F64
    """(3,), metres: x and y in the base frame, z above the floor."""
    support: F64
    """Corners of the support polygon, (N, 2), metres, base frame, counter-clockwise; fewer than three = it stands on a line or a point."""
    assumed: tuple[tuple[str, float], ...] = ()
    """Links without a mass, and the mass that is assumed, kg."""

    @property
    def margin(self) -> float:
        """Static stability margin, metres: distance of the centre of mass from the nearest edge; negative = it falls over."""
        return float(min(distance for _, distance in self._edges())) if len(self.support) >= 3 else 0.0

    @property
    def tilt_margin(self) -> float:
        """Angle of a slope, in the worst direction, from which on it tips over, radians."""
        return math.atan2(self.margin, float(self.center_of_mass[2]))

    def tipping_acceleration(self, direction: tuple[float, float]) -> float:
        """Returns the acceleration from which on the robot tips over, m/s^2, quasi-static; 0 = it falls over at rest.

        Args:
            direction: of the acceleration, a unit vector in the base frame: (1, 0) starts forward, (-1, 0) brakes, (0, 1) turns to the left.
        """
        height = float(self.center_of_mass[2])
        if self.margin <= 0.0 or height <= 0.0:
            return 0.0
        backward = -np.array(direction)
        # The inertial force, -m a, turns the robot over each edge that it points to, against its weight.
        ratios = [distance / float(normal @ backward) for normal, distance in self._edges() if float(normal @ backward) > 1e-6]
        return GRAVITY * min(ratios) / height

    def _edges(self) -> list[tuple[F64, float]]:
        """Returns (outward normal (2,), distance of the centre of mass from it, metres, positive inside) of each edge."""
        found = []
        for a, b in zip(self.support, np.roll(self.support, -1, axis=0), strict=True):
            along = (b - a) / np.linalg.norm(b - a)
            normal = np.array([along[1], -along[0]])
            found.append((normal, float(normal @ (a - self.center_of_mass[:2]))))
        return found


def stability(model: UrdfModel, T_base_links: Mapping[str, Mat4], points: MeshPoints | None = None) -> Stability:
    """Returns how a robot stands.

    Args:
        model: Its links.
        T_base_links: Link -> (4, 4) from the link to the base at rest, z = height above the floor.
        points: Reads meshes; None = they bear nothing.

    Raises:
        RobotError: a joint is of a kind that is not simulated.
    """
    mass, moment = 0.0, np.zeros(3)
    bearing = [np.zeros((0, 2))]
    groups = rigid_groups(model)[0]
    for group in groups:
        T_base_group = T_base_links[group.name]
        mass += group.mass
        moment += group.mass * transform_points(T_base_group, group.center[None])[0]
        for shape, T_group_shape in group.collisions:
            lowest = lowest_points(shape, T_base_group @ T_group_shape, points)
            bearing.append(lowest[lowest[:, 2] < TOUCHES, :2])
    assumed = tuple((group.name, group.mass) for group in groups if group.mass_is_assumed)
    return Stability(mass, moment / mass, convex_polygon(np.concatenate(bearing)), assumed)


def stands_on_line(model: UrdfModel, points: MeshPoints | None = None) -> bool:
    """Returns whether only a line or a point of a robot touches a level floor while it is upright, all joints at 0: two wheels and no caster."""
    transforms = model.transforms()
    lowest = [np.zeros((0, 3))]
    for link in model.links:
        T = transforms[link.name]
        lowest += [lowest_points(item.shape, T @ matrix_from_pose(item.pose), points) for item in link.collisions]
    found = np.concatenate(lowest)
    return len(found) > 0 and len(convex_polygon(found[found[:, 2] < found[:, 2].min() + TOUCHES, :2])) < 3


def lowest_points(shape: Shape, T_base_shape: Mat4, points: MeshPoints | None = None) -> F64:
    """Returns the points by which a shape would stand on a floor, (N, 3), metres, in the frame of ``T_base_shape``; none of an unreadable mesh."""
    center, up = T_base_shape[:3, 3], np.array([0.0, 0.0, 1.0])
    if shape.kind == "sphere":
        return np.asarray((center - shape.size[0] * up)[None])
    if shape.kind == "cylinder":
        axis = T_base_shape[:3, 2]
        across = up - float(up @ axis) * axis
        slope = float(np.linalg.norm(across))
        if slope > _UPRIGHT:
            ends = center + np.array([[-0.5], [0.5]]) * shape.size[1] * axis
            return _near_lowest(ends - shape.size[0] * across / slope)
    own = shape_points(shape, points)
    return np.zeros((0, 3)) if own is None or not len(own) else _near_lowest(transform_points(T_base_shape, own))


def _near_lowest(points: F64) -> F64:
    return np.asarray(points[points[:, 2] < points[:, 2].min() + _LOWEST])


def convex_polygon(points: F64) -> F64:
    """Returns the corners of the convex hull of points, (N, 2), counter-clockwise; of points on a line its ends, of one point that."""
    unique = np.unique(np.round(points, 6), axis=0)
    try:
        return _without_flat_corners(unique[ConvexHull(unique).vertices])
    except (QhullError, ValueError):
        if len(unique) < 2:
            return np.asarray(unique)
        along = unique - unique.mean(axis=0)
        line = along @ np.linalg.svd(along, full_matrices=False)[2][0]
        return np.asarray(unique[[int(line.argmin()), int(line.argmax())]])


def _without_flat_corners(corners: F64) -> F64:
    """Returns a polygon without corners that are less than a millimetre from the line between their neighbours, as meshes have many."""
    kept = list(corners)
    i = 0
    while i < len(kept) and len(kept) > 3:
        before, corner, after = kept[i - 1], kept[i], kept[(i + 1) % len(kept)]
        along, offset = after - before, corner - before
        if abs(along[0] * offset[1] - along[1] * offset[0]) < _SAME_CORNER * float(np.linalg.norm(along)):
            del kept[i]
        else:
            i += 1
    return np.array(kept)


def footprint(model: UrdfModel, T_base_links: Mapping[str, Mat4], points: MeshPoints | None = None) -> F64:
    """Returns a convex polygon, (N, 2), metres, base frame, counter-clockwise, that contains all collision shapes seen from above.

    It has at most 16 corners and touches the shapes in 16 directions, those along x and y among them: a rectangle is exact.
    """
    spanned = [link_points(link.collisions, T_base_links[link.name], points)[:, :2] for link in model.links]
    flat = np.concatenate([np.zeros((0, 2)), *spanned])
    if not len(flat):
        return flat
    angles = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    reach = (flat @ normals.T).max(axis=0)
    corners = []
    for i in range(_DIRECTIONS):
        j = (i + 1) % _DIRECTIONS
        corners.append(np.linalg.solve(normals[[i, j]], reach[[i, j]]))
    kept = [corners[0]]
    for corner in corners[1:]:
        if np.linalg.norm(corner - kept[-1]) > _SAME_CORNER and np.linalg.norm(corner - kept[0]) > _SAME_CORNER:
            kept.append(corner)
    return np.array(kept)


def base_links(T_world_base: Mat4, T_world_links: Mapping[str, Mat4]) -> dict[str, Mat4]:
    """Returns T_base_link, (4, 4), of every link, in a frame at the base, level, with z = 0 on the floor of the world."""
    yaw = math.atan2(T_world_base[1, 0], T_world_base[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    T_base_world = np.eye(4)
    T_base_world[:2, :2] = [[c, s], [-s, c]]
    T_base_world[:2, 3] = -T_base_world[:2, :2] @ T_world_base[:2, 3]
    return {name: T_base_world @ T for name, T in T_world_links.items()}

"""Computes the static stability of a robot: centre of mass, support polygon, static stability margin, tipping accelerations, footprint. Pure.

All points are in the frame of the base at rest (x forward, y left), but z is the height above the floor. The static stability margin follows
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
CONTACT_HEIGHT = 0.002
"""Height above the floor below which a point is in contact with it, m."""
_LOWEST_TOLERANCE = 0.0005
"""Height above the lowest point of a shape up to which its other points bear its weight, too, m."""
_UPRIGHT_SINE = 1e-3
"""Sine of the angle between a cylinder's axis and the vertical below which the whole rim is lowest."""
_FOOTPRINT_DIRECTIONS = 16
"""Number of directions in which the extent of a footprint is measured, and its largest number of corners."""
_CORNER_TOLERANCE = 0.001
"""Distance below which two corners of a polygon coincide, or a corner lies on an edge, m."""


@dataclass(frozen=True, slots=True, eq=False)
class Stability:
    """Static stability of a robot on a level floor."""

    mass: float
    """Total mass, kg."""
    center_of_mass: F64
    """Centre of mass, (3,), m: x and y in the base frame, z above the floor."""
    support: F64
    """Corners of the support polygon, (N, 2), m, base frame, counter-clockwise; fewer than three = contact on a line or at a point."""
    assumed: tuple[tuple[str, float], ...] = ()
    """Links without a mass in the description, and the mass assumed for each, kg."""

    @property
    def margin(self) -> float:
        """Static stability margin, m: distance of the centre of mass from the nearest edge; negative = the robot falls over."""
        return float(min(distance for _, distance in self._edges())) if len(self.support) >= 3 else 0.0

    @property
    def tilt_margin(self) -> float:
        """Slope on which the robot tips over, in the worst direction, radians."""
        return math.atan2(self.margin, float(self.center_of_mass[2]))

    def tipping_acceleration(self, direction: tuple[float, float]) -> float:
        """Returns the quasi-static acceleration at which the robot tips over, m/s^2; 0 = it falls over at rest.

        Args:
            direction: Direction of the acceleration, unit vector, base frame: (1, 0) accelerates forward, (-1, 0) brakes, (0, 1) turns left.
        """
        height = float(self.center_of_mass[2])
        if self.margin <= 0.0 or height <= 0.0:
            return 0.0
        backward = -np.array(direction)
        # The inertial force, -m a, tips the robot over each edge that it points to; the weight counteracts it.
        ratios = [distance / float(normal @ backward) for normal, distance in self._edges() if float(normal @ backward) > 1e-6]
        return GRAVITY * min(ratios) / height

    def _edges(self) -> list[tuple[F64, float]]:
        """Returns the outward normal, (2,), of each edge, and the distance of the centre of mass from the edge, m, positive inside."""
        edges = []
        for a, b in zip(self.support, np.roll(self.support, -1, axis=0), strict=True):
            direction = (b - a) / np.linalg.norm(b - a)
            normal = np.array([direction[1], -direction[0]])
            edges.append((normal, float(normal @ (a - self.center_of_mass[:2]))))
        return edges


def stability(model: UrdfModel, T_base_links: Mapping[str, Mat4], points: MeshPoints | None = None) -> Stability:
    """Returns the static stability of a robot.

    Args:
        model: The robot's links.
        T_base_links: T_base_link, (4, 4), of each link at rest; z = height above the floor.
        points: Reads the vertices of meshes; None = meshes bear no weight.

    Raises:
        RobotError: the type of a joint is not simulated.
    """
    mass, moment = 0.0, np.zeros(3)
    contacts = [np.zeros((0, 2))]
    groups = rigid_groups(model)[0]
    for group in groups:
        T_base_group = T_base_links[group.name]
        mass += group.mass
        moment += group.mass * transform_points(T_base_group, group.center[None])[0]
        for shape, T_group_shape in group.collisions:
            lowest = lowest_points(shape, T_base_group @ T_group_shape, points)
            contacts.append(lowest[lowest[:, 2] < CONTACT_HEIGHT, :2])
    assumed = tuple((group.name, group.mass) for group in groups if group.mass_is_assumed)
    return Stability(mass, moment / mass, convex_polygon(np.concatenate(contacts)), assumed)


def stands_on_line(model: UrdfModel, points: MeshPoints | None = None) -> bool:
    """Returns whether an upright robot, all joints at 0, touches a level floor only on a line or at a point: two wheels without a caster."""
    transforms = model.transforms()
    lowest = [np.zeros((0, 3))]
    for link in model.links:
        T = transforms[link.name]
        lowest += [lowest_points(item.shape, T @ matrix_from_pose(item.pose), points) for item in link.collisions]
    bearing_points = np.concatenate(lowest)
    return (
        len(bearing_points) > 0
        and len(convex_polygon(bearing_points[bearing_points[:, 2] < bearing_points[:, 2].min() + CONTACT_HEIGHT, :2])) < 3
    )


def lowest_points(shape: Shape, T_base_shape: Mat4, points: MeshPoints | None = None) -> F64:
    """Returns the points on which a shape would rest on a floor, (N, 3), m, base frame; empty for an unreadable mesh."""
    center, up = T_base_shape[:3, 3], np.array([0.0, 0.0, 1.0])
    if shape.kind == "sphere":
        return np.asarray((center - shape.size[0] * up)[None])
    if shape.kind == "capsule":
        ends = center + np.array([[-0.5], [0.5]]) * shape.size[1] * T_base_shape[:3, 2]
        return _near_lowest(ends - shape.size[0] * up)
    if shape.kind == "cylinder":
        axis = T_base_shape[:3, 2]
        slope_direction = up - float(up @ axis) * axis
        slope = float(np.linalg.norm(slope_direction))
        if slope > _UPRIGHT_SINE:
            ends = center + np.array([[-0.5], [0.5]]) * shape.size[1] * axis
            return _near_lowest(ends - shape.size[0] * slope_direction / slope)
    vertices = shape_points(shape, points)
    return np.zeros((0, 3)) if vertices is None or not len(vertices) else _near_lowest(transform_points(T_base_shape, vertices))


def _near_lowest(points: F64) -> F64:
    return np.asarray(points[points[:, 2] < points[:, 2].min() + _LOWEST_TOLERANCE])


def convex_polygon(points: F64) -> F64:
    """Returns the convex hull of points, (N, 2), counter-clockwise; the two ends of collinear points; a single point itself."""
    unique = np.unique(np.round(points, 6), axis=0)
    try:
        return _without_flat_corners(unique[ConvexHull(unique).vertices])
    except (QhullError, ValueError):
        if len(unique) < 2:
            return np.asarray(unique)
        centered = unique - unique.mean(axis=0)
        line = centered @ np.linalg.svd(centered, full_matrices=False)[2][0]
        return np.asarray(unique[[int(line.argmin()), int(line.argmax())]])


def _without_flat_corners(corners: F64) -> F64:
    """Returns a polygon without the corners less than a millimetre from the line between their neighbours; meshes have many."""
    kept = list(corners)
    i = 0
    while i < len(kept) and len(kept) > 3:
        previous, corner, following = kept[i - 1], kept[i], kept[(i + 1) % len(kept)]
        along, offset = following - previous, corner - previous
        if abs(along[0] * offset[1] - along[1] * offset[0]) < _CORNER_TOLERANCE * float(np.linalg.norm(along)):
            del kept[i]
        else:
            i += 1
    return np.array(kept)


def footprint(model: UrdfModel, T_base_links: Mapping[str, Mat4], points: MeshPoints | None = None) -> F64:
    """Returns a convex polygon, (N, 2), m, base frame, counter-clockwise, that contains all collision shapes seen from above.

    It has at most 16 corners and is tight in 16 directions, among them x and y, so that a rectangle is exact.
    """
    projected = [link_points(link.collisions, T_base_links[link.name], points)[:, :2] for link in model.links]
    points_2d = np.concatenate([np.zeros((0, 2)), *projected])
    if not len(points_2d):
        return points_2d
    angles = np.arange(_FOOTPRINT_DIRECTIONS) * 2 * np.pi / _FOOTPRINT_DIRECTIONS
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    extents = (points_2d @ normals.T).max(axis=0)
    corners = []
    for i in range(_FOOTPRINT_DIRECTIONS):
        j = (i + 1) % _FOOTPRINT_DIRECTIONS
        corners.append(np.linalg.solve(normals[[i, j]], extents[[i, j]]))
    kept = [corners[0]]
    for corner in corners[1:]:
        if np.linalg.norm(corner - kept[-1]) > _CORNER_TOLERANCE and np.linalg.norm(corner - kept[0]) > _CORNER_TOLERANCE:
            kept.append(corner)
    return np.array(kept)


def base_links(T_world_base: Mat4, T_world_links: Mapping[str, Mat4]) -> dict[str, Mat4]:
    """Returns T_base_link, (4, 4), of every link, in a level base frame with z = 0 on the floor."""
    yaw = math.atan2(T_world_base[1, 0], T_world_base[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    T_base_world = np.eye(4)
    T_base_world[:2, :2] = [[c, s], [-s, c]]
    T_base_world[:2, 3] = -T_base_world[:2, :2] @ T_world_base[:2, 3]
    return {name: T_base_world @ T for name, T in T_world_links.items()}

"""Mass properties of solid shapes of uniform density: of spawned meshes, and for SDF's ``<inertial auto="true">``. Pure, apart from the reader of
meshes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from gibson_sim.description.shapes import Shape
from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.geometry.triangle_meshes import at_a_border, weld

F64 = NDArray[np.float64]
_THINNEST = 1e-3
"""Minimum side of the box that replaces the hull of flat points, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """Mass properties of a solid."""

    mass: float
    """Mass, kg; for a density of 1 kg/m^3 its volume, m^3."""
    center: F64
    """Centre of mass, (3,), metres."""
    inertia: F64
    """Inertia about the centre of mass, (3, 3), kg m^2."""
    is_hull: bool = False
    """Whether it is the convex hull of a mesh whose surface is not closed or not wound consistently."""

    def scaled(self, factor: float) -> Solid:
        """Returns a solid of another density."""
        return replace(self, mass=self.mass * factor, inertia=self.inertia * factor)

    def moved(self, T_frame_solid: F64) -> Solid:
        """Returns the mass properties in another frame; ``T_frame_solid`` (4, 4)."""
        rotation = T_frame_solid[:3, :3]
        return replace(self, center=rotation @ self.center + T_frame_solid[:3, 3], inertia=rotation @ self.inertia @ rotation.T)


def sum_of(solids: Sequence[Solid]) -> Solid | None:
    """Returns the mass properties of several solids, of which parts that overlap count twice; None if there are none."""
    mass = sum(solid.mass for solid in solids)
    if mass <= 0.0:
        return None
    center = np.sum([solid.mass * solid.center for solid in solids], axis=0) / mass
    inertia = np.zeros((3, 3))
    for solid in solids:
        offset = solid.center - center
        inertia += solid.inertia + solid.mass * (float(offset @ offset) * np.eye(3) - np.outer(offset, offset))
    return Solid(mass, center, inertia)


def solid_of(shape: Shape, loader: MeshLoader) -> Solid | None:
    """Returns the mass properties of a shape with a density of 1 kg/m^3, in its own frame; None for a mesh without a volume."""
    a, b, c = shape.size
    center = np.zeros(3)
    if shape.kind == "mesh":
        try:
            vertices, triangles = loader.shape(shape).merged()
        except MeshError:
            return None
        return _mesh(vertices.astype(np.float64), triangles)
    if shape.kind == "box":
        mass = a * b * c
        moments = [mass / 12 * (b * b + c * c), mass / 12 * (a * a + c * c), mass / 12 * (a * a + b * b)]
    elif shape.kind == "sphere":
        mass = 4 / 3 * math.pi * a**3
        moments = [2 / 5 * mass * a * a] * 3
    elif shape.kind == "ellipsoid":
        mass = 4 / 3 * math.pi * a * b * c
        moments = [mass / 5 * (b * b + c * c), mass / 5 * (a * a + c * c), mass / 5 * (a * a + b * b)]
    elif shape.kind == "cylinder":
        mass = math.pi * a * a * b
        moments = [mass / 12 * (3 * a * a + b * b)] * 2 + [mass / 2 * a * a]
    elif shape.kind == "capsule":
        tube, ball = math.pi * a * a * b, 4 / 3 * math.pi * a**3
        mass = tube + ball
        side = tube * (a * a / 4 + b * b / 12) + ball * (2 / 5 * a * a + b * b / 4 + 3 / 8 * a * b)
        moments = [side, side, tube / 2 * a * a + 2 / 5 * ball * a * a]
    else:  # a cone, whose centre of mass is at a quarter of its height
        mass = math.pi * a * a * b / 3
        moments = [3 / 80 * mass * (4 * a * a + b * b)] * 2 + [3 / 10 * mass * a * a]
        center = np.array([0.0, 0.0, -b / 4])
    return Solid(mass, center, np.diag(moments))


def _mesh(vertices: F64, triangles: np.ndarray[tuple[int, ...], np.dtype[np.int32]]) -> Solid | None:
    """Returns the mass properties of a closed surface: those of the tetrahedra between its triangles and the middle of its vertices.

    An open or inconsistently wound one has those of its convex hull; None if it encloses no volume.
    """
    middle = vertices.mean(axis=0)
    welded, corners_of = weld(vertices, triangles)
    if at_a_border(corners_of, len(welded)).any():
        if np.linalg.matrix_rank(welded - welded.mean(axis=0), tol=1e-6 * float(np.ptp(welded, axis=0).max())) < 3:
            return None
        return replace(hull_solid(welded), is_hull=True)
    corners = (vertices - middle)[triangles]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    volume = float(volumes.sum())
    size = float(np.ptp(vertices, axis=0).max(initial=0.0))
    if abs(volume) < 1e-9 * size**3 or not math.isfinite(volume):
        return None
    total = a + b + c
    center = volumes @ total / 4 / volume
    # Second moments of a tetrahedron with a corner at the origin: V / 20 (sum of x x^T + (sum x)(sum x)^T).
    squares = np.einsum("nki,nkj->nij", corners, corners) + np.einsum("ni,nj->nij", total, total)
    second = np.einsum("n,nij->ij", volumes, squares) / 20 - volume * np.outer(center, center)
    inertia = np.trace(second) * np.eye(3) - second
    # An inside-out surface has a negative volume.
    sign = math.copysign(1.0, volume)
    return Solid(sign * volume, middle + center, sign * inertia)


def hull_solid(points: F64) -> Solid:
    """Returns the convex hull of points (N, 3), metres, with a density of 1 kg/m^3; a thin box if they are coplanar or collinear."""
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return _box_solid(points)
    if hull.volume < _THINNEST**3:
        return _box_solid(points)
    # Tetrahedra from an interior point to every triangle of the hull; all lie inside the hull, so their orientation does not matter.
    interior = points[hull.vertices].mean(axis=0)
    corners = points[hull.simplices] - interior
    volumes = np.abs(np.linalg.det(corners)) / 6.0
    volume = float(volumes.sum())
    sums = corners.sum(axis=1)
    center = (volumes[:, None] * sums).sum(axis=0) / (4.0 * volume)
    # Second moments of a tetrahedron with corners 0, v_1, v_2, v_3: V/20 (sum of v_k v_k^T + s s^T), where s is the sum of v_k.
    second = np.einsum("f,fki,fkj->ij", volumes, corners, corners) + np.einsum("f,fi,fj->ij", volumes, sums, sums)
    second = second / 20.0 - volume * np.outer(center, center)
    return Solid(volume, interior + center, np.trace(second) * np.eye(3) - second)


def _box_solid(points: F64) -> Solid:
    """Returns the mass properties of the axis-aligned bounding box of points (N, 3), with a density of 1 kg/m^3."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, _THINNEST)
    volume = float(np.prod(size))
    squares = size**2
    return Solid(volume, (low + high) / 2.0, np.diag(volume / 12.0 * (squares.sum() - squares)))

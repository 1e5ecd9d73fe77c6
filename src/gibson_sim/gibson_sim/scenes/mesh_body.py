"""Builds a rigid body from a mesh file, with the mass and inertia of its convex hull at uniform density."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfLink, UrdfModel, UrdfVisual
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.types import Pose

F64 = NDArray[np.float64]
DENSITY = 300.0
"""Density of the hull, kg/m^3; a typical value for furniture and vessels, which are hollow."""
MASS_RANGE = (0.01, 100.0)
"""Minimum and maximum mass, kg."""
FRICTION = 0.5
"""Coulomb friction coefficient."""
LINK = "body"
"""Name of the only link."""
_THINNEST = 1e-3
"""Minimum side of the box that replaces the hull of flat points, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class MassProperties:
    """Mass properties of a solid of density 1."""

    volume: float
    """Volume, m^3."""
    center: F64
    """Centre of mass in the frame of the points, (3,), metres."""
    inertia: F64
    """Inertia about the centre of mass at density 1, (3, 3), m^5."""


def mesh_body(path: Path, loader: MeshLoader) -> UrdfModel:
    """Returns a model with one link whose visual and collision shape is the mesh; physics uses its convex hull.

    Args:
        path: the mesh file.
        loader: reads the file.

    Raises:
        MeshError: the mesh cannot be used.
    """
    mesh = loader.mesh(path)
    solid = hull_mass_properties(mesh.merged()[0])
    mass = float(np.clip(DENSITY * solid.volume, *MASS_RANGE))
    i = solid.inertia * (mass / solid.volume)
    x, y, z = (float(c) for c in solid.center)
    moments = (i[0, 0], i[0, 1], i[0, 2], i[1, 1], i[1, 2], i[2, 2])
    ixx, ixy, ixz, iyy, iyz, izz = (float(moment) for moment in moments)
    shape = Shape("mesh", (1.0, 1.0, 1.0), str(mesh.files[0]))
    link = UrdfLink(
        LINK,
        (UrdfVisual(shape, Pose(), None),),
        (UrdfCollision(shape, Pose()),),
        Inertial(mass, Pose((x, y, z)), (ixx, ixy, ixz, iyy, iyz, izz)),
        FRICTION,
    )
    return UrdfModel(path.stem, path, (link,), (), mesh.warnings)


def hull_mass_properties(points: F64) -> MassProperties:
    """Returns the mass properties of the convex hull of points (N, 3), metres; those of a thin box if they are coplanar or collinear."""
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return _box_mass_properties(points)
    if hull.volume < _THINNEST**3:
        return _box_mass_properties(points)
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
    return MassProperties(volume, interior + center, np.trace(second) * np.eye(3) - second)


def _box_mass_properties(points: F64) -> MassProperties:
    """Returns the mass properties of the axis-aligned bounding box of points (N, 3)."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, _THINNEST)
    volume = float(np.prod(size))
    squares = size**2
    return MassProperties(volume, (low + high) / 2.0, np.diag(volume / 12.0 * (squares.sum() - squares)))

"""Mass properties of solid shapes of uniform density, for ``<inertial auto="true">``. Pure, apart from the reader of meshes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gibson_sim.description.shapes import Shape
from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.geometry.triangle_meshes import at_a_border, weld
from gibson_sim.scenes.mesh_body import hull_mass_properties
from gibson_sim.scenes.sdf.elements import F64


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
        hull = hull_mass_properties(welded)
        return Solid(hull.volume, hull.center, hull.inertia, is_hull=True)
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

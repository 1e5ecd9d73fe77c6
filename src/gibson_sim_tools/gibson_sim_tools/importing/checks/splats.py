"""How far the splats of a scene and its mesh lie apart: a robot drives and sees depth by the mesh, people look at the splats."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gibson_sim.formats.splats import Splats, load_splats
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.geometry.triangles import areas_of, spread_over, unit_normals
from gibson_sim.scenes.spec import SplatsSpec

F64 = NDArray[np.float64]
SOLID = 0.5
"""Least opacity of a splat that counts: fainter ones are haze and reflections."""
_SPLATS = 20_000
"""Splats that are measured, of all that count."""
_SPACING = 0.02
"""Mean distance of the points on the mesh, metres, unless it would be too many."""
_MOST_POINTS = 1_000_000


@dataclass(frozen=True, slots=True)
class SplatDistance:
    """Distances of the splats of a scene from the nearest surface of its mesh, metres."""

    splats: int
    """Number of all splats."""
    degree: int
    """Of their spherical harmonics."""
    median: float
    """Half of the solid splats are nearer."""
    most: float
    """Nine tenths of them are nearer."""

    def text(self) -> str:
        """Returns the distances as text."""
        return (
            f"{self.splats:,} splats of degree {self.degree}: half of the solid ones are within {100.0 * self.median:.1f} cm of the mesh, "
            f"nine tenths within {100.0 * self.most:.1f} cm"
        )


def splat_distance(spec: SplatsSpec, corners: F64, rng: np.random.Generator) -> SplatDistance:
    """Returns how far the splats and the mesh of a scene lie apart; infinitely if there is no mesh, or no solid splat.

    Args:
        spec: the splats of the scene.
        corners: (F, 3, 3), corners of all triangles that are drawn, world frame, metres.
        rng: chooses what is measured.

    Raises:
        MeshError: the file of the splats cannot be used.
    """
    splats = load_splats(Path(spec.file))
    positions = solid_positions(spec, splats)
    if len(positions) > _SPLATS:
        positions = positions[rng.choice(len(positions), _SPLATS, replace=False)]
    area = float(areas_of(corners).sum()) if len(corners) else 0.0
    if not len(positions) or not area > 0.0:
        return SplatDistance(len(splats), splats.degree, np.inf, np.inf)
    points, which = spread_over(corners, min(round(area / _SPACING**2) + 1000, _MOST_POINTS), rng)
    far, nearest = cKDTree(points).query(positions)
    # Beside a point of the surface the surface itself is nearer than that point, up to where the next point lies.
    across = np.abs(((positions - points[nearest]) * unit_normals(corners)[which[nearest]]).sum(axis=1))
    reach = 2.0 * (area / len(points)) ** 0.5
    distances = np.where(np.sqrt(np.maximum(far**2 - across**2, 0.0)) <= reach, across, far)
    return SplatDistance(len(splats), splats.degree, float(np.median(distances)), float(np.quantile(distances, 0.9)))


def solid_positions(spec: SplatsSpec, splats: Splats) -> F64:
    """Returns the centres, (N, 3), world frame, metres, of the splats that are solid."""
    T_world_file = matrix_from_pose(spec.pose)
    T_world_file[:3, :3] *= spec.scale
    return np.asarray(transform_points(T_world_file, splats.positions[splats.opacities >= SOLID].astype(np.float64)))

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
SPLATS_APART = 0.03
"""Median distance of splats from the mesh, metres, above which pictures and depth show two different rooms."""
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


class Surface:
    """The surface of a mesh as points with normals.

    Args:
        corners: (F, 3, 3), corners of its triangles, metres; with an area.
        rng: places the points.
        most: number of points at most.
    """

    def __init__(self, corners: F64, rng: np.random.Generator, most: int = _MOST_POINTS) -> None:
        area = float(areas_of(corners).sum())
        self.points, which = spread_over(corners, min(round(area / _SPACING**2) + 1000, most), rng)
        """(N, 3), metres."""
        self.normals: F64 = unit_normals(corners)[which]
        """(N, 3)."""
        self._tree = cKDTree(self.points)
        # Beside a point of the surface the surface itself is nearer than that point, up to where the next point lies.
        self._reach = 2.0 * (area / len(self.points)) ** 0.5

    def nearest(self, positions: F64) -> tuple[F64, NDArray[np.int64]]:
        """Returns the distances (N,), metres, of positions (N, 3) from the surface, and the nearest points."""
        far, nearest = self._tree.query(positions)
        across = np.abs(((positions - self.points[nearest]) * self.normals[nearest]).sum(axis=1))
        distances = np.where(np.sqrt(np.maximum(far**2 - across**2, 0.0)) <= self._reach, across, far)
        return distances, np.asarray(nearest, dtype=np.int64)


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
    if not len(positions) or not has_area(corners):
        return SplatDistance(len(splats), splats.degree, np.inf, np.inf)
    return measured(splats, some_of(positions, rng), Surface(corners, rng))


def some_of(positions: F64, rng: np.random.Generator) -> F64:
    """Returns as many of the positions (N, 3) as are measured."""
    return positions[rng.choice(len(positions), _SPLATS, replace=False)] if len(positions) > _SPLATS else positions


def measured(splats: Splats, positions: F64, surface: Surface) -> SplatDistance:
    """Returns the distance of splats, of which solid ones are at ``positions`` (N, 3), from a surface."""
    distances, _ = surface.nearest(positions)
    return SplatDistance(len(splats), splats.degree, float(np.median(distances)), float(np.quantile(distances, 0.9)))


def has_area(corners: F64) -> bool:
    """Returns whether triangles (F, 3, 3) have any area."""
    return bool(len(corners) and areas_of(corners).sum() > 0.0)


def solid_positions(spec: SplatsSpec, splats: Splats) -> F64:
    """Returns the centres, (N, 3), world frame, metres, of the splats that are solid."""
    T_world_file = matrix_from_pose(spec.pose)
    T_world_file[:3, :3] *= spec.scale
    return np.asarray(transform_points(T_world_file, splats.positions[splats.opacities >= SOLID].astype(np.float64)))

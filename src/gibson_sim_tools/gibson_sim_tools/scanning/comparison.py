"""Measures a fused mesh against the scene that was scanned."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.scenes.spec import SceneSpec
from gibson_sim_tools.scanning.clean_scene import SurfacePoints, sample_surface, seen_points, solid_triangles
from gibson_sim_tools.scanning.coloured_mesh import ColouredMesh
from gibson_sim_tools.scanning.posed_rgbd import PosedRgbd
from gibson_sim_tools.scanning.trajectories import read_stamped_poses

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]
Distance = Callable[[F64, NDArray[Any], NDArray[np.int32]], NDArray[np.float32]]
"""(points, vertices, triangles) -> distances from the points to the mesh."""

NEAR = 0.05
"""Distance within which a surface counts as covered, metres."""
POINTS = 50_000
"""Number of samples on each of the two surfaces."""


@dataclass(frozen=True, slots=True)
class DistanceStatistics:
    """Distances from one surface to another, millimetres."""

    median_mm: float
    mean_mm: float
    p95_mm: float
    max_mm: float
    """The one-sided Hausdorff distance, over the points taken."""


@dataclass(frozen=True, slots=True)
class MeshComparison:
    """A fused mesh compared with the scene."""

    triangles: int
    vertices: int
    area_m2: float
    mesh_to_scene: DistanceStatistics
    """Error of the mesh."""
    scene_to_mesh: DistanceStatistics
    """Distances from the surface that the images show: what is missing."""
    shown: float
    """Fraction of all opaque surfaces, also inside and beneath furniture, that an image shows."""
    covered: float
    """Fraction of the shown surface that has the mesh within 5 cm."""

    def as_dict(self) -> dict[str, Any]:
        """Returns the comparison as plain values for JSON."""
        return asdict(self)


def compare(
    mesh: ColouredMesh,
    rgbd: PosedRgbd,
    scene: SceneSpec,
    distance: Distance,
    progress: Callable[[float], None] = lambda _: None,
    *,
    frames: Sequence[int] | None = None,
) -> MeshComparison:
    """Compares a mesh with the scene, both in the frame of the scene.

    Args:
        mesh: fused from ``rgbd``.
        rgbd: the scan; its true poses, if any, decide what it shows.
        scene: the scanned scene.
        distance: distance function from points to a mesh.
        progress: called with the fraction that is done, 0 to 1.
        frames: numbers of the fused frames; None = all.
    """
    rng = np.random.default_rng(0)
    vertices, triangles = solid_triangles(scene)
    clean = sample_surface(vertices, triangles, POINTS, rng)
    shown = shown_points(clean, rgbd, progress, frames)
    own = sample_surface(mesh.vertices.astype(np.float64), mesh.triangles, POINTS, rng)
    there = distance(own.points, vertices, triangles)
    back = distance(clean.points[shown], mesh.vertices, mesh.triangles) if shown.any() else np.array([np.inf], dtype=np.float32)
    return MeshComparison(
        len(mesh.triangles),
        len(mesh.vertices),
        mesh.area,
        _summary(there),
        _summary(back),
        float(shown.mean()),
        float((back < NEAR).mean()),
    )


def shown_points(
    surface: SurfacePoints,
    rgbd: PosedRgbd,
    progress: Callable[[float], None] = lambda _: None,
    frames: Sequence[int] | None = None,
) -> Bools:
    """Returns which points of a surface, (N,), at least one depth image of ``frames`` (None = all) shows to within 5 cm."""
    true = rgbd.folder / "true_poses.txt"
    poses = _true_poses(true, rgbd) if true.is_file() else rgbd.poses
    shown = np.zeros(len(surface), dtype=bool)
    numbers = range(len(rgbd)) if frames is None else frames
    for done, number in enumerate(numbers):
        frame = rgbd[number]
        left = ~shown
        rest = SurfacePoints(surface.points[left], surface.normals[left])
        shown[left] = seen_points(rest, frame.depth, rgbd.intrinsics.matrix, poses[number], NEAR)
        progress((done + 1) / len(numbers))
    return shown


def _true_poses(path: Path, rgbd: PosedRgbd) -> F64:
    _, poses = read_stamped_poses(path)
    return poses if len(poses) == len(rgbd) else rgbd.poses


def _summary(distances: NDArray[np.float32]) -> DistanceStatistics:
    mm = 1000.0 * distances.astype(np.float64)
    return DistanceStatistics(float(np.median(mm)), float(mm.mean()), float(np.percentile(mm, 95)), float(mm.max()))

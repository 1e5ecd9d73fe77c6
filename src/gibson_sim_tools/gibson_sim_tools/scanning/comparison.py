"""Compares a fused mesh with the scanned scene: accuracy, completeness, coverage."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.scenes.spec import SceneSpec
from gibson_sim_tools.scanning.clean_scene import SurfaceSamples, opaque_triangles, sample_surface, visible_points
from gibson_sim_tools.scanning.posed_images import PosedRgbd
from gibson_sim_tools.scanning.trajectories import read_stamped_poses
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]
Distance = Callable[[F64, NDArray[Any], NDArray[np.integer]], NDArray[np.float32]]
"""(points, vertices, triangles) -> distances from the points to the mesh."""

COVERAGE_DISTANCE = 0.05
"""Largest distance of a covered sample to the mesh, and depth tolerance of an observed one, metres."""
SAMPLE_COUNT = 50_000
"""Number of samples on each of the two surfaces."""


@dataclass(frozen=True, slots=True)
class DistanceStatistics:
    """Distances from one surface to another, millimetres."""

    median_mm: float
    mean_mm: float
    p95_mm: float
    max_mm: float
    """One-sided Hausdorff distance, over the samples."""


@dataclass(frozen=True, slots=True)
class MeshComparison:
    """Comparison of a fused mesh with the scene. The names of the fields are keys of its JSON."""

    triangles: int
    vertices: int
    area_m2: float
    mesh_to_scene: DistanceStatistics
    """Accuracy: distances from the mesh to the scene."""
    scene_to_mesh: DistanceStatistics
    """Completeness: distances from the observed surface to the mesh."""
    shown: float
    """Fraction of all opaque surfaces, also inside and beneath furniture, that a depth image shows (observed), 0 to 1."""
    covered: float
    """Fraction of the observed surface within 5 cm of the mesh, 0 to 1."""

    def as_dict(self) -> dict[str, Any]:
        """Returns the comparison as plain values for JSON."""
        return asdict(self)


def compare(
    mesh: TriangleMesh,
    rgbd: PosedRgbd,
    scene: SceneSpec,
    distance: Distance,
    progress: Callable[[float], None] = lambda _: None,
    *,
    frames: Sequence[int] | None = None,
) -> MeshComparison:
    """Compares a mesh with the scene, both in the frame of the scene.

    Args:
        mesh: mesh fused from ``rgbd``.
        rgbd: the scan; observed samples are determined at its true poses, if any.
        scene: the scanned scene.
        distance: distance function from points to a mesh.
        progress: called with the fraction that is done, 0 to 1.
        frames: numbers of the fused frames; None = all.
    """
    rng = np.random.default_rng(0)
    vertices, triangles = opaque_triangles(scene)
    scene_samples = sample_surface(vertices, triangles, SAMPLE_COUNT, rng)
    is_observed = observed_points(scene_samples, rgbd, progress, frames)
    mesh_samples = sample_surface(mesh.vertices, mesh.triangles, SAMPLE_COUNT, rng)
    mesh_to_scene = distance(mesh_samples.points, vertices, triangles)
    scene_to_mesh = (
        distance(scene_samples.points[is_observed], mesh.vertices, mesh.triangles)
        if is_observed.any()
        else np.array([np.inf], dtype=np.float32)
    )
    return MeshComparison(
        len(mesh.triangles),
        len(mesh.vertices),
        mesh.area,
        _summary(mesh_to_scene),
        _summary(scene_to_mesh),
        float(is_observed.mean()),
        float((scene_to_mesh < COVERAGE_DISTANCE).mean()),
    )


def observed_points(
    surface: SurfaceSamples,
    rgbd: PosedRgbd,
    progress: Callable[[float], None] = lambda _: None,
    frames: Sequence[int] | None = None,
) -> Bools:
    """Returns the mask (N,) of the samples that at least one depth image of ``frames`` (None = all) shows, to within 5 cm."""
    true_poses_file = rgbd.folder / "true_poses.txt"
    poses = _true_poses(true_poses_file, rgbd) if true_poses_file.is_file() else rgbd.poses
    is_observed = np.zeros(len(surface), dtype=bool)
    numbers = range(len(rgbd)) if frames is None else frames
    for done, number in enumerate(numbers):
        frame = rgbd[number]
        remaining = ~is_observed
        remaining_samples = SurfaceSamples(surface.points[remaining], surface.normals[remaining])
        is_observed[remaining] = visible_points(
            remaining_samples, frame.depth, rgbd.intrinsics.matrix, poses[number], COVERAGE_DISTANCE
        )
        progress((done + 1) / len(numbers))
    return is_observed


def _true_poses(path: Path, rgbd: PosedRgbd) -> F64:
    _, poses = read_stamped_poses(path)
    return poses if len(poses) == len(rgbd) else rgbd.poses


def _summary(distances: NDArray[np.float32]) -> DistanceStatistics:
    mm = 1000.0 * distances.astype(np.float64)
    return DistanceStatistics(float(np.median(mm)), float(mm.mean()), float(np.percentile(mm, 95)), float(mm.max()))

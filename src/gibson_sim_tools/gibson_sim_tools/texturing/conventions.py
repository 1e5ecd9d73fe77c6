"""Detects the convention of camera poses by photo-consistency on the mesh, and checks the scale of the depth images.

Photographs with correct poses are photo-consistent: they show the same brightness at the same triangle. If they are not, and are in another
convention, the error names that convention.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.mesh import TO_Z_UP
from gibson_sim_tools.importing.checks.gravity import size_text
from gibson_sim_tools.scanning.pose_conventions import reinterpret_poses
from gibson_sim_tools.scanning.posed_images import Photographs, ScanError
from gibson_sim_tools.scanning.settings import AS_READ, AUTO
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh
from gibson_sim_tools.texturing.quality import Views, concatenate_views, face_views, triangle_areas_px
from gibson_sim_tools.texturing.settings import POSE_CONVENTIONS
from gibson_sim_tools.texturing.visibility import visible_faces

F64 = NDArray[np.float64]

_TO_Z_UP = np.block([[TO_Z_UP["y"], np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
_PAIR_COUNT, _LONGEST_SIDE_PX = 6, 160
"""Number of compared pairs of consecutive photographs, and their longest side after scaling, pixels."""
_MIN_CONSISTENCY, _MIN_RATIO = 0.25, 2.0
"""Least score of correct poses, also on surfaces with little texture; least ratio of scores by which another convention is correct."""
_USUAL_CONSISTENCY = 0.12
"""Score below which a warning says so, without depth images that agree with the mesh; nine of ten noisy scans have 0.18 and more."""
_POSITION_SCALES = (0.001, 0.01, 0.1, 0.5, 2.0, 10.0, 100.0, 1000.0)
"""Factors of the positions of cameras that are tested: another unit, or another scale than the mesh."""
_TESTED_CORRELATION, _MAX_ERROR_RATIO, _MIN_COVERAGE_RATIO = 0.9, 0.5, 0.8
"""Correlation below which they are tested; largest ratio of errors (1 - correlation) and least ratio of coverages by which one is correct."""
_MIN_SHARED_VIEWS = 50
"""Least number of views of triangles that two or more photographs show."""
_DEPTH_TOLERANCE, _SCALE_TOLERANCE, _MAX_SPREAD = 0.1, 0.15, 0.1
"""Relative depth errors: largest of a depth that agrees with the mesh, least median of a wrong scale, largest spread of a common scale."""
_MIN_SAMPLES = 200
"""Least number of depth samples that decide about the scale."""


@dataclass(frozen=True, slots=True)
class PhotoConsistency:
    """Photo-consistency of photographs on a mesh."""

    coverage: float
    """Mean fraction of a photograph that front faces of the mesh cover, 0 to 1."""
    correlation: float
    """Correlation of the brightness of the same triangles across photographs, 0 to 1."""

    @property
    def score(self) -> float:
        """Product of both: 0 = none, 1 = perfect."""
        return self.coverage * self.correlation


def with_convention(photographs: Photographs, name: str) -> Photographs:
    """Returns the photographs with their poses read in another convention than that of their layout.

    Args:
        photographs: as their layout was read.
        name: one of ``POSE_CONVENTIONS``, or ``as-read`` = unchanged.

    Raises:
        ScanError: the convention needs an ``applied_transform``, and there is none.
    """
    if name == AS_READ:
        return photographs
    if name == "y-up":
        return photographs.with_poses(_TO_Z_UP @ photographs.poses)
    if name == "before-applied-transform":
        if photographs.applied_transform is None:
            raise ScanError(
                f"{photographs.folder}: has no applied_transform, which only transforms.json of nerfstudio has; take {AS_READ}"
            )
        return photographs.with_poses(np.linalg.inv(photographs.applied_transform) @ photographs.poses)
    return photographs.with_poses(reinterpret_poses(photographs.poses, photographs.layout, name))


def photo_consistency(surface: TriangleMesh, photographs: Photographs) -> PhotoConsistency:
    """Returns the photo-consistency on a surface of some pairs of consecutive photographs."""
    reduced = replace(photographs, longest_side=min(_LONGEST_SIDE_PX, photographs.longest_side or _LONGEST_SIDE_PX))
    firsts = np.unique(np.linspace(0, max(len(reduced) - 2, 0), _PAIR_COUNT).round().astype(int))
    coverages, parts = [], []
    for number in np.unique(np.concatenate([firsts, firsts + 1]))[: 2 * _PAIR_COUNT].tolist():
        if number >= len(reduced):
            continue
        intrinsics = reduced.intrinsics(number)
        visible = visible_faces(surface, intrinsics, reduced.items[number].T_world_camera)
        coverages.append(float(triangle_areas_px(visible.corners).sum()) / (intrinsics.width * intrinsics.height))
        parts.append(face_views(number, visible, reduced.image(number)))
    return PhotoConsistency(min(float(np.mean(coverages)), 1.0), _cross_view_correlation(concatenate_views(parts)))


def _cross_view_correlation(views: Views) -> float:
    """Returns the correlation of a triangle's brightness in one photograph with its mean in the others, clipped to 0 to 1."""
    if not len(views):
        return 0.0
    brightness = np.sqrt(np.maximum(views.linear_rgb.mean(axis=1), 0.0)).astype(np.float64)
    photograph = views.photograph
    # The mean of each photograph is subtracted, because exposures differ.
    brightness -= (np.bincount(photograph, brightness) / np.maximum(np.bincount(photograph), 1))[photograph]
    counts, sums = np.bincount(views.face), np.bincount(views.face, brightness)
    is_shared = counts[views.face] > 1
    if int(is_shared.sum()) < _MIN_SHARED_VIEWS:
        return 0.0
    mean_of_others = (sums[views.face] - brightness)[is_shared] / (counts[views.face][is_shared] - 1)
    a, b = brightness[is_shared] - brightness[is_shared].mean(), mean_of_others - mean_of_others.mean()
    norm = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return max(float((a * b).sum()) / norm, 0.0) if norm > 0.0 else 0.0


def resolve_convention(surface: TriangleMesh, photographs: Photographs, convention: str = AS_READ) -> tuple[Photographs, str]:
    """Returns the photographs with their poses in the given or detected convention, and a message or warning; empty = read as their layout
    says.

    Args:
        surface: in the world frame of the poses.
        photographs: as their layout was read.
        convention: one of ``POSE_CONVENTIONS``, ``as-read`` or ``auto`` = the most photo-consistent one.

    Raises:
        ScanError: the poses are not photo-consistent, and are in another convention or scale, which is named; or depth images have another
            scale.
    """
    reread_photographs = with_convention(photographs, AS_READ if convention == AUTO else convention)
    consistency = photo_consistency(surface, reread_photographs)
    text = ""
    if consistency.score < _MIN_CONSISTENCY:
        name, best_consistency = _best_convention(surface, photographs)
        if best_consistency.score >= _MIN_CONSISTENCY / 2.0 and best_consistency.score > _MIN_RATIO * consistency.score:
            message = f"photographs agree if poses are read as {name} ({POSE_CONVENTIONS[name]}), but not as they are read now"
            numbers = f"agreement {best_consistency.score:.2f} against {consistency.score:.2f}"
            if convention != AUTO:
                raise ScanError(f"{photographs.folder}: {message} ({numbers}); give --pose-convention {name}, or {AUTO}")
            reread_photographs, text = (
                with_convention(photographs, name),
                f"poses are read as {name}: {POSE_CONVENTIONS[name]} ({numbers})",
            )
            consistency = best_consistency
    if _check_depth(surface, reread_photographs):
        return reread_photographs, text
    _check_position_scale(surface, reread_photographs, consistency)
    if consistency.score < _USUAL_CONSISTENCY:
        warning = (
            f"warning: photographs agree poorly on the mesh (agreement {consistency.score:.2f}; {_USUAL_CONSISTENCY:g} and more are usual): are mesh "
            "and poses of the same frame and scale? Check the order of quaternions and the intrinsics"
        )
        text = f"{text}; {warning}" if text else warning
    return reread_photographs, text


def _best_convention(surface: TriangleMesh, photographs: Photographs) -> tuple[str, PhotoConsistency]:
    names = [name for name in POSE_CONVENTIONS if name != "before-applied-transform" or photographs.applied_transform is not None]
    scored = [(name, photo_consistency(surface, with_convention(photographs, name))) for name in names]
    return max(scored, key=lambda pair: pair[1].score)


def _check_position_scale(surface: TriangleMesh, photographs: Photographs, consistency: PhotoConsistency) -> None:
    """Raises ScanError if photographs are much more consistent with their positions scaled about the origin."""
    if consistency.correlation >= _TESTED_CORRELATION:
        return
    scored = [(factor, photo_consistency(surface, photographs.scaled(factor))) for factor in _POSITION_SCALES]
    factor, best = max(scored, key=lambda pair: pair[1].score)
    if (
        best.score >= max(_MIN_CONSISTENCY, consistency.score)
        and 1.0 - best.correlation <= _MAX_ERROR_RATIO * (1.0 - consistency.correlation)
        and best.coverage >= _MIN_COVERAGE_RATIO * consistency.coverage
    ):
        raise ScanError(
            f"{photographs.folder}: mesh and poses have different scales: photographs agree on the mesh if the positions of the cameras are "
            f"multiplied by {factor:g} (agreement {best.score:.2f} against {consistency.score:.2f}); scale the mesh or the poses; "
            f"the mesh is {size_text(np.ptp(surface.vertices, axis=0).tolist())}"
        )


def _check_depth(surface: TriangleMesh, photographs: Photographs) -> bool:
    """Returns whether most depths agree with the mesh; False also if there are too few.

    Raises:
        ScanError: the depth images agree on a scale that differs from that of the mesh.
    """
    ratios = []
    for number in np.unique(np.linspace(0, len(photographs) - 1, _PAIR_COUNT).round().astype(int)).tolist():
        depth = photographs.depth(number)
        if depth is None:
            continue
        T = photographs.items[number].T_world_camera
        visible = visible_faces(surface, photographs.intrinsics(number), T)
        column, row = np.rint(visible.corners.mean(axis=1)).astype(np.int64).T
        z = (surface.vertices[surface.triangles[visible.faces]].mean(axis=1) - T[:3, 3]) @ T[:3, 2]
        ratios.append(depth[row, column] / z)
    ratio = np.concatenate(ratios) if ratios else np.zeros(0)
    ratio = ratio[np.isfinite(ratio)]
    if len(ratio) < _MIN_SAMPLES:
        return False
    agreement = float((np.abs(ratio - 1.0) < _DEPTH_TOLERANCE).mean())
    median = float(np.median(ratio))
    spread = float(np.median(np.abs(ratio - median))) / median
    if abs(median - 1.0) > _SCALE_TOLERANCE and spread < _MAX_SPREAD and agreement < _DEPTH_TOLERANCE:
        raise ScanError(
            f"{photographs.folder}: in the depth images everything is {median:.3g} times as far as in the mesh; if depths are metric, mesh "
            f"and poses are not: give --unit {median:.4g}; else the unit of the depths is wrong"
        )
    return agreement > 0.5

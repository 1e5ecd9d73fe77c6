"""Conventions of camera poses in files, and detection of the right one by geometric consistency of neighbouring depth images.

The detection precedes the fusion: a mesh that is fused from wrongly read poses is consistent with them, so that no later stage can detect it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import Mat4, invert, transform_points
from gibson_sim_tools.scanning.posed_rgbd import Intrinsics, PosedRgbd, ScanError
from gibson_sim_tools.scanning.settings import AS_READ, AUTO, CAMERA_CONVENTIONS

F64 = NDArray[np.float64]

OPTICAL_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""T_opengl_optical, (4, 4): OpenGL cameras look along -z, y up; it is its own inverse."""
_FROM_FILE: dict[str, Callable[[F64], F64]] = {
    "opencv": lambda M: M,
    "opengl": lambda M: M @ OPTICAL_OPENGL,
    "opencv-world-to-camera": invert,
    "opengl-world-to-camera": lambda M: invert(M) @ OPTICAL_OPENGL,
}
"""Convention -> function from the matrix in a file to T_world_camera, optical frame."""
_TO_FILE: dict[str, Callable[[F64], F64]] = {
    "opencv": lambda T: T,
    "opengl": lambda T: T @ OPTICAL_OPENGL,
    "opencv-world-to-camera": invert,
    "opengl-world-to-camera": lambda T: invert(T @ OPTICAL_OPENGL),
}
"""Convention -> function from T_world_camera, optical frame, to the matrix in a file."""
_LAYOUT_CONVENTIONS = {"nerfstudio": "opengl", "polycam": "opengl", "record3d": "opengl", "colmap": "opencv-world-to-camera"}
"""Layout -> convention; that of all other layouts is opencv."""

_PAIR_COUNT = 12
"""Number of compared pairs of frames."""
_MAX_FRAME_DISTANCE = 60
"""Largest distance between the two frames of a pair, frames."""
_ROTATION_RANGE_DEG = (10.0, 40.0)
"""Range of the rotation between the frames of a pair, degrees: smaller ones do not distinguish conventions, larger ones leave little overlap."""
_PIXEL_STRIDE = 8
"""Stride of the compared pixels, rows and columns."""
_MIN_DEPTH = 0.05
"""Least depth of a compared point, metres."""
_DEPTH_TOLERANCE, _DEPTH_TOLERANCE_RATIO = 0.03, 0.02
"""Largest difference of consistent depths: metres, and metres per metre of depth."""
_MIN_OVERLAP = 0.2
"""Share of the points in the view of the other frame below which the score falls in proportion."""
_MIN_CONSISTENCY, _MAX_ERROR_RATIO = 0.8, 0.5
"""Least score of correct poses at any noise; largest ratio of errors (1 - score) by which another convention is correct."""


def reinterpret_poses(poses: F64, layout: str, name: str) -> F64:
    """Returns T_world_camera (N, 4, 4), optical frame, with the matrices of the file read in another convention than the layout's.

    Args:
        poses: (N, 4, 4), T_world_camera as read in the convention of the layout.
        layout: name of the layout.
        name: one of ``CAMERA_CONVENTIONS``, or ``as-read`` = unchanged.
    """
    if name == AS_READ:
        return poses
    to_file = _TO_FILE[_LAYOUT_CONVENTIONS.get(layout, "opencv")]
    return np.stack([_FROM_FILE[name](to_file(T)) for T in poses])


def detect_convention(
    rgbd: PosedRgbd, frames: Sequence[int], depth_max: float, convention: str = AS_READ
) -> tuple[str, str]:  # fmt: skip
    """Returns the convention for ``reinterpret_poses``, and a message; empty = the poses are consistent as read.

    Args:
        rgbd: as its layout was read.
        frames: numbers of the frames to fuse.
        depth_max: largest compared depth, metres.
        convention: one of ``CAMERA_CONVENTIONS``, ``as-read`` or ``auto`` = as read, unless frames are consistent in another one.

    Raises:
        ScanError: frames are not consistent in this convention, and are in another one, which is named; or an image is broken.
    """
    name = AS_READ if convention == AUTO else convention
    pairs = _frame_pairs(rgbd, frames, depth_max)
    consistency = _depth_consistency(pairs, reinterpret_poses(rgbd.poses, rgbd.layout, name), rgbd.intrinsics)
    if not pairs or consistency >= _MIN_CONSISTENCY:
        return name, ""
    scores = {
        other: _depth_consistency(pairs, reinterpret_poses(rgbd.poses, rgbd.layout, other), rgbd.intrinsics) for other in CAMERA_CONVENTIONS
    }  # fmt: skip
    best = max(scores, key=lambda other: scores[other])
    if 1.0 - scores[best] > _MAX_ERROR_RATIO * (1.0 - consistency):
        return name, ""
    numbers = f"agreement {scores[best]:.2f} against {consistency:.2f}"
    if convention == AUTO:
        return best, f"poses are read as {best}: {CAMERA_CONVENTIONS[best]} ({numbers})"
    raise ScanError(
        f"{rgbd.folder}: neighbouring depth images agree if poses are read as {best} ({CAMERA_CONVENTIONS[best]}), but not as they are read now "
        f"({numbers}); give --pose-convention {best}, or {AUTO}"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _FramePair:
    """Two frames with overlapping views, if the poses are correct."""

    first: int
    second: int
    points: F64
    """(N, 3), back-projected depth of the first frame, its camera frame, metres."""
    depth: NDArray[np.float32]
    """(H, W), depth of the second frame, metres, NaN = none."""


def _frame_pairs(rgbd: PosedRgbd, frames: Sequence[int], depth_max: float) -> list[_FramePair]:
    """Returns pairs of frames, spread evenly over the scan."""
    if len(frames) < 2:
        return []
    poses, camera, pairs = rgbd.poses, rgbd.intrinsics, []
    for k in np.unique(np.linspace(0, len(frames) - 2, _PAIR_COUNT).round().astype(int)).tolist():
        first, later = frames[k], np.array(frames[k + 1 : k + 1 + _MAX_FRAME_DISTANCE])
        # The rotation angle between two cameras does not depend on the convention.
        cosine = (np.einsum("ij,nij->n", poses[first, :3, :3], poses[later, :3, :3]) - 1.0) / 2.0
        rotation_deg = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        second = int(
            later[np.maximum(_ROTATION_RANGE_DEG[0] - rotation_deg, rotation_deg - _ROTATION_RANGE_DEG[1]).clip(0.0).argmin()]
        )
        depth = rgbd[first].depth[::_PIXEL_STRIDE, ::_PIXEL_STRIDE].astype(np.float64)
        v, u = np.nonzero((depth > _MIN_DEPTH) & (depth <= depth_max))
        z = depth[v, u]
        points = np.stack(
            [(u * _PIXEL_STRIDE - camera.cx) / camera.fx * z, (v * _PIXEL_STRIDE - camera.cy) / camera.fy * z, z], axis=1
        )
        pairs.append(_FramePair(first, second, points, rgbd[second].depth))
    return pairs


def _depth_consistency(pairs: Sequence[_FramePair], poses: Sequence[Mat4] | F64, camera: Intrinsics) -> float:
    """Returns the share of the first frames' points that are consistent with the second frames' depth where that is known; 0 to 1."""
    visible = total = consistent = 0
    for pair in pairs:
        points = transform_points(invert(poses[pair.second]) @ poses[pair.first], pair.points)
        total += len(points)
        points = points[points[:, 2] > _MIN_DEPTH]
        x, y, z = points.T
        u, v = np.rint(x / z * camera.fx + camera.cx), np.rint(y / z * camera.fy + camera.cy)
        is_inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        z, depth = z[is_inside], pair.depth[v[is_inside].astype(np.int64), u[is_inside].astype(np.int64)]
        is_known = np.isfinite(depth)
        visible += int(is_known.sum())
        consistent += int(
            (np.abs(depth[is_known] - z[is_known]) <= _DEPTH_TOLERANCE + _DEPTH_TOLERANCE_RATIO * z[is_known]).sum()
        )
    if not visible:
        return 0.0
    return consistent / visible * min(visible / (_MIN_OVERLAP * total), 1.0)

"""Conventions of camera poses in files, and detection of the right one by geometric consistency of neighbouring depth images.

The detection precedes the fusion: a mesh that is fused from wrong poses or depths is consistent with them, so that no later stage can detect it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import Mat4, invert, transform_points
from gibson_sim_tools.scanning.posed_images import Intrinsics, PosedRgbd, ScanError
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
_USUAL_CONSISTENCY, _MIN_CONSISTENCY = 0.8, 0.5
"""Score of correct poses and depths, and the least score that is fused: noise of 2 cm and 1 degree in each pose leaves 0.55 and more."""
_MAX_ERROR_RATIO = 0.5
"""Largest ratio of errors (1 - score) by which another convention is correct."""
_MAX_SCALE_ERROR_RATIO = 0.25
"""The same for another scale of depths: larger depths hide noise in positions."""
_MIN_WRONG_DISTANCE = 1.0
"""Median distance between neighbouring cameras from which positions may have another unit, metres."""
_MIN_EXPECTED_OVERLAP, _MAX_DISTANCE_RATIO = 0.3, 0.5
"""Least overlap of the images of a pair after its rotation alone, and largest distance of its cameras, relative to the median depth, from which
a disagreement is an error: other pairs show different surfaces."""
_OVERLAP_RAYS = 12
"""Rays along each side of an image that measure an overlap."""
_SCAN_SIZE_RATIO = 1000.0
"""More than the distance of any two cameras of a scan, relative to its median depth."""
_DEPTH_SCALES = (1.0, 10.0, 100.0, 256.0, 1000.0, 4000.0, 5000.0, 10000.0)
"""Usual scales of depth images, units per metre."""
_POSE_UNITS = {"millimetres": 1000.0, "centimetres": 100.0}
"""Units of poses besides metres: name -> units per metre."""
_PLAUSIBLE_DEPTH = (0.2, 10.0)
"""Range of the median depth of a scan of rooms, metres."""


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
    """Returns the convention for ``reinterpret_poses``, and a message or warning; empty = the poses are consistent as read.

    Args:
        rgbd: as its layout was read.
        frames: numbers of the frames to fuse.
        depth_max: largest compared depth, metres.
        convention: one of ``CAMERA_CONVENTIONS``, ``as-read`` or ``auto`` = as read, unless frames are consistent in another one.

    Raises:
        ScanError: frames are not consistent in this convention; the message names the convention or the scale in which they are, if any. Or
            the depth images hold no depth, or an image is broken.
    """
    name, text = AS_READ if convention == AUTO else convention, ""
    pairs = _sequence_pairs(rgbd, frames)
    if pairs and not any(len(pair.points) for pair in pairs):
        raise ScanError(
            f"{rgbd.folder}: the depth images hold no depth: all pixels of the {len(pairs)} that were read are 0 or 65535"
        )
    if not any(pair.expected_overlap >= _MIN_EXPECTED_OVERLAP for pair in pairs):
        return name, ""

    def score(other: str, scale: _Scale = _UNCHANGED) -> float:
        return _depth_consistency(pairs, reinterpret_poses(rgbd.poses, rgbd.layout, other), rgbd.intrinsics, depth_max, scale)

    consistency = score(name)
    if consistency >= _USUAL_CONSISTENCY:
        return name, ""
    scores = {other: score(other) for other in CAMERA_CONVENTIONS}
    best = max(scores, key=lambda other: scores[other])
    if 1.0 - scores[best] <= _MAX_ERROR_RATIO * (1.0 - consistency):
        numbers = f"agreement {scores[best]:.2f} against {consistency:.2f}"
        if convention != AUTO:
            raise ScanError(
                f"{rgbd.folder}: neighbouring depth images agree if poses are read as {best} ({CAMERA_CONVENTIONS[best]}), but not as they are "
                f"read now ({numbers}); give --pose-convention {best}, or {AUTO}"
            )
        name, text, consistency = best, f"poses are read as {best}: {CAMERA_CONVENTIONS[best]} ({numbers})", scores[best]
        if consistency >= _USUAL_CONSISTENCY:
            return name, text
    # The frames may be in another order than that of the camera's path.
    poses = reinterpret_poses(rgbd.poses, rgbd.layout, name)
    pairs = _near_pairs(rgbd, frames, poses)
    consistency = score(name)
    if consistency >= _USUAL_CONSISTENCY:
        return name, text
    distance = float(np.median(np.linalg.norm(np.diff(poses[list(frames), :3, 3], axis=0), axis=1)))
    hypothesis = _other_scale(rgbd, pairs, lambda scale: score(name, scale), consistency, distance)
    numbers = f"({consistency:.2f} of the pixels; {_USUAL_CONSISTENCY:g} and more are usual)"
    median_depth = _median_depth(pairs)
    advice = hypothesis or (
        f"check the depth scale ({rgbd.depth_scale:g} units per metre, median depth {median_depth:.3g} m), the order of quaternions and the "
        f"intrinsics; neighbouring cameras are {distance:.3g} m apart (median)"
    )
    if not hypothesis and median_depth > depth_max:
        advice = f"most depths are beyond --depth-max {depth_max:g}: give a larger one, or {advice}"
    is_judged = hypothesis or sum(pair.is_near for pair in pairs) > len(pairs) / 2 or distance > _PLAUSIBLE_DEPTH[1]
    if consistency < _MIN_CONSISTENCY and is_judged:
        problem = f"disagree {numbers}; " if hypothesis else f"agree in no convention {numbers}: "
        raise ScanError(f"{rgbd.folder}: neighbouring depth images {problem}{advice}")
    cause = "poses or depths are noisy" if is_judged else "few frames show the same surfaces"
    warning = f"warning: neighbouring depth images agree poorly {numbers}: {cause}, or else {advice}"
    return name, f"{text}; {warning}" if text else warning


@dataclass(frozen=True, slots=True)
class _Scale:
    """Another scale of the depths or of the poses, as factors."""

    depth: float = 1.0
    position: float = 1.0
    tolerance: float = 1.0
    """Of the constant part of the tolerance."""


_UNCHANGED = _Scale()


def _other_scale(
    rgbd: PosedRgbd, pairs: Sequence[_FramePair], score: Callable[[_Scale], float], consistency: float, distance: float
) -> str:  # fmt: skip
    """Returns the usual scale of depths or poses in which the frames are consistent, and the remedy, as text; empty = there is none.

    Args:
        rgbd: the frames.
        pairs: compared pairs.
        score: returns the consistency in another scale.
        consistency: that of the present scale.
        distance: median distance between neighbouring cameras, metres.
    """
    median_depth = _median_depth(pairs)
    found: list[tuple[float, str]] = []
    for units in _DEPTH_SCALES:
        factor = rgbd.depth_scale / units
        if factor != 1.0 and _PLAUSIBLE_DEPTH[0] <= factor * median_depth <= _PLAUSIBLE_DEPTH[1]:
            agreement = score(_Scale(depth=factor))
            # Compared at the same relative tolerance: small depths alone meet a constant one.
            present = max(consistency, score(_Scale(tolerance=1.0 / factor)))
            if agreement >= _USUAL_CONSISTENCY and 1.0 - agreement <= _MAX_SCALE_ERROR_RATIO * (1.0 - present):
                text = f"they agree with a depth scale of {units:g} units per metre instead of {rgbd.depth_scale:g}"
                found.append((agreement, f"{text} ({agreement:.2f}): give --depth-scale {units:g}"))
    for unit, per_metre in _POSE_UNITS.items():
        agreement = score(_Scale(position=1.0 / per_metre)) if distance > _MIN_WRONG_DISTANCE else 0.0
        if agreement >= _USUAL_CONSISTENCY:
            text = (
                f"they agree if the positions of the cameras are in {unit} ({agreement:.2f}), but the pose file must hold metres"
            )
            found.append((agreement, f"{text}: neighbouring cameras are {distance:.3g} m apart (median)"))
    return max(found)[1] if found else ""


@dataclass(frozen=True, slots=True, eq=False)
class _FramePair:
    """Two frames with overlapping views, if the poses are correct."""

    first: int
    second: int
    points: F64
    """(N, 3), back-projected depth of the first frame, its camera frame, metres."""
    depth: NDArray[np.float32]
    """(H, W), depth of the second frame, metres, NaN = none."""
    expected_overlap: float
    """Share of the first image that the second shows after the rotation alone, 0 to 1."""
    distance_ratio: float
    """Distance of the cameras, relative to the median depth of the first frame."""

    @property
    def is_near(self) -> bool:
        """Whether correct frames show the same surfaces, so that a disagreement is an error."""
        return self.expected_overlap >= _MIN_EXPECTED_OVERLAP and self.distance_ratio <= _MAX_DISTANCE_RATIO


def _sequence_pairs(rgbd: PosedRgbd, frames: Sequence[int]) -> list[_FramePair]:
    """Returns pairs of frames, spread evenly over the scan: the second is the next one that is rotated by an angle within the range."""
    poses, pairs = rgbd.poses, []
    for k in _first_frames(frames):
        later = np.array(frames[k + 1 : k + 1 + _MAX_FRAME_DISTANCE])
        pairs.append(_pair(rgbd, poses, frames[k], int(later[_excess_deg(poses, frames[k], later).argmin()])))
    return pairs


def _near_pairs(rgbd: PosedRgbd, frames: Sequence[int], poses: F64) -> list[_FramePair]:
    """Returns pairs of frames in any order, spread evenly over the scan: the second is near, and rotated by an angle near the range.

    Args:
        rgbd: the frames.
        frames: numbers of the frames to fuse.
        poses: T_world_camera (N, 4, 4), in one of the conventions.
    """
    pairs = []
    for k in _first_frames(frames):
        first, others = frames[k], np.delete(np.asarray(frames), k)
        depth = rgbd[first].depth
        median_depth = float(np.median(depth[depth > 0.0])) if (depth > 0.0).any() else 1.0
        distances = np.linalg.norm(poses[others, :3, 3] - poses[first, :3, 3], axis=1)
        cost = _excess_deg(poses, first, others) / _ROTATION_RANGE_DEG[0] + distances / median_depth
        cost[_expected_overlaps(rgbd.intrinsics, poses, first, others) < _MIN_EXPECTED_OVERLAP] += _SCAN_SIZE_RATIO
        pairs.append(_pair(rgbd, poses, first, int(others[cost.argmin()])))
    return pairs


def _first_frames(frames: Sequence[int]) -> list[int]:
    """Returns the indices in ``frames`` of the first frames of pairs."""
    return np.unique(np.linspace(0, len(frames) - 2, _PAIR_COUNT).round().astype(int)).tolist() if len(frames) > 1 else []


def _excess_deg(poses: F64, first: int, others: NDArray[np.int64]) -> F64:
    """Returns by how much the rotations between a frame and others (N,) are outside the range, degrees; the convention does not matter."""
    cosine = (np.einsum("ij,nij->n", poses[first, :3, :3], poses[others, :3, :3]) - 1.0) / 2.0
    rotation_deg = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return np.asarray(np.maximum(_ROTATION_RANGE_DEG[0] - rotation_deg, rotation_deg - _ROTATION_RANGE_DEG[1]).clip(0.0))


def _expected_overlaps(camera: Intrinsics, poses: F64, first: int, others: NDArray[np.int64]) -> F64:
    """Returns the shares (N,) of the image of a frame that others (N,) show after the rotation alone, 0 to 1."""
    u, v = np.meshgrid(*((np.arange(_OVERLAP_RAYS) + 0.5) / _OVERLAP_RAYS * size for size in (camera.width, camera.height)))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1).reshape(-1, 3)
    rotations = np.swapaxes(poses[others, :3, :3], 1, 2) @ poses[first, :3, :3]
    rotated = np.einsum("nij,rj->nri", rotations, rays)
    return np.asarray(_pixels(rotated.reshape(-1, 3), camera)[2].reshape(len(others), -1).mean(axis=1))


def _pair(rgbd: PosedRgbd, poses: F64, first: int, second: int) -> _FramePair:
    camera = rgbd.intrinsics
    depth = rgbd[first].depth[::_PIXEL_STRIDE, ::_PIXEL_STRIDE].astype(np.float64)
    v, u = np.indices(depth.shape) * _PIXEL_STRIDE
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(depth)], axis=-1)
    overlap = float(_expected_overlaps(camera, poses, first, np.array([second]))[0])
    points = (rays * depth[..., None])[depth > 0.0]
    distance = float(np.linalg.norm(poses[second, :3, 3] - poses[first, :3, 3]))
    ratio = distance / float(np.median(points[:, 2])) if len(points) else math.inf
    return _FramePair(first, second, points, rgbd[second].depth, overlap, ratio)


def _median_depth(pairs: Sequence[_FramePair]) -> float:
    """Returns the median depth of the compared points, metres."""
    return float(np.median(np.concatenate([pair.points[:, 2] for pair in pairs])))


def _pixels(points: F64, camera: Intrinsics) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Returns the columns and rows (N,) of points (N, 3), camera frame, and whether they are in the image; elsewhere 0."""
    z = np.where(points[:, 2] > 0.0, points[:, 2], np.nan)
    u, v = np.rint(points[:, 0] / z * camera.fx + camera.cx), np.rint(points[:, 1] / z * camera.fy + camera.cy)
    is_inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    return np.where(is_inside, u, 0).astype(np.int64), np.where(is_inside, v, 0).astype(np.int64), is_inside


def _depth_consistency(
    pairs: Sequence[_FramePair], poses: Sequence[Mat4] | F64, camera: Intrinsics, depth_max: float, scale: _Scale
) -> float:
    """Returns the share of the first frames' points that are consistent with the second frames' depth where that is known; 0 to 1."""
    visible = total = consistent = 0
    for pair in pairs:
        points = scale.depth * pair.points
        points = points[(points[:, 2] > _MIN_DEPTH) & (points[:, 2] <= depth_max)]
        T = invert(poses[pair.second]) @ poses[pair.first]
        T[:3, 3] *= scale.position
        points = transform_points(T, points)
        total += len(points)
        u, v, is_inside = _pixels(points, camera)
        is_inside &= points[:, 2] > _MIN_DEPTH
        z, depth = points[is_inside, 2], scale.depth * pair.depth[v[is_inside], u[is_inside]].astype(np.float64)
        is_known = np.isfinite(depth)
        visible += int(is_known.sum())
        tolerance = scale.tolerance * _DEPTH_TOLERANCE + _DEPTH_TOLERANCE_RATIO * z[is_known]
        consistent += int((np.abs(depth[is_known] - z[is_known]) <= tolerance).sum())
    if not visible:
        return 0.0
    return consistent / visible * min(visible / (_MIN_OVERLAP * total), 1.0)

"""Conventions of poses in files, and which one neighbouring depth images agree in.

A mesh that is fused from poses in another convention agrees with these poses, so that no later step can find out.
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
"""T_opengl_optical: cameras of OpenGL look along -z, y up; its own inverse."""
_READ: dict[str, Callable[[F64], F64]] = {
    "opencv": lambda M: M,
    "opengl": lambda M: M @ OPTICAL_OPENGL,
    "opencv-world-to-camera": invert,
    "opengl-world-to-camera": lambda M: invert(M) @ OPTICAL_OPENGL,
}
"""T_world_camera, optical frame, of the matrices of a file."""
_WRITTEN: dict[str, Callable[[F64], F64]] = {
    "opencv": lambda T: T,
    "opengl": lambda T: T @ OPTICAL_OPENGL,
    "opencv-world-to-camera": invert,
    "opengl-world-to-camera": lambda T: invert(T @ OPTICAL_OPENGL),
}
_OF_LAYOUTS = {"nerfstudio": "opengl", "polycam": "opengl", "record3d": "opengl", "colmap": "opencv-world-to-camera"}
"""Conventions of layouts; that of all others is opencv."""

_PAIRS = 12
"""Pairs of neighbouring frames that are compared."""
_WINDOW = 60
"""The second frame of a pair is the first one that turned, at most so many frames behind the first."""
_TURNS_DEG = (10.0, 40.0)
"""Turns between the frames of a pair: smaller ones tell no conventions apart, and after larger ones little is common to both."""
_STEP = 8
"""Every so many pixels, in both directions, are compared."""
_NEAR = 0.05
"""Least depth of a point that is compared, metres."""
_APART, _APART_SHARE = 0.03, 0.02
"""Depths agree within this: metres, and metres per metre of depth."""
_OVERLAP = 0.2
"""Share of the points that the other frame must show; less counts in proportion."""
_GOOD, _BETTER = 0.8, 0.5
"""Agreement that right poses reach whatever the noise, and the ratio of disagreements that makes another convention the right one."""


def reread(poses: F64, layout: str, name: str) -> F64:
    """Returns T_world_camera (N, 4, 4), optical frames, if the file of a layout holds them in another convention than the layout's.

    Args:
        poses: as they were read.
        layout: by whose convention.
        name: one of ``CAMERA_CONVENTIONS``, or ``as-read``.
    """
    if name == AS_READ:
        return poses
    written = _WRITTEN[_OF_LAYOUTS.get(layout, "opencv")]
    return np.stack([_READ[name](written(T)) for T in poses])


def agreeing_convention(
    rgbd: PosedRgbd, frames: Sequence[int], depth_max: float, convention: str = AS_READ
) -> tuple[str, str]:  # fmt: skip
    """Returns the convention that poses are to be taken in, see ``reread``, and a line about it; empty = nothing to say.

    Args:
        rgbd: as its layout was read.
        frames: numbers of those that are fused.
        depth_max: farther depths are left out, metres.
        convention: one of ``CAMERA_CONVENTIONS``, ``as-read`` or ``auto`` = as read, unless frames agree in another one.

    Raises:
        ScanError: frames do not agree in this convention, and do in another one, which is named; or an image is broken.
    """
    name = AS_READ if convention == AUTO else convention
    pairs = _pairs(rgbd, frames, depth_max)
    now = _agreement(pairs, reread(rgbd.poses, rgbd.layout, name), rgbd.intrinsics)
    if not pairs or now >= _GOOD:
        return name, ""
    values = {
        other: _agreement(pairs, reread(rgbd.poses, rgbd.layout, other), rgbd.intrinsics) for other in CAMERA_CONVENTIONS
    }  # fmt: skip
    best = max(values, key=lambda other: values[other])
    if 1.0 - values[best] > _BETTER * (1.0 - now):
        return name, ""
    numbers = f"agreement {values[best]:.2f} against {now:.2f}"
    if convention == AUTO:
        return best, f"poses are read as {best}: {CAMERA_CONVENTIONS[best]} ({numbers})"
    raise ScanError(
        f"{rgbd.folder}: neighbouring depth images agree if poses are read as {best} ({CAMERA_CONVENTIONS[best]}), but not as they are read now "
        f"({numbers}); give --pose-convention {best}, or {AUTO}"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Two frames that show the same, if poses are right."""

    first: int
    second: int
    points: F64
    """(N, 3), what the first frame shows, in its camera frame, metres."""
    depth: NDArray[np.float32]
    """(H, W), of the second frame, metres, NaN = unknown."""


def _pairs(rgbd: PosedRgbd, frames: Sequence[int], depth_max: float) -> list[_Pair]:
    """Returns pairs of frames, spread over the scan."""
    if len(frames) < 2:
        return []
    poses, camera, out = rgbd.poses, rgbd.intrinsics, []
    for k in np.unique(np.linspace(0, len(frames) - 2, _PAIRS).round().astype(int)).tolist():
        first, behind = frames[k], np.array(frames[k + 1 : k + 1 + _WINDOW])
        # The turn between two cameras is the same in all conventions.
        cosine = (np.einsum("ij,nij->n", poses[first, :3, :3], poses[behind, :3, :3]) - 1.0) / 2.0
        turn = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        second = int(behind[np.maximum(_TURNS_DEG[0] - turn, turn - _TURNS_DEG[1]).clip(0.0).argmin()])
        depth = rgbd[first].depth[::_STEP, ::_STEP].astype(np.float64)
        v, u = np.nonzero((depth > _NEAR) & (depth <= depth_max))
        z = depth[v, u]
        points = np.stack([(u * _STEP - camera.cx) / camera.fx * z, (v * _STEP - camera.cy) / camera.fy * z, z], axis=1)
        out.append(_Pair(first, second, points, rgbd[second].depth))
    return out


def _agreement(pairs: Sequence[_Pair], poses: Sequence[Mat4] | F64, camera: Intrinsics) -> float:
    """Returns the share of the points of first frames, where second ones show them, whose depth there is that of the second ones; 0 to 1."""
    shown = total = agree = 0
    for pair in pairs:
        points = transform_points(invert(poses[pair.second]) @ poses[pair.first], pair.points)
        total += len(points)
        points = points[points[:, 2] > _NEAR]
        x, y, z = points.T
        u, v = np.rint(x / z * camera.fx + camera.cx), np.rint(y / z * camera.fy + camera.cy)
        inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        z, depth = z[inside], pair.depth[v[inside].astype(np.int64), u[inside].astype(np.int64)]
        known = np.isfinite(depth)
        shown += int(known.sum())
        agree += int((np.abs(depth[known] - z[known]) <= _APART + _APART_SHARE * z[known]).sum())
    if not shown:
        return 0.0
    return agree / shown * min(shown / (_OVERLAP * total), 1.0)

"""Posed photographs: undistorted, resized images of pinhole cameras, decoded one at a time. ``layouts`` opens them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.scanning.posed_rgbd import Intrinsics, ScanError, check_pose, metres, read_depth, read_image

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

ASPECT_TOLERANCE = 0.02
"""Largest relative difference between the aspect ratios of a depth image and its photograph; allows for rounding."""


@dataclass(frozen=True, slots=True)
class CameraModel:
    """Camera model of OpenCV: intrinsics and lens distortion."""

    intrinsics: Intrinsics
    distortion: tuple[float, ...] = ()
    """Distortion coefficients in OpenCV's order: 4, 5 or 8 (k1, k2, p1, p2, ...), or 4 of a fisheye (k1 to k4); empty = none."""
    fisheye: bool = False
    """Whether the coefficients are those of OpenCV's fisheye model (equidistant)."""


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """File, camera model and pose of a photograph."""

    file: Path
    camera: CameraModel
    T_world_camera: F64
    """(4, 4), optical frame: x right, y down, z forward; metres."""
    depth: Path | None = None
    """16-bit depth image of the same view, possibly of lower resolution; None = there is none."""
    depth_scale: float = 1000.0
    """Units of the depth image per metre: 1000 = millimetres."""


@dataclass(frozen=True, slots=True, eq=False)
class Photographs:
    """A set of posed photographs. ``len(photographs)`` is their number; ``image(k)`` decodes one."""

    folder: Path
    layout: str
    """Name of its layout."""
    items: tuple[Photograph, ...]
    longest_side: int = 0
    """Longest side to which images are scaled down, pixels; 0 = full size."""
    warnings: tuple[str, ...] = ()
    """Omissions and assumptions, one line each."""
    applied_transform: F64 | None = None
    """(4, 4), nerfstudio's ``applied_transform``: takes the world frame of the reconstruction to that of the poses; None = there is none."""

    def __post_init__(self) -> None:
        if not self.items:
            raise ScanError(f"{self.folder}: has no photograph with a pose")
        for item in self.items:
            check_pose(str(item.file), item.T_world_camera)

    def __len__(self) -> int:
        return len(self.items)

    @property
    def poses(self) -> F64:
        """T_world_camera of all photographs, (N, 4, 4)."""
        return np.stack([item.T_world_camera for item in self.items])

    def intrinsics(self, number: int) -> Intrinsics:
        """Returns the pinhole intrinsics of the image that ``image`` returns."""
        original = self.items[number].camera.intrinsics
        scale = self.longest_side / max(original.width, original.height)
        if not self.longest_side or scale >= 1.0:
            return original
        return original.resized(max(round(original.width * scale), 1), max(round(original.height * scale), 1))

    def image(self, number: int) -> U8:
        """Returns the undistorted, scaled image, (H, W, 3) uint8, sRGB; row 0 is the top.

        Raises:
            ScanError: the file is missing or broken, or its size differs from that of the camera model.
        """
        item = self.items[number]
        original, intrinsics = item.camera.intrinsics, self.intrinsics(number)
        bgr = read_image(item.file, cv2.IMREAD_COLOR)
        if bgr.shape[:2] != (original.height, original.width):
            raise ScanError(
                f"{item.file}: has {bgr.shape[1]}x{bgr.shape[0]} pixels, its camera {original.width}x{original.height}; "
                "give photographs of the size that was posed"
            )
        if any(item.camera.distortion):
            bgr = cv2.remap(bgr, *_undistortion_maps(item.camera), cv2.INTER_LINEAR)
        if (intrinsics.width, intrinsics.height) != (original.width, original.height):
            bgr = cv2.resize(bgr, (intrinsics.width, intrinsics.height), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(bgr[:, :, ::-1])

    def depth(self, number: int) -> F32 | None:
        """Returns the depth at the pixels of ``image``, (H, W) float32, metres along the optical axis, NaN = no depth; None = not measured.

        Raises:
            ScanError: the file is missing or broken, or its aspect ratio differs from that of the photograph.
        """
        item = self.items[number]
        if item.depth is None:
            return None
        original, intrinsics = item.camera.intrinsics, self.intrinsics(number)
        units: NDArray[Any] = read_depth(item.depth)
        height, width = units.shape
        if abs(width * original.height - height * original.width) > ASPECT_TOLERANCE * width * original.height:
            raise ScanError(
                f"{item.depth}: has {width}x{height} pixels, its photograph {original.width}x{original.height}; both must show the same, "
                "so that their sides must be in proportion"
            )
        if any(item.camera.distortion):
            depth_camera = CameraModel(original.resized(width, height), item.camera.distortion, item.camera.fisheye)
            units = cv2.remap(units, *_undistortion_maps(depth_camera), cv2.INTER_NEAREST)
        if (width, height) != (intrinsics.width, intrinsics.height):
            # Nearest neighbour, because interpolation would invent depths at edges.
            units = cv2.resize(units, (intrinsics.width, intrinsics.height), interpolation=cv2.INTER_NEAREST)
        return metres(np.asarray(units, dtype=np.uint16), item.depth_scale)

    def with_poses(self, poses: F64) -> Photographs:
        """Returns the photographs with other poses, T_world_camera, (N, 4, 4)."""
        return replace(self, items=tuple(replace(item, T_world_camera=T) for item, T in zip(self.items, poses, strict=True)))

    def scaled(self, scale: float) -> Photographs:
        """Returns the photographs with their positions scaled about the origin."""
        poses = self.poses
        poses[:, :3, 3] *= scale
        return self.with_poses(poses)

    def subset(self, numbers: Sequence[int] | NDArray[np.integer]) -> Photographs:
        """Returns the photographs with these numbers, in their order."""
        return replace(self, items=tuple(self.items[k] for k in numbers))


def without_lost_poses(
    folder: Path, layout: str, items: Sequence[Photograph], longest_side: int, warnings: tuple[str, ...] = (), applied_transform: F64 | None = None
) -> Photographs:  # fmt: skip
    """Returns a set of photographs without those with NaN poses, which scanning apps write while tracking is lost, and warns of them.

    Raises:
        ScanError: all poses are NaN, or a matrix is not a rigid transform.
    """
    kept = tuple(item for item in items if np.isfinite(item.T_world_camera).all())
    if not kept and items:
        raise ScanError(
            f"{folder}: all {len(items)} poses hold a NaN or an infinity: the camera was lost; scan again, more slowly"
        )
    if len(kept) < len(items):
        first = next(item for item in items if not np.isfinite(item.T_world_camera).all())
        text = (
            f"{len(items) - len(kept)} of {len(items)} poses hold a NaN or an infinity, first that of {first.file.name}: left out"
        )
        warnings = (*warnings, text)
    return Photographs(folder, layout, kept, longest_side, warnings, applied_transform)


def _undistortion_maps(camera: CameraModel) -> tuple[F32, F32]:
    """Returns the undistortion maps: columns and rows, (H, W) float32 each, of the undistorted pixels in the photograph."""
    K, size = camera.intrinsics.matrix, (camera.intrinsics.width, camera.intrinsics.height)
    maps = cv2.fisheye.initUndistortRectifyMap if camera.fisheye else cv2.initUndistortRectifyMap
    columns, rows = maps(K, np.array(camera.distortion), np.eye(3), K, size, cv2.CV_32FC1)
    return np.asarray(columns, dtype=np.float32), np.asarray(rows, dtype=np.float32)

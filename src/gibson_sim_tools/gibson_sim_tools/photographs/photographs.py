"""Posed photographs as pictures of pinhole cameras without distortion, read one at a time. ``layouts`` finds them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.scanning.posed_rgbd import Intrinsics, ScanError, check_pose, metres, read_image

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

_PROPORTION = 0.02
"""Relative difference of the proportions of a depth image and its photograph that rounding explains."""


@dataclass(frozen=True, slots=True)
class Lens:
    """A camera with distortion."""

    intrinsics: Intrinsics
    distortion: tuple[float, ...] = ()
    """4, 5 or 8 numbers as in OpenCV, or 4 of a fisheye; empty = none."""
    fisheye: bool = False
    """Whether it is OpenCV's equidistant fisheye."""


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """Where a photograph was taken, and with what."""

    file: Path
    lens: Lens
    T_world_camera: F64
    """(4, 4), optical frame: x right, y down, z forward; metres."""
    depth: Path | None = None
    """16-bit depth image of the same view, which may have fewer pixels; None = there is none."""
    depth_scale: float = 1000.0
    """Units of the depth image per metre."""


@dataclass(frozen=True, slots=True, eq=False)
class Photographs:
    """A set of posed photographs. ``len(photographs)`` is their number; ``picture(k)`` reads one."""

    folder: Path
    layout: str
    """Name of its layout."""
    items: tuple[Photograph, ...]
    longest: int = 0
    """Longest side that pictures are reduced to, pixels; 0 = they stay as they are."""
    warnings: tuple[str, ...] = ()
    """Omissions and assumptions, one line each."""
    applied: F64 | None = None
    """(4, 4): nerfstudio's ``applied_transform``, by which it turned the world that the poses were found in; None = there is none."""

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
        """Returns the intrinsics of a picture as ``picture`` returns it."""
        full = self.items[number].lens.intrinsics
        share = self.longest / max(full.width, full.height)
        if not self.longest or share >= 1.0:
            return full
        return full.resized(max(round(full.width * share), 1), max(round(full.height * share), 1))

    def image(self, number: int) -> U8:
        """Returns a picture (H, W, 3), sRGB, without distortion; row 0 is the top.

        Raises:
            ScanError: the file is missing or broken, or its size is not that of its camera.
        """
        item = self.items[number]
        full, wanted = item.lens.intrinsics, self.intrinsics(number)
        bgr = read_image(item.file, cv2.IMREAD_COLOR)
        if bgr.shape[:2] != (full.height, full.width):
            raise ScanError(
                f"{item.file}: has {bgr.shape[1]}x{bgr.shape[0]} pixels, its camera {full.width}x{full.height}; "
                "give photographs of the size that was posed"
            )
        if any(item.lens.distortion):
            bgr = cv2.remap(bgr, *_undistortion(item.lens), cv2.INTER_LINEAR)
        if (wanted.width, wanted.height) != (full.width, full.height):
            bgr = cv2.resize(bgr, (wanted.width, wanted.height), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(bgr[:, :, ::-1])

    def depth(self, number: int) -> F32 | None:
        """Returns the measured depth at the pixels of a picture, (H, W) metres along the optical axis, NaN = unknown; None = not measured.

        Raises:
            ScanError: the file is missing or broken, or its sides are not in the proportion of the photograph's.
        """
        item = self.items[number]
        if item.depth is None:
            return None
        full, wanted = item.lens.intrinsics, self.intrinsics(number)
        units = read_image(item.depth, cv2.IMREAD_UNCHANGED)
        if units.dtype != np.uint16 or units.ndim != 2:
            raise ScanError(
                f"{item.depth}: is an image of {units.dtype} with shape {units.shape}; depth must be 16 bit with one channel"
            )
        height, width = units.shape
        if abs(width * full.height - height * full.width) > _PROPORTION * width * full.height:
            raise ScanError(
                f"{item.depth}: has {width}x{height} pixels, its photograph {full.width}x{full.height}; both must show the same, "
                "so that their sides must be in proportion"
            )
        if any(item.lens.distortion):
            part = Lens(full.resized(width, height), item.lens.distortion, item.lens.fisheye)
            units = cv2.remap(units, *_undistortion(part), cv2.INTER_NEAREST)
        if (width, height) != (wanted.width, wanted.height):
            # Between two pixels there may be an edge: no depth lies between theirs.
            units = cv2.resize(units, (wanted.width, wanted.height), interpolation=cv2.INTER_NEAREST)
        return metres(np.asarray(units, dtype=np.uint16), item.depth_scale)

    def with_poses(self, poses: F64) -> Photographs:
        """Returns the same photographs at other poses, (N, 4, 4)."""
        return replace(self, items=tuple(replace(item, T_world_camera=T) for item, T in zip(self.items, poses, strict=True)))

    def scaled(self, scale: float) -> Photographs:
        """Returns the same photographs at positions that are larger by a factor."""
        poses = self.poses
        poses[:, :3, 3] *= scale
        return self.with_poses(poses)

    def subset(self, numbers: Sequence[int] | NDArray[np.integer]) -> Photographs:
        """Returns some of the photographs."""
        return replace(self, items=tuple(self.items[k] for k in numbers))


def posed(
    folder: Path, layout: str, items: Sequence[Photograph], longest: int, warnings: tuple[str, ...] = (), applied: F64 | None = None
) -> Photographs:  # fmt: skip
    """Returns a set of photographs without those whose poses were lost: scanning apps write NaN while they do not know where they are.

    Raises:
        ScanError: no pose is left, or a matrix is no pose.
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
    return Photographs(folder, layout, kept, longest, warnings, applied)


def _undistortion(lens: Lens) -> tuple[F32, F32]:
    """Returns where each pixel of the picture without distortion lies in the photograph: columns and rows, (H, W)."""
    K, size = lens.intrinsics.matrix, (lens.intrinsics.width, lens.intrinsics.height)
    maps = cv2.fisheye.initUndistortRectifyMap if lens.fisheye else cv2.initUndistortRectifyMap
    columns, rows = maps(K, np.array(lens.distortion), np.eye(3), K, size, cv2.CV_32FC1)
    return np.asarray(columns, dtype=np.float32), np.asarray(rows, dtype=np.float32)

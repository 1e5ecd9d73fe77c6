"""Posed photographs as pictures of pinhole cameras without distortion, read one at a time. ``photograph_layouts`` finds them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.scanning.posed_rgbd import Intrinsics, ScanError, check_pose, read_image
from gibson_sim_tools.texturing.surface import scaled

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


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
        return scaled(full, max(round(full.width * share), 1), max(round(full.height * share), 1))

    def picture(self, number: int) -> U8:
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
            undistort = cv2.fisheye.undistortImage if item.lens.fisheye else cv2.undistort
            K = full.matrix
            bgr = undistort(bgr, K, np.array(item.lens.distortion), None, K)
        if (wanted.width, wanted.height) != (full.width, full.height):
            bgr = cv2.resize(bgr, (wanted.width, wanted.height), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(bgr[:, :, ::-1])

    def at(self, poses: F64) -> Photographs:
        """Returns the same photographs at other poses, (N, 4, 4)."""
        return replace(self, items=tuple(replace(item, T_world_camera=T) for item, T in zip(self.items, poses, strict=True)))

    def only(self, numbers: Sequence[int]) -> Photographs:
        """Returns some of the photographs."""
        return replace(self, items=tuple(self.items[k] for k in numbers))

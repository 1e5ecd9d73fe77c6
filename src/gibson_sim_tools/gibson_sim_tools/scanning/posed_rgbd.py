"""Posed RGB-D: colour images, depth images and camera poses from any source. Reads the images; ``layouts`` finds them.

All frames of a set have one pinhole camera without distortion; colour and depth are registered (same pixels). A pose is
``T_world_camera`` of the optical frame: x right, y down, z forward. The set defines its world frame: third-party scans often begin at the
first camera, with y down; our scans are in the frame of their scene, z up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import GibsonSimError
from gibson_sim.formats.image_header import MAX_IMAGE_BYTES
from gibson_sim.formats.textures import decode_pixels
from gibson_sim.reading import read_file

NO_DEPTH = (0, 65535)
"""Values of a 16-bit depth image for "no depth": 0 in most sets, 65535 in some."""
_MAX_SIDE = 16384
_ROTATION_TOLERANCE = 1e-2


class ScanError(GibsonSimError):
    """Posed RGB-D cannot be read, captured or fused."""


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """Intrinsics of a pinhole camera without distortion. Pixel centres are at whole numbers."""

    width: int
    """Pixels."""
    height: int
    fx: float
    """Pixels."""
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if not (1 <= self.width <= _MAX_SIDE and 1 <= self.height <= _MAX_SIDE):
            raise ScanError(f"intrinsics: the image is {self.width}x{self.height}, each side must be 1 to {_MAX_SIDE} pixels")
        if not all(map(math.isfinite, (self.fx, self.fy, self.cx, self.cy))) or self.fx <= 0.0 or self.fy <= 0.0:
            raise ScanError(
                f"intrinsics: fx, fy, cx, cy are {self.fx:g}, {self.fy:g}, {self.cx:g}, {self.cy:g} pixels; "
                "they must be finite, fx and fy above 0"
            )

    @property
    def matrix(self) -> NDArray[np.float64]:
        """K, (3, 3), pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> Intrinsics:
        """Returns the intrinsics of the image resized to another width and height, pixels."""
        x, y = width / self.width, height / self.height
        return Intrinsics(width, height, self.fx * x, self.fy * y, (self.cx + 0.5) * x - 0.5, (self.cy + 0.5) * y - 0.5)


def intrinsics_of(what: str, width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> Intrinsics:
    """Returns intrinsics, pixels.

    Raises:
        ScanError: a value is invalid; the message begins with ``what``, such as their file.
    """
    try:
        return Intrinsics(width, height, fx, fy, cx, cy)
    except ScanError as error:
        raise ScanError(f"{what}: {error}") from error


@dataclass(frozen=True, slots=True, eq=False)
class FrameFiles:
    """Image files and camera pose of one frame."""

    color: Path
    depth: Path
    T_world_camera: NDArray[np.float64]
    """(4, 4), optical frame, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class RgbdFrame:
    """One frame in memory; the arrays belong to the caller. Row 0 is the top."""

    number: int
    """Index in the set, from 0."""
    rgb: NDArray[np.uint8]
    """(H, W, 3) uint8, sRGB."""
    depth: NDArray[np.float32]
    """(H, W) float32, metres along the optical axis, NaN = no depth."""
    T_world_camera: NDArray[np.float64]
    """(4, 4), optical frame."""


@dataclass(frozen=True, slots=True, eq=False)
class PosedRgbd:
    """A set of posed RGB-D in a folder: a sequence that reads its frames on access. ``layouts.open_posed_rgbd`` opens it.

    ``len(rgbd)`` is the number of frames, ``rgbd[7]`` reads one, ``for frame in rgbd`` reads them in order, one at a time.
    """

    folder: Path
    layout: str
    """Name of its layout."""
    intrinsics: Intrinsics
    depth_scale: float
    """Units of the depth images per metre: 1000 = millimetres."""
    files: tuple[FrameFiles, ...]
    warnings: tuple[str, ...] = ()
    """Omissions and assumptions, one line each."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.depth_scale) and self.depth_scale > 0.0):
            raise ScanError(f"{self.folder}: depth scale is {self.depth_scale:g} units a metre, must be finite and above 0")
        if not self.files:
            raise ScanError(f"{self.folder}: has no frame with a pose")

    def __len__(self) -> int:
        return len(self.files)

    def __iter__(self) -> Iterator[RgbdFrame]:
        return (self[number] for number in range(len(self)))

    def __getitem__(self, number: int) -> RgbdFrame:
        """Reads a frame.

        Raises:
            IndexError: there is no such frame.
            ScanError: an image is missing or broken, or its size differs from that of the intrinsics.
        """
        files = self.files[number]
        color = read_image(files.color, cv2.IMREAD_COLOR)
        units = read_depth(files.depth)
        for path, image in ((files.color, color), (files.depth, units)):
            self._check_size(path, image)
        return RgbdFrame(
            number % len(self), color[:, :, ::-1].copy(), metres(units, self.depth_scale), files.T_world_camera.copy()
        )

    @property
    def poses(self) -> NDArray[np.float64]:
        """T_world_camera of all frames, (N, 4, 4)."""
        return np.stack([f.T_world_camera for f in self.files])

    def with_poses(self, poses: NDArray[np.float64]) -> PosedRgbd:
        """Returns the frames with other poses, T_world_camera, (N, 4, 4)."""
        return replace(self, files=tuple(replace(file, T_world_camera=T) for file, T in zip(self.files, poses, strict=True)))

    def subset(self, numbers: Sequence[int]) -> PosedRgbd:
        """Returns the frames with these numbers, in their order."""
        return replace(self, files=tuple(self.files[k] for k in numbers))

    def _check_size(self, path: Path, image: NDArray[Any]) -> None:
        height, width = image.shape[:2]
        if (width, height) != (self.intrinsics.width, self.intrinsics.height):
            raise ScanError(
                f"{path}: has {width}x{height} pixels, the intrinsics are for {self.intrinsics.width}x{self.intrinsics.height}; "
                "colours and depths must lie on the same pixels: register or resize them, and give the intrinsics of that size"
            )


def metres(units: NDArray[np.uint16], depth_scale: float) -> NDArray[np.float32]:
    """Returns the depths, float32 metres, of a 16-bit image; NaN = none."""
    depth = units.astype(np.float32) / np.float32(depth_scale)
    depth[np.isin(units, NO_DEPTH)] = np.nan
    return depth


def depth_units(depth: NDArray[np.float32], depth_scale: float) -> NDArray[np.uint16]:
    """Returns the 16-bit image of depths in metres; values that are not finite or out of range become 0 = no depth."""
    with np.errstate(invalid="ignore"):
        units = np.rint(depth * np.float32(depth_scale))
        fits = (units > 0) & (units < NO_DEPTH[1])
    return np.where(fits, units, 0).astype(np.uint16)


def read_image(path: Path, flags: int) -> NDArray[Any]:
    """Returns an image in OpenCV's channel order (BGR).

    Raises:
        ScanError: it is missing or broken.
    """
    try:
        data = read_file(path, MAX_IMAGE_BYTES)
    except OSError as error:
        raise ScanError(f"{path}: cannot be read: {error.strerror or error}") from error
    image = decode_pixels(data, flags)
    if image is None:
        raise ScanError(f"{path}: is not a readable image; was the copy or the scan interrupted?")
    return image


def read_depth(path: Path) -> NDArray[np.uint16]:
    """Returns a depth image, (H, W), in its units.

    Raises:
        ScanError: it is missing or broken, or not 16 bit with one channel.
    """
    units = read_image(path, cv2.IMREAD_UNCHANGED)
    if units.dtype != np.uint16 or units.ndim != 2:
        raise ScanError(f"{path}: is an image of {units.dtype} with shape {units.shape}; depth must be 16 bit with one channel")
    return units


def check_pose(what: str, T_world_camera: NDArray[np.float64]) -> None:
    """Raises ScanError, whose message begins with ``what``, unless a (4, 4) matrix is a rigid transform."""
    R = T_world_camera[:3, :3]
    if not np.isfinite(T_world_camera).all():
        raise ScanError(f"{what}: the pose holds a NaN or an infinity; the camera was lost there: leave out this frame")
    determinant = float(np.linalg.det(R))
    scale = abs(determinant) ** (1.0 / 3.0)
    is_scaled_rotation = scale > 0.0 and float(np.abs(R @ R.T / scale**2 - np.eye(3)).max()) <= _ROTATION_TOLERANCE
    if not is_scaled_rotation:
        problem = f"its rows are not perpendicular unit vectors: they are off by {float(np.abs(R @ R.T - np.eye(3)).max()):.2g}"
    elif determinant < 0.0:
        problem = f"its determinant is {determinant:.3g}: it mirrors, so that one axis has the wrong sign"
    elif abs(scale - 1.0) > _ROTATION_TOLERANCE:
        problem = f"its rotation is scaled by {scale:.3g}; divide its nine numbers by that"
    elif np.abs(T_world_camera[3] - (0, 0, 0, 1)).max() > 1e-6:
        problem = "its last row must be 0 0 0 1"
    else:
        return
    raise ScanError(
        f"{what}: the pose is not a rigid transform ({problem}); it must be T_world_camera as 4x4 numbers by rows, in metres"
    )

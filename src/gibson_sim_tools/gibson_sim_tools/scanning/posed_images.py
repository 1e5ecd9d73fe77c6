"""Posed images from any source: photographs, each with its own camera, and posed RGB-D, whose frames share one. Reads the images; ``layouts``
here and in ``photographs`` find them.

A pose is ``T_world_camera`` of the optical frame: x right, y down, z forward. The set defines its world frame: third-party scans often
begin at the first camera, with y down; our scans are in the frame of their scene, z up.
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

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

NO_DEPTH = (0, 65535)
"""Values of a 16-bit depth image for "no depth": 0 in most sets, 65535 in some."""
ASPECT_TOLERANCE = 0.02
"""Largest relative difference between the aspect ratios of a depth image and its photograph; allows for rounding."""
_MIN_FRAMES = 2
"""Least number of frames of a fusion."""
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


@dataclass(frozen=True, slots=True, eq=False)
class RgbdFrame:
    """One frame in memory; the arrays belong to the caller. Row 0 is the top."""

    number: int
    """Index in the set, from 0."""
    rgb: U8
    """(H, W, 3) uint8, sRGB."""
    depth: F32
    """(H, W) float32, metres along the optical axis, NaN = no depth."""
    T_world_camera: F64
    """(4, 4), optical frame."""


@dataclass(frozen=True, slots=True, eq=False)
class PosedRgbd:
    """Photographs that all have depth, as frames of one pinhole camera without distortion, with colours and depth on the same pixels.

    ``len(rgbd)`` is the number of frames, ``rgbd[7]`` reads one, ``for frame in rgbd`` reads them in order, one at a time. A photograph of
    another camera is remapped, since the focal length of phones varies with focus.
    """

    photographs: Photographs
    intrinsics: Intrinsics

    def __post_init__(self) -> None:
        if not (math.isfinite(self.depth_scale) and self.depth_scale > 0.0):
            raise ScanError(f"{self.folder}: depth scale is {self.depth_scale:g} units a metre, must be finite and above 0")

    def __len__(self) -> int:
        return len(self.photographs)

    def __iter__(self) -> Iterator[RgbdFrame]:
        return (self[number] for number in range(len(self)))

    def __getitem__(self, number: int) -> RgbdFrame:
        """Reads a frame.

        Raises:
            IndexError: there is no such frame.
            ScanError: an image is missing or broken, or its size differs from that of its camera.
        """
        rgb, depth = self._registered(number) if self.is_registered else self._remapped(number)
        return RgbdFrame(number % len(self), rgb, depth, self.photographs.items[number].T_world_camera.copy())

    @property
    def folder(self) -> Path:
        """Folder of the set."""
        return self.photographs.folder

    @property
    def layout(self) -> str:
        """Name of its layout."""
        return self.photographs.layout

    @property
    def warnings(self) -> tuple[str, ...]:
        """Omissions and assumptions, one line each."""
        return self.photographs.warnings

    @property
    def depth_scale(self) -> float:
        """Units of the depth images per metre: 1000 = millimetres."""
        return self.photographs.items[0].depth_scale

    @property
    def is_registered(self) -> bool:
        """Whether all images have the pixels of ``intrinsics``; otherwise they are remapped."""
        return not self.photographs.longest_side and all(
            item.camera == CameraModel(self.intrinsics) for item in self.photographs.items
        )

    @property
    def poses(self) -> F64:
        """T_world_camera of all frames, (N, 4, 4)."""
        return self.photographs.poses

    def with_poses(self, poses: F64) -> PosedRgbd:
        """Returns the frames with other poses, T_world_camera, (N, 4, 4)."""
        return replace(self, photographs=self.photographs.with_poses(poses))

    def subset(self, numbers: Sequence[int]) -> PosedRgbd:
        """Returns the frames with these numbers, in their order."""
        return replace(self, photographs=self.photographs.subset(numbers))

    def _registered(self, number: int) -> tuple[U8, F32]:
        """Returns colours and depth as they are in their files."""
        item = self.photographs.items[number]
        assert item.depth is not None
        color, units = read_image(item.file, cv2.IMREAD_COLOR), read_depth(item.depth)
        for path, image in ((item.file, color), (item.depth, units)):
            height, width = image.shape[:2]
            if (width, height) != (self.intrinsics.width, self.intrinsics.height):
                raise ScanError(
                    f"{path}: has {width}x{height} pixels, the intrinsics are for {self.intrinsics.width}x{self.intrinsics.height}; "
                    "colours and depths must lie on the same pixels: register or resize them, and give the intrinsics of that size"
                )
        return color[:, :, ::-1].copy(), metres(units, item.depth_scale)

    def _remapped(self, number: int) -> tuple[U8, F32]:
        """Returns colours and depth at the pixels of ``intrinsics``."""
        depth = self.photographs.depth(number)
        assert depth is not None
        camera, common = self.photographs.intrinsics(number), self.intrinsics
        u, v = np.meshgrid(np.arange(common.width, dtype=np.float32), np.arange(common.height, dtype=np.float32))
        x = ((u - common.cx) * (camera.fx / common.fx) + camera.cx).astype(np.float32)
        y = ((v - common.cy) * (camera.fy / common.fy) + camera.cy).astype(np.float32)
        rgb = np.asarray(cv2.remap(self.photographs.image(number), x, y, cv2.INTER_LINEAR), dtype=np.uint8)
        nearest = cv2.remap(depth, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
        return rgb, np.asarray(nearest, dtype=np.float32)


def rgbd_of(photographs: Photographs) -> PosedRgbd | None:
    """Returns the photographs with depth as posed RGB-D, with the median intrinsics; None = fewer than ``_MIN_FRAMES`` have depth.

    Raises:
        ScanError: the first depth image cannot be read.
    """
    numbers = [k for k, item in enumerate(photographs.items) if item.depth is not None]
    if len(numbers) < _MIN_FRAMES:
        return None
    first = photographs.items[numbers[0]]
    assert first.depth is not None
    units = read_image(first.depth, cv2.IMREAD_UNCHANGED)
    if units.ndim != 2:
        raise ScanError(f"{first.depth}: is an image of shape {units.shape}; depth must have one channel")
    height, width = units.shape
    resized = photographs.subset(numbers)
    resized = Photographs(resized.folder, resized.layout, resized.items, longest_side=max(width, height))
    cameras = [resized.intrinsics(k) for k in range(len(resized))]
    fx, fy, cx, cy = np.median(
        [(i.fx, i.fy, i.cx, i.cy) for i in (camera.resized(width, height) for camera in cameras)], axis=0
    ).tolist()
    return PosedRgbd(resized, Intrinsics(width, height, fx, fy, cx, cy))


def metres(units: NDArray[np.uint16], depth_scale: float) -> F32:
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


def _undistortion_maps(camera: CameraModel) -> tuple[F32, F32]:
    """Returns the undistortion maps: columns and rows, (H, W) float32 each, of the undistorted pixels in the photograph."""
    K, size = camera.intrinsics.matrix, (camera.intrinsics.width, camera.intrinsics.height)
    maps = cv2.fisheye.initUndistortRectifyMap if camera.fisheye else cv2.initUndistortRectifyMap
    columns, rows = maps(K, np.array(camera.distortion), np.eye(3), K, size, cv2.CV_32FC1)
    return np.asarray(columns, dtype=np.float32), np.asarray(rows, dtype=np.float32)

"""Rectifies the images of a robot's cameras to the camera of a path: its size and field of view, without distortion.

A path has one of two cameras: a pinhole that looks ahead, with square pixels and a centred axis, or a pair of equidistant fisheyes whose circles
touch the nearer sides of their images. The images of a calibrated camera are remapped; those of an uncalibrated one are cropped.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import SettingError, ViewError, quoted
from gibson_path_following.types import IMAGES_OF, CameraKind, Image

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
EQUIDISTANT = ("equidistant", "fisheye")
"""Names of the distortion model of Kannala and Brandt."""
_DISTORTIONS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (0, 8, 12, 14), "": (0,)} | {name: (0, 4) for name in EQUIDISTANT}
_TOLERANCE = math.radians(1.0)
"""By how much the field of view of a camera may be smaller than that of the path, radians."""
_MAX_WAITING = 10
"""Images of one camera that wait for those of the other."""
_MAX_FOCAL = 100.0
"""Largest focal length, in widths of the image: half a degree."""
_MAX_COEFFICIENT = 1e6
"""Largest distortion coefficient."""
_Image = TypeVar("_Image")


@dataclass(frozen=True, slots=True)
class Calibration:
    """Intrinsics of a camera, as in ``sensor_msgs/CameraInfo``."""

    width: int
    height: int
    """Size of the images, pixels."""
    k: tuple[float, ...]
    """fx, 0, cx, 0, fy, cy, 0, 0, 1, pixels; pixel centres at whole numbers."""
    d: tuple[float, ...] = ()
    """Distortion coefficients."""
    model: str = "plumb_bob"
    """Name of the distortion model."""

    def __post_init__(self) -> None:
        if self.model not in _DISTORTIONS:
            known = ", ".join(name for name in _DISTORTIONS if name)
            raise SettingError(f"camera_info: distortion_model is {quoted(self.model)}, must be one of {known}")
        if len(self.d) not in _DISTORTIONS[self.model]:
            raise SettingError(
                f"camera_info: d has {len(self.d)} values, {self.model or 'no model'} has {' or '.join(map(str, _DISTORTIONS[self.model]))}"
            )
        if not all(map(math.isfinite, self.d)):
            raise SettingError(f"camera_info: d is {quoted(self.d)}, must be finite numbers")
        if len(self.k) != 9 or not all(map(math.isfinite, self.k)) or self.k[0] <= 0.0 or self.k[4] <= 0.0:
            raise SettingError(f"camera_info: k is {quoted(self.k)}, must be 9 finite numbers with focal lengths above 0")
        if self.width < 8 or self.height < 8:
            raise SettingError(f"camera_info: the images have {self.width}x{self.height} pixels, must be 8x8 or more")
        fx, _, cx, _, fy, cy = self.k[:6]
        if max(fx / self.width, fy / self.height) > _MAX_FOCAL:
            raise SettingError(
                f"camera_info: the focal lengths are {fx:g} and {fy:g} pixels, must be at most {_MAX_FOCAL:g} times the {self.width}x{self.height} "
                "pixels of the images"
            )
        if not (0.0 < cx < self.width - 1.0 and 0.0 < cy < self.height - 1.0):
            raise SettingError(
                f"camera_info: the principal point is ({cx:g}, {cy:g}), must be within the {self.width}x{self.height} pixels of the images"
            )
        if any(abs(value) > _MAX_COEFFICIENT for value in self.d):
            raise SettingError(f"camera_info: d is {quoted(self.d)}, must be {_MAX_COEFFICIENT:g} at most")

    @property
    def is_fisheye(self) -> bool:
        """Whether the distortion model is equidistant."""
        return self.model in EQUIDISTANT

    def pixels(self, rays: F64) -> tuple[F64, F64]:
        """Projects rays (N, 3), optical frame; returns pixel x (N,) and y (N,), float64, NaN behind a perspective camera."""
        x, y, z = rays.T
        fx, _, cx, _, fy, cy = self.k[:6]
        if self.is_fisheye:
            across = np.hypot(x, y)
            angle = np.arctan2(across, z)
            bent = angle * (1.0 + sum(c * angle ** (2 * i + 2) for i, c in enumerate(self.d)))
            scale = bent / np.maximum(across, 1e-12)
            return np.asarray(fx * x * scale + cx), np.asarray(fy * y * scale + cy)
        ahead = z > 1e-3
        flat = np.where(ahead[:, None], rays, (0.0, 0.0, 1.0))
        found, _ = cv2.projectPoints(flat, np.zeros(3), np.zeros(3), np.array(self.k).reshape(3, 3), np.array(self.d))
        seen: F64 = np.where(ahead[:, None], np.asarray(found, dtype=np.float64).reshape(-1, 2), np.nan)
        return seen[:, 0], seen[:, 1]

    def hfov(self) -> float:
        """Returns the horizontal field of view, symmetric about the axis, radians, to a quarter of a degree."""
        angles = np.radians(np.arange(0.0, 110.0, 0.125))
        sides = []
        for side in (-1.0, 1.0):
            rays = np.stack([side * np.sin(angles), np.zeros(len(angles)), np.cos(angles)], axis=1)
            x, y = self.pixels(rays)
            with np.errstate(invalid="ignore"):
                seen = (x >= -0.5) & (x <= self.width - 0.5) & (y >= -0.5) & (y <= self.height - 0.5)
            # A strong distortion folds rays from far outside back into the image: only those connected with the axis count.
            sides.append(float(angles[(len(seen) if seen.all() else int(seen.argmin())) - 1]) if seen[0] else 0.0)
        return 2.0 * min(sides)


class ViewCamera:
    """Rectifies the images of one camera. It computes its lookup tables at the first image, and when the calibration changes."""

    def __init__(self, kind: CameraKind, size: tuple[int, int], hfov: float) -> None:
        """Stores the path's camera.

        Args:
            kind: kind of the path's camera.
            size: width and height of its images, pixels.
            hfov: its horizontal field of view, radians; of a fisheye across its circle.
        """
        self.kind, self.size, self.hfov = kind, size, hfov
        self._cached: tuple[Calibration, F32, F32, float] | None = None
        """Calibration, pixel x and y (height, width), and shrink factor."""

    def image(self, rgb: Image, calibration: Calibration | None = None, hfov: float | None = None) -> Image:
        """Returns an image as the path's camera would see it, (height, width, 3), uint8.

        Args:
            rgb: (H, W, 3), uint8, of the robot's camera.
            calibration: of the robot's camera; None = uncalibrated.
            hfov: horizontal field of view of an uncalibrated camera, radians; None = that of the path.

        Raises:
            ViewError: the camera sees less than that of the path, or its images are not those of its calibration.
        """
        if calibration is None:
            return self._crop(rgb, self.hfov if hfov is None else hfov)
        height, width = rgb.shape[:2]
        if (calibration.width, calibration.height) != (width, height):
            raise ViewError(
                f"an image has {width}x{height} pixels, its camera_info {calibration.width}x{calibration.height}; publish both for one size"
            )
        if self._cached is None or self._cached[0] != calibration:
            self._cached = (calibration, *self._tables(calibration))
        _, x, y, shrink = self._cached
        # Low-pass filter before the image is downsampled.
        smooth = cv2.GaussianBlur(rgb, (0, 0), 0.4 * shrink, borderType=cv2.BORDER_REPLICATE) if shrink > 1.5 else rgb
        return cast("Image", cv2.remap(smooth, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def _crop(self, rgb: Image, hfov: float) -> Image:
        """Returns the middle of an image, resized, as of ``image``."""
        height, width = rgb.shape[:2]
        scale = _focal(self.kind, (width, height), hfov) / _focal(self.kind, self.size, self.hfov)
        across, down = scale * self.size[0], scale * self.size[1]
        if self.kind == "fisheye_pair":  # beyond the circle there is nothing
            across, down = min(across, width), min(down, height)
        if across > width * 1.02 + 1.0:
            raise ViewError(_sees_less(hfov, self.hfov))
        if down > height * 1.02 + 1.0:
            raise ViewError(_LOWER)
        part = (min(width, round(across)), min(height, round(down)))
        left, top = (width - part[0]) // 2, (height - part[1]) // 2
        cropped = rgb[top : top + part[1], left : left + part[0]]
        return cast("Image", np.ascontiguousarray(cv2.resize(cropped, self.size, interpolation=cv2.INTER_AREA)))

    def _tables(self, calibration: Calibration) -> tuple[F32, F32, float]:
        """Returns pixel x and y, (height, width), float32, for each pixel of the path's camera, and the ratio of the focal lengths."""
        width, height = self.size
        rays, counts = _rays(self.kind, self.size, self.hfov)
        sees = calibration.hfov()
        if sees < self.hfov - _TOLERANCE:
            raise ViewError(_sees_less(sees, self.hfov))
        x, y = (np.nan_to_num(values, nan=-1e6) for values in calibration.pixels(rays))
        outside = (x < -1.0) | (x > calibration.width) | (y < -1.0) | (y > calibration.height)
        if (outside & counts).sum() > 0.02 * counts.sum():
            raise ViewError(_LOWER)
        shrink = calibration.k[0] / _focal(self.kind, self.size, self.hfov)
        return x.astype(np.float32).reshape(height, width), y.astype(np.float32).reshape(height, width), shrink


class ViewAssembler(Generic[_Image]):
    """Combines the images of several cameras, of the same time, into views."""

    def __init__(self, kind: CameraKind, tolerance_ns: int = 20_000_000) -> None:
        """Begins without images.

        Args:
            kind: kind of the path's camera.
            tolerance_ns: largest difference between the stamps of the images of one view, ns.
        """
        self._tolerance_ns = tolerance_ns
        # One camera may be slower than the other by several images.
        self._waiting: dict[str, deque[tuple[int, _Image]]] = {name: deque(maxlen=_MAX_WAITING) for name in IMAGES_OF[kind]}
        """Images that are in no view yet, with their stamps, ns."""

    def clear(self) -> None:
        """Drops the images that are in no view yet."""
        for images in self._waiting.values():
            images.clear()

    def add(self, name: str, stamp_ns: int, image: _Image) -> tuple[int, tuple[_Image, ...]] | None:
        """Adds an image; returns the stamp of the first image, ns, and the images of a view in the order of ``IMAGES_OF``, if it is complete.

        Args:
            name: one of ``IMAGES_OF``.
            stamp_ns: stamp of the image, ns.
            image: an image, or the message with it.
        """
        self._waiting[name].append((stamp_ns, image))
        nearest = [min(images, key=lambda each: abs(each[0] - stamp_ns), default=None) for images in self._waiting.values()]
        view = [each for each in nearest if each is not None and abs(each[0] - stamp_ns) <= self._tolerance_ns]
        if len(view) < len(nearest):
            return None
        for images, (used_ns, _) in zip(self._waiting.values(), view, strict=True):
            while images and images[0][0] <= used_ns:
                images.popleft()
        return view[0][0], tuple(image for _, image in view)

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the cameras without an image that waits for the others."""
        return tuple(name for name, images in self._waiting.items() if not images)

    @property
    def gap_ns(self) -> int | None:
        """Smallest difference between the stamps of images of two cameras that are in no view, ns; None = one of them has none."""
        gaps = [abs(a - b) for one, other in itertools.combinations(self._waiting.values(), 2) for a, _ in one for b, _ in other]
        return min(gaps, default=None)


_LOWER = (
    "the camera sees less upwards and downwards than that of the path; use the camera of the recording, or record the path with a "
    "smaller hfov_deg or lower images"
)


def _sees_less(sees: float, needed: float) -> str:
    return (
        f"the camera sees {math.degrees(sees):.0f} degrees, that of the path {math.degrees(needed):.0f}; use the camera of the recording, "
        "or record the path with a smaller hfov_deg"
    )


def _focal(kind: CameraKind, size: tuple[int, int], hfov: float) -> float:
    """Returns the focal length of the path's camera, pixels: per tangent of a pinhole, per radian of a fisheye."""
    return min(size) / hfov if kind == "fisheye_pair" else size[0] / 2.0 / math.tan(hfov / 2.0)


def _rays(kind: CameraKind, size: tuple[int, int], hfov: float) -> tuple[F64, NDArray[np.bool_]]:
    """Returns the rays (N, 3), float64, optical frame, of the path camera's pixels, and whether each is within a fisheye's circle (N,)."""
    focal = _focal(kind, size, hfov)
    x, y = np.meshgrid(np.arange(size[0]) - (size[0] - 1) / 2.0, np.arange(size[1]) - (size[1] - 1) / 2.0)
    if kind == "pinhole":
        return np.stack([x.ravel(), y.ravel(), np.full(x.size, focal)], axis=1), np.ones(x.size, dtype=np.bool_)
    across = np.hypot(x, y)
    angle = np.minimum(across / focal, math.pi)
    scale = np.sin(angle) / np.maximum(across, 1e-9)
    rays = np.stack([(x * scale).ravel(), (y * scale).ravel(), np.cos(angle).ravel()], axis=1)
    return rays, np.asarray(across.ravel() <= min(size) / 2.0)

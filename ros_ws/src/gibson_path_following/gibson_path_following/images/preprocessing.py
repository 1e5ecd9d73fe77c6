"""Projects the images of a view onto one panorama of normalised contrast, in which a rotation of the robot is a column shift."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import SettingError, ViewError, check_ranges
from gibson_path_following.types import IMAGES_OF, CameraKind, View

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
_MIN_EDGE = 1e-3
"""Least length of a gradient, grey levels: it keeps flat parts at 0."""


@dataclass(frozen=True, slots=True)
class PreprocessingSettings:
    """Size of the panorama, and how its contrast is normalised."""

    columns_per_radian: float = 45.0
    """Columns of the panorama per radian of azimuth."""
    rows: int = 32
    """Rows of the panorama."""
    half_height: float = 0.7
    """Tangent of the largest elevation, upwards and downwards, in the panorama."""
    smoothing: float = 0.9
    """Standard deviation of the Gaussian against noise, pixels of the panorama."""
    window: float = 3.7
    """Standard deviation of the Gaussian window within which contrast is normalised, pixels of the panorama."""
    contrast_floor: float = 3.0
    """Contrast below which a window counts as flat, grey levels: noise is not amplified beyond it."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("columns_per_radian", 5.0, 1000.0),
            ("rows", 4, 1024),
            ("half_height", 0.05, 5.0),
            ("smoothing", 0.0, 20.0),
            ("window", 1.0, 200.0),
            ("contrast_floor", 0.01, 255.0),
        )


class Preprocessor:
    """Projects views of one camera onto panoramas; it computes its lookup tables once."""

    def __init__(
        self, camera: CameraKind, hfov: float, size: tuple[int, int], settings: PreprocessingSettings | None = None
    ) -> None:
        """Computes the lookup tables.

        Args:
            camera: kind of the camera.
            hfov: horizontal field of view of an image, radians; of a fisheye across its circle.
            size: width and height of an image, pixels.
            settings: size and contrast; None = the defaults.

        Raises:
            SettingError: the field of view does not fit the camera.
        """
        self.camera, self.size = camera, size
        self.settings = settings or PreprocessingSettings()
        widest = math.radians(179.0) if camera == "pinhole" else 2.0 * math.pi
        if not math.radians(5.0) <= hfov <= widest:
            raise SettingError(
                f"the field of view is {math.degrees(hfov):.1f} degrees, must be 5 to {math.degrees(widest):.0f} ({camera})"
            )
        self.is_closed = camera == "fisheye_pair"
        """Whether the panorama covers 360 degrees, so that its last column is next to its first."""
        across = 2.0 * math.pi if self.is_closed else hfov
        self.columns = max(8, round(across * self.settings.columns_per_radian))
        self.radians_per_column = across / self.columns
        """Azimuth of a column, radians."""
        azimuth = (
            across / 2.0 - (np.arange(self.columns, dtype=np.float64) + 0.5) * self.radians_per_column
        )  # positive to the left
        rows = self.settings.rows
        up = self.settings.half_height * (1.0 - (2.0 * np.arange(rows, dtype=np.float64) + 1.0) / rows)
        if self.is_closed:
            self._tables = [_fisheye(azimuth - turn, up, hfov, size) for turn in (0.0, math.pi)]
        else:
            self._tables = [_pinhole(azimuth, up, hfov, size)]

    def panorama(self, view: View, zoom: float = 1.0) -> F32:
        """Returns the grey panorama of a view, (rows, columns), float32, 0 to 255; its middle column is ahead, its left half to the left.

        Args:
            view: the images.
            zoom: focal length of their camera, relative to the camera of this object.

        Raises:
            ViewError: number or size of the images are not those of the camera.
        """
        names = IMAGES_OF[self.camera]
        if len(view) != len(names):
            raise ViewError(f"a view of {len(view)} images, but a {self.camera} camera has {len(names)}: {', '.join(names)}")
        grey = np.zeros((self.settings.rows, self.columns), dtype=np.float32)
        for image, name, (x, y, weight) in zip(view, names, self._tables, strict=True):
            if image.shape != (self.size[1], self.size[0], 3) or image.dtype != np.uint8:
                raise ViewError(
                    f"image {name} has shape {image.shape} and type {image.dtype}, the path has ({self.size[1]}, {self.size[0]}, 3) "
                    "uint8; use the camera and the size of the recording"
                )
            luma: F32 = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
            # A panorama that is smaller than the image is low-pass filtered first.
            shrink = max(1.0, self.size[0] * len(view) / self.columns)
            if shrink > 1.5:
                luma = _blur(luma, 0.4 * shrink)
            if zoom != 1.0:
                middle = self.size[0] / 2.0 - 0.5, self.size[1] / 2.0 - 0.5
                x, y = (np.float32(zoom) * at + np.float32((1.0 - zoom) * m) for at, m in zip((x, y), middle, strict=True))
            grey += weight * cv2.remap(luma, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return grey

    def normalised(self, panorama: F32) -> F32:
        """Returns a grey panorama with local mean 0 and standard deviation 1, (rows, columns), float32, invariant to light and exposure.

        It discriminates places better than horizontal gradients alone, which shelves, tables and floors do not have.
        """
        settings = self.settings
        pad = min(math.ceil(4 * settings.window), panorama.shape[1]) if self.is_closed else 0
        wide = np.concatenate([panorama[:, -pad:], panorama, panorama[:, :pad]], axis=1) if pad else panorama
        smooth = _blur(wide, settings.smoothing)
        centred = smooth - _blur(smooth, settings.window)
        deviation = np.sqrt(np.maximum(_blur(centred**2, settings.window), 0.0))
        found = centred / (deviation + settings.contrast_floor)
        return np.ascontiguousarray(found[:, pad : pad + panorama.shape[1]])

    def descriptor(self, view: View, zoom: float = 1.0) -> F32:
        """Returns the descriptor of a view, (3, rows, columns), float32: its normalised panorama, and the orientation of its edges.

        Where the sun comes in, a surface that was brighter than its surroundings may be darker, and the panorama changes its sign. The
        orientation of an edge, an angle modulo 180 degrees, does not. The panorama says more where there are few edges.

        Args:
            view: the images.
            zoom: see ``panorama``.

        Raises:
            ViewError: number or size of the images are not those of the camera.
        """
        grey = self.normalised(self.panorama(view, zoom))
        pad = min(math.ceil(4 * self.settings.window), grey.shape[1]) if self.is_closed else 0
        wide = np.concatenate([grey[:, -pad:], grey, grey[:, :pad]], axis=1) if pad else grey
        across, down = (cv2.Sobel(wide, cv2.CV_32F, x, 1 - x, borderType=cv2.BORDER_REPLICATE) for x in (1, 0))
        # Doubled angles make opposite directions equal. The root gives weak edges more weight.
        length = np.sqrt(np.sqrt(across**2 + down**2)) + _MIN_EDGE
        length *= length * length
        edges = ((across**2 - down**2) / length, 2.0 * across * down / length)
        edges = tuple((part - _blur(part, self.settings.window))[:, pad : pad + grey.shape[1]] for part in edges)
        # Grey levels and edges have equal weight.
        share = float(np.sqrt((grey**2).sum() / max(float((edges[0] ** 2 + edges[1] ** 2).sum()), 1e-9) * 2.0))
        return np.stack([grey, share * edges[0], share * edges[1]])


def texture(view: View) -> float:
    """Returns the texture of a view: standard deviation of block means, grey levels; about 0 = a covered lens.

    It is the largest of all images. Block means hold little of the noise of a sensor.
    """
    best = 0.0
    for image in view:
        small = cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (16, 12), interpolation=cv2.INTER_AREA)
        best = max(best, float(small.std()))
    return best


def _blur(image: F32, sigma: float) -> F32:
    if sigma <= 0.0:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE), dtype=np.float32)


def _pinhole(azimuth: F64, up: F64, hfov: float, size: tuple[int, int]) -> tuple[F32, F32, F32]:
    """Returns pixel x, pixel y and weight for each pixel of the panorama, (rows, columns); square pixels, centred axis."""
    focal = size[0] / 2.0 / math.tan(hfov / 2.0)  # pixels
    x = size[0] / 2.0 - 0.5 - focal * np.tan(azimuth)[None, :] + np.zeros_like(up)[:, None]
    y = size[1] / 2.0 - 0.5 - focal * up[:, None] / np.cos(azimuth)[None, :]
    return x.astype(np.float32), y.astype(np.float32), np.ones(x.shape, dtype=np.float32)


def _fisheye(azimuth: F64, up: F64, fov: float, size: tuple[int, int]) -> tuple[F32, F32, F32]:
    """Returns the same for an equidistant fisheye whose circle touches the nearer sides; weight 0 where the other fisheye sees better."""
    azimuth = (azimuth + math.pi) % (2.0 * math.pi) - math.pi
    radius = min(size) / 2.0  # pixels, at fov / 2
    right, ahead = -np.sin(azimuth)[None, :], np.cos(azimuth)[None, :]
    above = up[:, None] + np.zeros_like(azimuth)[None, :]
    angle = np.arctan2(np.hypot(right, above), ahead + np.zeros_like(above))
    length = np.maximum(np.hypot(right, above), 1e-9)
    from_centre = radius * angle / (fov / 2.0)
    x = size[0] / 2.0 - 0.5 + from_centre * right / length
    y = size[1] / 2.0 - 0.5 - from_centre * above / length
    weight = (np.cos(azimuth) > 0.0)[None, :] + np.zeros_like(above)
    return x.astype(np.float32), y.astype(np.float32), weight.astype(np.float32)

"""Converts posed photographs with depth to posed RGB-D for fusion: one camera for all frames, colours registered to the depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.photographs.photographs import Photographs
from gibson_sim_tools.scanning.posed_rgbd import FrameFiles, Intrinsics, PosedRgbd, RgbdFrame, ScanError, read_image

_MIN_FRAMES = 2
"""Least number of frames of a fusion."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthFrames(PosedRgbd):
    """Photographs with depth as posed RGB-D. Frames are remapped to common intrinsics, because the focal length of phones varies with focus."""

    photographs: Photographs = field(kw_only=True)
    """Photographs with depth, scaled to the size of their depth images."""

    def __getitem__(self, number: int) -> RgbdFrame:
        """Reads a frame.

        Raises:
            IndexError: there is no such frame.
            ScanError: an image is missing or broken.
        """
        depth = self.photographs.depth(number)
        assert depth is not None
        camera, common_camera = self.photographs.intrinsics(number), self.intrinsics
        u, v = np.meshgrid(np.arange(common_camera.width, dtype=np.float32), np.arange(common_camera.height, dtype=np.float32))
        x = ((u - common_camera.cx) * (camera.fx / common_camera.fx) + camera.cx).astype(np.float32)
        y = ((v - common_camera.cy) * (camera.fy / common_camera.fy) + camera.cy).astype(np.float32)
        rgb = np.asarray(cv2.remap(self.photographs.image(number), x, y, cv2.INTER_LINEAR), dtype=np.uint8)
        nearest: NDArray[np.float32] = np.asarray(
            cv2.remap(depth, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan")), dtype=np.float32
        )
        return RgbdFrame(number % len(self), rgb, nearest, self.photographs.items[number].T_world_camera.copy())

    def with_poses(self, poses: NDArray[np.float64]) -> DepthFrames:
        """Returns the frames with other poses, T_world_camera, (N, 4, 4)."""
        return replace(self, files=PosedRgbd.with_poses(self, poses).files, photographs=self.photographs.with_poses(poses))

    def subset(self, numbers: Sequence[int]) -> DepthFrames:
        """Returns the frames with these numbers, in their order."""
        return replace(self, files=PosedRgbd.subset(self, numbers).files, photographs=self.photographs.subset(numbers))


def depth_frames(photographs: Photographs) -> DepthFrames | None:
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
    files = tuple(FrameFiles(item.file, item.depth, item.T_world_camera) for item in resized.items if item.depth is not None)
    return DepthFrames(
        resized.folder, resized.layout, Intrinsics(width, height, fx, fy, cx, cy), first.depth_scale, files, photographs=resized
    )

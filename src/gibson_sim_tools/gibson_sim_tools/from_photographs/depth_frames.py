"""Posed photographs with depth as posed RGB-D, which is fused: all frames with one camera, colours on the pixels of the depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.photographs.photographs import Photographs
from gibson_sim_tools.scanning.posed_rgbd import FrameFiles, Intrinsics, PosedRgbd, RgbdFrame, ScanError, read_image

_LEAST = 2
"""Least number of photographs with depth that are fused."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthFrames(PosedRgbd):
    """Photographs with depth whose cameras may differ, as those of phones that focus: each frame is drawn as the common camera sees it."""

    photographs: Photographs = field(kw_only=True)
    """Those with depth, reduced to its size."""

    def __getitem__(self, number: int) -> RgbdFrame:
        """Reads a frame.

        Raises:
            IndexError: there is no such frame.
            ScanError: an image is missing or broken.
        """
        depth = self.photographs.depth(number)
        assert depth is not None
        own, common = self.photographs.intrinsics(number), self.intrinsics
        u, v = np.meshgrid(np.arange(common.width, dtype=np.float32), np.arange(common.height, dtype=np.float32))
        x = ((u - common.cx) * (own.fx / common.fx) + own.cx).astype(np.float32)
        y = ((v - common.cy) * (own.fy / common.fy) + own.cy).astype(np.float32)
        rgb = np.asarray(cv2.remap(self.photographs.image(number), x, y, cv2.INTER_LINEAR), dtype=np.uint8)
        nearest: NDArray[np.float32] = np.asarray(
            cv2.remap(depth, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan")), dtype=np.float32
        )
        return RgbdFrame(number % len(self), rgb, nearest, self.photographs.items[number].T_world_camera.copy())

    def with_poses(self, poses: NDArray[np.float64]) -> DepthFrames:
        """Returns the same frames at other poses, (N, 4, 4)."""
        return replace(self, files=PosedRgbd.with_poses(self, poses).files, photographs=self.photographs.with_poses(poses))

    def subset(self, numbers: Sequence[int]) -> DepthFrames:
        """Returns some of the frames."""
        return replace(self, files=PosedRgbd.subset(self, numbers).files, photographs=self.photographs.subset(numbers))


def depth_frames(photographs: Photographs) -> DepthFrames | None:
    """Returns the photographs that have depth; None if hardly any has.

    Raises:
        ScanError: the first depth image cannot be read.
    """
    numbers = [k for k, item in enumerate(photographs.items) if item.depth is not None]
    if len(numbers) < _LEAST:
        return None
    first = photographs.items[numbers[0]]
    assert first.depth is not None
    units = read_image(first.depth, cv2.IMREAD_UNCHANGED)
    if units.ndim != 2:
        raise ScanError(f"{first.depth}: is an image of shape {units.shape}; depth must have one channel")
    height, width = units.shape
    small = photographs.subset(numbers)
    small = Photographs(small.folder, small.layout, small.items, longest_side=max(width, height))
    lenses = [small.intrinsics(k) for k in range(len(small))]
    fx, fy, cx, cy = np.median(
        [(i.fx, i.fy, i.cx, i.cy) for i in (lens.resized(width, height) for lens in lenses)], axis=0
    ).tolist()
    files = tuple(FrameFiles(item.file, item.depth, item.T_world_camera) for item in small.items if item.depth is not None)
    return DepthFrames(
        small.folder, small.layout, Intrinsics(width, height, fx, fy, cx, cy), first.depth_scale, files, photographs=small
    )

"""Organised point clouds from depth images of any camera: one point per pixel, in the optical frame. Pure."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.projections import rays
from gibson_sim.types import CameraSpec, DepthNoise, Frame, ImageEffects, Pose

F32 = NDArray[np.float32]
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
COLORED_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
"""``rgb`` is 0x00RRGGBB; PCL and RViz reinterpret its four bytes as a float32."""


def cloud_of_frame(frame: Frame) -> NDArray[np.void]:
    """Returns the points of a frame with depth, (H, W) of ``COLORED_POINT``, or of ``POINT`` without colours.

    Points are in the optical frame, metres; x, y and z are NaN where there is no depth.
    """
    assert frame.depth is not None
    cloud = np.empty(frame.depth.shape, dtype=POINT if frame.rgb is None else COLORED_POINT)
    # Products of infinite depths with ray components would be a mix of infinities and NaN.
    depth = np.where(np.isfinite(frame.depth), frame.depth, np.float32(np.nan))
    for name, part in zip("xyz", _rays(_optics(frame.camera)), strict=True):
        np.multiply(part, depth, out=cloud[name])
    if frame.rgb is not None:
        red, green, blue = (frame.rgb[:, :, k].astype(np.uint32) for k in range(3))
        cloud["rgb"] = (red << 16) | (green << 8) | blue
    return cloud


def _optics(camera: CameraSpec) -> CameraSpec:
    """Returns the camera with all fields neutral that its rays do not depend on, so that cameras with equal optics share rays."""
    return replace(
        camera, name="", link="", pose=Pose(), rate_hz=1.0, outputs=("depth",), effects=ImageEffects(), depth_noise=DepthNoise()
    )


@lru_cache(maxsize=8)
def _rays(camera: CameraSpec) -> F32:
    """Returns the point at depth 1 of each pixel, (3, H, W)."""
    parts: F32 = np.ascontiguousarray(np.moveaxis(rays(camera), -1, 0), dtype=np.float32)
    parts.flags.writeable = False
    return parts

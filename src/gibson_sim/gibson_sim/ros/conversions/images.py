"""Converts images, camera calibrations and label names."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from gibson_sim.errors import SceneError
from gibson_sim.quoting import quoted
from gibson_sim.ros.conversions.basics import header_to_msg
from gibson_sim.types import DISTORTIONS, CameraSpec, Frame, Output

ENCODINGS: dict[Output, str] = {
    "rgb": "rgb8",
    "depth": "32FC1",
    "semantic": "16UC1",
    "instance": "16UC1",
    "normal": "32FC3",
    "normal_world": "32FC3",
    "position": "32FC3",
    "flow": "32FC2",
    "hole": "8UC1",
}
"""Output -> encoding in an image message."""
_PIXELS: dict[str, tuple[type[np.generic], int]] = {
    "rgb8": (np.uint8, 3),
    "8UC1": (np.uint8, 1),
    "32FC1": (np.float32, 1),
    "16UC1": (np.uint16, 1),
    "32FC2": (np.float32, 2),
    "32FC3": (np.float32, 3),
}
"""Encoding -> dtype and number of channels."""


def camera_info_to_msg(camera: CameraSpec, stamp_ns: int) -> CameraInfo:
    """Returns the calibration of a camera with an unrectified image: R is the identity and the left 3x3 block of P is K.

    For the right camera of a stereo pair, P has Tx = -fx * baseline. ROS has no equirectangular camera model: ``distortion_model`` is
    ``equirectangular`` and all matrices are zero, which means "not calibrated" to nodes that expect a pinhole camera.
    """
    info = CameraInfo(header=header_to_msg(stamp_ns, camera.optical_frame), height=camera.height, width=camera.width)
    if camera.projection == "equirectangular":
        info.distortion_model = camera.projection
        info.r = np.zeros(9)
        return info
    k = camera.intrinsics()
    p = np.zeros((3, 4))
    p[:, :3] = k
    p[0, 3] = -k[0, 0] * camera.stereo_baseline
    info.distortion_model = camera.distortion_model
    info.d = camera.distortion or [0.0] * DISTORTIONS[camera.projection][info.distortion_model][-1]
    info.k, info.r, info.p = k.ravel(), np.eye(3).ravel(), p.ravel()
    return info


def image_to_msg(pixels: NDArray[Any], encoding: str, stamp_ns: int, frame_id: str) -> Image:
    """Returns an image message with a copy of C-contiguous ``pixels``, (H, W) or (H, W, C), row 0 at the top."""
    height, width = pixels.shape[:2]
    data = array("B")
    data.frombytes(pixels.data.cast("B"))
    msg = Image(header=header_to_msg(stamp_ns, frame_id))
    msg.height, msg.width, msg.encoding = height, width, encoding
    msg.is_bigendian = 0
    msg.step = pixels.strides[0]
    msg.data = data
    return msg


def frame_to_image_msgs(
    frame: Frame, kinds: Collection[str] | None = None, make_image: Callable[..., Any] = image_to_msg
) -> Iterator[tuple[str, Any]]:
    """Yields the kind (see ``names.camera_topics``) and the message of each image and camera_info of a frame, with the frame's stamp.

    Messages are created lazily, so that a message reuses the memory of the previous one, which is still in the CPU cache.

    Args:
        frame: frame with the images.
        kinds: kinds of messages to create; None = all.
        make_image: creates a sensor_msgs/Image: ``image_to_msg``, or ``fast_publish.image_to_bytes``.
    """
    camera, stamp = frame.camera, frame.stamp_ns
    for output, encoding in ENCODINGS.items():
        pixels = getattr(frame, output)
        if pixels is None:
            continue
        if kinds is None or output in kinds:
            yield output, make_image(pixels, encoding, stamp, camera.optical_frame)
        if kinds is None or f"{output}_info" in kinds:
            yield f"{output}_info", camera_info_to_msg(camera, stamp)


def compressed_to_msg(data: bytes, image_format: str, stamp_ns: int, frame_id: str) -> CompressedImage:
    """Returns a compressed image message; ``data`` and ``image_format`` are results of ``sensors.image_codecs``."""
    return CompressedImage(header=header_to_msg(stamp_ns, frame_id), format=image_format, data=array("B", data))


def label_info_type() -> Any:
    """Returns the type of LabelInfo messages: vision_msgs if it is installed, otherwise gibson_msgs, which has the same fields."""
    return _label_module().LabelInfo


def label_info_to_msg(labels: Sequence[str], stamp_ns: int, frame_id: str) -> Any:
    """Returns the message with the names of labels; the index into ``labels`` is the number of the label."""
    module = _label_module()
    label_class = getattr(module, "VisionClass", None) or module.LabelClass
    classes = [label_class(class_id=number, class_name=name) for number, name in enumerate(labels)]
    return module.LabelInfo(header=header_to_msg(stamp_ns, frame_id), class_map=classes, threshold=1.0)


def _label_module() -> Any:
    return import_module("gibson_msgs.msg" if find_spec("vision_msgs") is None else "vision_msgs.msg")


def array_from_image(msg: Image) -> NDArray[Any]:
    """Returns the pixels of an image in one of ``ENCODINGS``, (H, W), (H, W, 2) or (H, W, 3), a view of the message's memory.

    Raises:
        SceneError: the encoding is unknown.
    """
    if msg.encoding not in _PIXELS:
        raise SceneError(f"image has encoding {quoted(msg.encoding)}, known: {', '.join(_PIXELS)}")
    dtype, channels = _PIXELS[msg.encoding]
    rows = np.frombuffer(msg.data, dtype).reshape(msg.height, -1)[:, : msg.width * channels]
    return rows if channels == 1 else rows.reshape(msg.height, msg.width, channels)

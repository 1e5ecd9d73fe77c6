"""Converts image topics to JPEG files for pages; subscribes to them only while a page shows them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, Image

from gibson_sim.sensors.false_colours import colourise_depth, colourise_labels
from gibson_sim.sensors.image_codecs import decode_color, without_exif
from gibson_sim.types import NS_PER_S
from gibson_sim.web.videos import Image as PageImage

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Profile that matches every publisher, and never blocks one."""
_QUALITY = 80
"""JPEG quality, 0 to 100."""
_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_SUFFIX = "/compressed"


def image_topics(graph: list[tuple[str, list[str]]]) -> list[tuple[str, str]]:
    """Returns (topic, type) of every image topic in the graph, compressed ones first; if a topic exists in both forms, only the compressed one.

    Args:
        graph: (topic, types), as rclpy returns them.
    """
    plain = {name for name, types in graph if types == [_IMAGE]}
    compressed = {name for name, types in graph if types == [_COMPRESSED] and name.endswith(_SUFFIX)}
    topics = [(name, _COMPRESSED) for name in compressed]
    topics += [(name, _IMAGE) for name in plain if name + _SUFFIX not in compressed]
    return sorted(topics, key=lambda item: (item[1] != _COMPRESSED, item[0]))


def label_of(topic: str) -> str:
    """Returns the label of an image topic on a page: ``/left/camera/depth/image_raw`` is "left/camera depth"."""
    parts = [part for part in topic.removesuffix(_SUFFIX).strip("/").split("/") if part not in ("image_raw", "image")]
    if len(parts) > 1 and parts[-1] in (
        "depth",
        "semantic",
        "instance",
        "normal",
        "normal_world",
        "position",
        "flow",
        "hole",
        "depth_registered",
    ):
        return f"{'/'.join(parts[:-1])} {parts[-1]}"
    return "/".join(parts) or topic


class Subscriber(Protocol):
    """A node that skips messages that cannot be shown."""

    def subscribe(self, kind: Any, topic: str, callback: Callable[[Any], None], profile: Any, *, raw: bool = False) -> Any:
        """Subscribes to a topic, and returns the subscription."""

    def get_logger(self) -> Any:
        """Returns the logger of the node."""

    def destroy_subscription(self, subscription: Any) -> bool:
        """Ends a subscription."""


class VideoSubscriptions:
    """The subscriptions of the image topics that pages show.

    Args:
        node: node of the subscriptions.
        show: called with each image.
        on_problems: called with topic -> reason why its images cannot be shown, at every change.
    """

    def __init__(
        self, node: Subscriber, show: Callable[[PageImage], None], on_problems: Callable[[dict[str, str]], None] = lambda _: None
    ) -> None:
        self._node, self._show, self._on_problems = node, show, on_problems
        self._problems: dict[str, str] = {}
        self._subscriptions: dict[str, Any] = {}

    def update(self, watched: frozenset[str], known: dict[str, str]) -> None:
        """Subscribes to the image topics that are watched, and unsubscribes from all others.

        Args:
            watched: topics that pages show.
            known: topic -> type of all image topics.
        """
        for topic in set(self._subscriptions) - watched:
            self._node.destroy_subscription(self._subscriptions.pop(topic))
            self._set_problem(topic, "")
        for topic in watched - set(self._subscriptions):
            kind = known.get(topic)
            if kind == _COMPRESSED:
                self._subscriptions[topic] = self._node.subscribe(
                    CompressedImage, topic, partial(self._on_compressed, topic), _NEWEST
                )
            elif kind == _IMAGE:
                self._subscriptions[topic] = self._node.subscribe(Image, topic, partial(self._on_image, topic), _NEWEST)

    def _on_compressed(self, topic: str, msg: CompressedImage) -> None:
        data = bytes(msg.data)
        if not data:
            self._set_problem(topic, "its messages are empty")
            return
        if not data.startswith(b"\xff\xd8"):  # a PNG
            pixels = decode_color(data)
            if pixels is None:
                self._set_problem(topic, f"format {msg.format[:40]!r} is neither JPEG nor PNG")
                return
            data = _jpeg(pixels)
        self._set_problem(topic, "")
        self._show(PageImage(topic, _stamp_s(msg), without_exif(data)))

    def _on_image(self, topic: str, msg: Image) -> None:
        pixels = bgr_image(msg, is_depth="depth" in topic)
        if pixels is None:
            known = msg.encoding in (*_CHANNELS, *_CODES)
            reason = f"have {len(msg.data)} bytes, too few" if known else f"with encoding {msg.encoding[:40]!r} are not drawn"
            self._set_problem(topic, f"images of {msg.width}x{msg.height} {reason}")
            raise ValueError(self._problems[topic])
        self._set_problem(topic, "")
        if pixels.size:
            self._show(PageImage(topic, _stamp_s(msg), _jpeg(pixels)))

    def _set_problem(self, topic: str, problem: str) -> None:
        """Sets the reason why the images of a topic cannot be shown; empty = they can."""
        if self._problems.get(topic, "") != problem:
            self._problems[topic] = problem
            self._on_problems({name: text for name, text in self._problems.items() if text})


def _stamp_s(msg: Any) -> float:
    stamp = msg.header.stamp
    return float(stamp.sec + stamp.nanosec / NS_PER_S)


def _jpeg(bgr: NDArray[np.uint8]) -> bytes:
    return bytes(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1])


_CHANNELS = {
    "rgb8": (np.uint8, 3), "bgr8": (np.uint8, 3), "rgba8": (np.uint8, 4), "bgra8": (np.uint8, 4), "mono8": (np.uint8, 1), "8UC1": (np.uint8, 1),
    "8UC3": (np.uint8, 3), "mono16": (np.uint16, 1), "16UC1": (np.uint16, 1), "32FC1": (np.float32, 1), "32FC2": (np.float32, 2),
    "32FC3": (np.float32, 3),
}  # fmt: skip
"""Encoding -> dtype and number of channels."""
_CODES = {
    # OpenCV names a Bayer pattern by its second row and column, ROS by its first.
    "bayer_rggb8": (cv2.COLOR_BayerBG2BGR, 1.0), "bayer_bggr8": (cv2.COLOR_BayerRG2BGR, 1.0), "bayer_gbrg8": (cv2.COLOR_BayerGR2BGR, 1.0),
    "bayer_grbg8": (cv2.COLOR_BayerGB2BGR, 1.0), "bayer_rggb16": (cv2.COLOR_BayerBG2BGR, 2.0), "bayer_bggr16": (cv2.COLOR_BayerRG2BGR, 2.0),
    "bayer_gbrg16": (cv2.COLOR_BayerGR2BGR, 2.0), "bayer_grbg16": (cv2.COLOR_BayerGB2BGR, 2.0), "yuv422": (cv2.COLOR_YUV2BGR_UYVY, 2.0),
    "uyvy": (cv2.COLOR_YUV2BGR_UYVY, 2.0), "yuv422_yuy2": (cv2.COLOR_YUV2BGR_YUY2, 2.0), "yuyv": (cv2.COLOR_YUV2BGR_YUY2, 2.0),
    "nv21": (cv2.COLOR_YUV2BGR_NV21, 1.0), "nv12": (cv2.COLOR_YUV2BGR_NV12, 1.0),
}  # fmt: skip
"""Encoding of raw images -> OpenCV conversion code, and bytes per pixel of a row; NV12 and NV21 have half as many additional rows of colour."""


def bgr_image(msg: Image, *, is_depth: bool = False) -> NDArray[np.uint8] | None:
    """Returns an image as (H, W, 3) uint8 BGR, with depth and labels in false colours; None if the encoding is unknown or data is missing.

    32FC1 is depth in metres; 16UC1 is depth in millimetres if ``is_depth``, otherwise labels. Near depths are bright, missing ones black.
    mono16 is grey, scaled to its brightest pixel. 32FC3 is normals (-1 to 1).
    """
    if msg.encoding in _CODES:
        return _converted(msg)
    if msg.encoding not in _CHANNELS:
        return None
    dtype, channels = _CHANNELS[msg.encoding]
    size = np.dtype(dtype).itemsize
    if msg.width < 1 or msg.height < 1 or msg.step < msg.width * channels * size or len(msg.data) < msg.step * msg.height:
        return None
    rows = np.frombuffer(msg.data, np.uint8)[: msg.step * msg.height].reshape(msg.height, msg.step)[
        :, : msg.width * channels * size
    ]
    pixels = np.ascontiguousarray(rows).view(dtype).reshape(msg.height, msg.width, channels)
    if msg.encoding in ("rgb8", "rgba8"):
        return np.ascontiguousarray(pixels[:, :, 2::-1])
    if dtype is np.uint8:
        return np.repeat(pixels, 3, axis=2) if channels == 1 else np.ascontiguousarray(pixels[:, :, :3])
    if msg.encoding == "32FC1":
        return colourise_depth(pixels[:, :, 0])
    if dtype is np.uint16:
        if is_depth:
            return colourise_depth(pixels[:, :, 0].astype(np.float32) / np.float32(1000.0))
        if msg.encoding == "mono16":
            grey = pixels[:, :, :1].astype(np.float32) * (255.0 / max(1, int(pixels.max(initial=0))))
            return np.repeat(grey.astype(np.uint8), 3, axis=2)
        return colourise_labels(pixels[:, :, 0])
    out = np.zeros((msg.height, msg.width, 3), dtype=np.uint8)
    values = np.nan_to_num(pixels[:, :, :3], nan=0.0, posinf=0.0, neginf=0.0)
    out[:, :, 3 - channels :] = np.clip(127.5 * (values + 1.0), 0, 255)[:, :, ::-1]
    return out


def _converted(msg: Image) -> NDArray[np.uint8] | None:
    """Returns a Bayer, YUV 4:2:2 or YUV 4:2:0 image as (H, W, 3) uint8 BGR; None if its data is too short."""
    code, size = _CODES[msg.encoding]
    rows = msg.height * 3 // 2 if msg.encoding.startswith("nv") else msg.height
    width = round(msg.width * size)
    if min(msg.width, msg.height) < 2 or msg.width % 2 or msg.height % 2 or msg.step < width or len(msg.data) < msg.step * rows:
        return None
    data = np.frombuffer(msg.data, np.uint8)[: msg.step * rows].reshape(rows, msg.step)[:, :width]
    if msg.encoding.endswith("16"):  # the upper byte is sufficient for display
        data = (np.ascontiguousarray(data).view(">u2" if msg.is_bigendian else "<u2") >> 8).astype(np.uint8)
    elif size == 2.0:
        data = data.reshape(msg.height, msg.width, 2)
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(data, dtype=np.uint8), code), dtype=np.uint8)

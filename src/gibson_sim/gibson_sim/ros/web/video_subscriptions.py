"""Image topics as JPEG files: subscribed to while a page watches them, and no longer."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, Image

from gibson_sim.types import NS_PER_S
from gibson_sim.web.videos import Image as PageImage

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Matches whatever is offered, and holds no publisher up."""
_QUALITY = 80
"""JPEG quality, 0 to 100."""
_FAR_M = 8.0
"""Depth that is drawn as the farthest, metres."""
_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_SUFFIX = "/compressed"


def image_topics(graph: list[tuple[str, list[str]]]) -> list[tuple[str, str]]:
    """Returns (topic, type) of every video in the graph, colour before the rest; where a topic exists in both forms, the compressed one.

    Args:
        graph: (topic, types), as rclpy returns them.
    """
    plain = {name for name, types in graph if types == [_IMAGE]}
    compressed = {name for name, types in graph if types == [_COMPRESSED] and name.endswith(_SUFFIX)}
    found = [(name, _COMPRESSED) for name in compressed]
    found += [(name, _IMAGE) for name in plain if name + _SUFFIX not in compressed]
    return sorted(found, key=lambda item: (item[1] != _COMPRESSED, item[0]))


def label_of(topic: str) -> str:
    """Returns what a page calls a video: ``/left/camera/depth/image_raw`` is "left/camera depth"."""
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
    """A node that leaves out what cannot be shown."""

    def subscribe(self, kind: Any, topic: str, callback: Callable[[Any], None], profile: Any, *, raw: bool = False) -> Any:
        """Subscribes to a topic, and returns the subscription."""

    def get_logger(self) -> Any:
        """Returns the logger of the node."""

    def destroy_subscription(self, subscription: Any) -> bool:
        """Ends a subscription."""


class VideoSubscriptions:
    """The subscriptions of the videos that any page watches.

    Args:
        node: subscribes.
        show: is called with each image.
        on_problems: is called with topic -> why its images are not drawn, at every change.
    """

    def __init__(
        self, node: Subscriber, show: Callable[[PageImage], None], on_problems: Callable[[dict[str, str]], None] = lambda _: None
    ) -> None:
        self._node, self._show, self._on_problems = node, show, on_problems
        self._problems: dict[str, str] = {}
        self._subscriptions: dict[str, Any] = {}

    def update(self, watched: frozenset[str], known: dict[str, str]) -> None:
        """Subscribes to what is watched and known, and to nothing else.

        Args:
            watched: topics.
            known: topic -> type, of all videos.
        """
        for topic in set(self._subscriptions) - watched:
            self._node.destroy_subscription(self._subscriptions.pop(topic))
            self._note(topic, "")
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
            self._note(topic, "its messages are empty")
            return
        if not data.startswith(b"\xff\xd8"):  # a PNG
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
            if pixels is None:
                self._note(topic, f"format {msg.format[:40]!r} is neither JPEG nor PNG")
                return
            data = _jpeg(np.asarray(pixels, dtype=np.uint8))
        self._note(topic, "")
        self._show(PageImage(topic, _stamp_s(msg), data))

    def _on_image(self, topic: str, msg: Image) -> None:
        pixels = picture_of(msg, is_depth="depth" in topic)
        if pixels is None:
            known = msg.encoding in (*_CHANNELS, *_CODES)
            why = f"have {len(msg.data)} bytes, too few" if known else f"with encoding {msg.encoding[:40]!r} are not drawn"
            self._note(topic, f"images of {msg.width}x{msg.height} {why}")
            raise ValueError(self._problems[topic])
        self._note(topic, "")
        if pixels.size:
            self._show(PageImage(topic, _stamp_s(msg), _jpeg(pixels)))

    def _note(self, topic: str, problem: str) -> None:
        """Notes why the images of a topic are not drawn; empty = they are."""
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
"""Encoding -> type and number of channels."""
_CODES = {
    # OpenCV names a Bayer pattern by the second row and column, ROS by the first.
    "bayer_rggb8": (cv2.COLOR_BayerBG2BGR, 1.0), "bayer_bggr8": (cv2.COLOR_BayerRG2BGR, 1.0), "bayer_gbrg8": (cv2.COLOR_BayerGR2BGR, 1.0),
    "bayer_grbg8": (cv2.COLOR_BayerGB2BGR, 1.0), "bayer_rggb16": (cv2.COLOR_BayerBG2BGR, 2.0), "bayer_bggr16": (cv2.COLOR_BayerRG2BGR, 2.0),
    "bayer_gbrg16": (cv2.COLOR_BayerGR2BGR, 2.0), "bayer_grbg16": (cv2.COLOR_BayerGB2BGR, 2.0), "yuv422": (cv2.COLOR_YUV2BGR_UYVY, 2.0),
    "uyvy": (cv2.COLOR_YUV2BGR_UYVY, 2.0), "yuv422_yuy2": (cv2.COLOR_YUV2BGR_YUY2, 2.0), "yuyv": (cv2.COLOR_YUV2BGR_YUY2, 2.0),
    "nv21": (cv2.COLOR_YUV2BGR_NV21, 1.0), "nv12": (cv2.COLOR_YUV2BGR_NV12, 1.0),
}  # fmt: skip
"""Encoding of raw cameras -> OpenCV's conversion, and bytes of a pixel in a row; NV12 and NV21 have half as many rows of colour below."""


def picture_of(msg: Image, *, is_depth: bool = False) -> NDArray[np.uint8] | None:
    """Returns an image as (H, W, 3) uint8 BGR: colours as they are, depth and labels in false colours; None for an encoding that is not known.

    32FC1 is depth in metres, 16UC1 depth in millimetres if ``is_depth``, else labels: near is bright, nothing is black. mono16 is grey, scaled to
    its brightest pixel. 32FC3 are normals (-1 to 1).
    """
    if msg.encoding in _CODES:
        return _converted(msg)
    if msg.encoding not in _CHANNELS:
        return None
    kind, channels = _CHANNELS[msg.encoding]
    size = np.dtype(kind).itemsize
    if msg.width < 1 or msg.height < 1 or msg.step < msg.width * channels * size or len(msg.data) < msg.step * msg.height:
        return None
    rows = np.frombuffer(msg.data, np.uint8)[: msg.step * msg.height].reshape(msg.height, msg.step)[
        :, : msg.width * channels * size
    ]
    pixels = np.ascontiguousarray(rows).view(kind).reshape(msg.height, msg.width, channels)
    if msg.encoding in ("rgb8", "rgba8"):
        return np.ascontiguousarray(pixels[:, :, 2::-1])
    if kind is np.uint8:
        return np.repeat(pixels, 3, axis=2) if channels == 1 else np.ascontiguousarray(pixels[:, :, :3])
    if msg.encoding == "32FC1":
        return _depth(pixels[:, :, 0])
    if kind is np.uint16:
        if is_depth:
            return _depth(pixels[:, :, 0].astype(np.float32) / np.float32(1000.0))
        if msg.encoding == "mono16":
            grey = pixels[:, :, :1].astype(np.float32) * (255.0 / max(1, int(pixels.max(initial=0))))
            return np.repeat(grey.astype(np.uint8), 3, axis=2)
        return _labels(pixels[:, :, 0])
    out = np.zeros((msg.height, msg.width, 3), dtype=np.uint8)
    values = np.nan_to_num(pixels[:, :, :3], nan=0.0, posinf=0.0, neginf=0.0)
    out[:, :, 3 - channels :] = np.clip(127.5 * (values + 1.0), 0, 255)[:, :, ::-1]
    return out


def _converted(msg: Image) -> NDArray[np.uint8] | None:
    """Returns an image of a Bayer pattern, YUV 4:2:2 or YUV 4:2:0 as (H, W, 3) uint8 BGR; None where its data are too short."""
    code, size = _CODES[msg.encoding]
    rows = msg.height * 3 // 2 if msg.encoding.startswith("nv") else msg.height
    width = round(msg.width * size)
    if min(msg.width, msg.height) < 2 or msg.width % 2 or msg.height % 2 or msg.step < width or len(msg.data) < msg.step * rows:
        return None
    data = np.frombuffer(msg.data, np.uint8)[: msg.step * rows].reshape(rows, msg.step)[:, :width]
    if msg.encoding.endswith("16"):  # the upper byte is enough for a screen
        data = (np.ascontiguousarray(data).view(">u2" if msg.is_bigendian else "<u2") >> 8).astype(np.uint8)
    elif size == 2.0:
        data = data.reshape(msg.height, msg.width, 2)
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(data, dtype=np.uint8), code), dtype=np.uint8)


def _depth(metres: NDArray[np.float32]) -> NDArray[np.uint8]:
    near = np.clip(1.0 - np.nan_to_num(metres, nan=_FAR_M, posinf=_FAR_M, neginf=_FAR_M) / _FAR_M, 0.0, 1.0)
    colors: NDArray[np.uint8] = cv2.applyColorMap((255 * near).astype(np.uint8), cv2.COLORMAP_TURBO)
    colors[~np.isfinite(metres) | (metres <= 0.0)] = 0
    return colors


def _labels(numbers: NDArray[np.uint16]) -> NDArray[np.uint8]:
    n = numbers.astype(np.uint32)
    mixed = (n * np.uint32(2654435761)) >> np.uint32(8)  # Knuth's multiplicative hash: neighbours in number differ in colour
    colors = np.stack([mixed & 0xFF, (mixed >> 8) & 0xFF, (mixed >> 16) & 0xFF], axis=2).astype(np.uint8)
    colors[numbers == 0] = 0
    return colors

"""Compresses the images of a recording in the formats of image_transport: JPEG for colours, PNG for labels, compressedDepth for depth.

Estimates their size, as a basis for the choice of recording options.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from gibson_sim.bags.images.decode import COMPRESSED, IMAGE
from gibson_sim.bags.reader import image_to_array
from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import duration_text
from gibson_sim.sensors.image_codecs import COMPRESSED_DEPTH_FORMAT, color_format, encode_color, encode_depth, encode_png

JPEG_QUALITY = 95
"""Quality of recorded JPEG images, that of ``<camera>/image_raw/compressed``."""
DEPTH_MAX_M = 100.0
"""Maximum depth of recorded compressedDepth images; farther pixels have no value, m."""
_PNG_LEVEL = 1
_SUFFIX = {
    "rgb8": "/compressed", "bgr8": "/compressed", "mono8": "/compressed", "16UC1": "/compressed", "mono16": "/compressed",
    "32FC1": "/compressedDepth",
}  # fmt: skip
"""Encoding -> suffix of image_transport's topic of compressed images. Other encodings are not compressed."""
Message = tuple[str, bytes]
"""Topic and CDR bytes."""
ImageForm = Literal["raw", "compressed", "none"]
_PIXEL_BYTES = {
    "rgb": 3, "depth": 4, "semantic": 2, "instance": 2, "normal": 12, "normal_world": 12, "position": 12, "flow": 8,
    "hole": 1,
}  # fmt: skip
"""Output of a camera -> size of a raw pixel, bytes."""
_SMALLER = {"rgb": 14.0, "depth": 30.0, "semantic": 60.0, "instance": 60.0}
"""Output -> approximate compression ratio in furnished rooms; the other outputs are not compressed."""


class ImageCompressor:
    """Compresses images in several threads, in order. Use it as a context manager, or call ``close``."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._topics: set[str] = set()
        self._pool = ThreadPoolExecutor(min(4, os.cpu_count() or 1), thread_name_prefix="compress")

    def add_topic(self, topic: str) -> None:
        """Adds a topic of ``sensor_msgs/Image`` to be compressed."""
        self._topics.add(topic)

    def compress(self, messages: Iterable[Message]) -> Iterator[tuple[str, bytes, str]]:
        """Yields topic, bytes and raw topic of each message, in order; the topic differs from the raw topic for compressed images.

        Images without a compressed format, such as normals, and images that cannot be decoded are not changed.
        """
        waiting: list[tuple[str, bytes | Future[Message]]] = []
        for topic, data in messages:
            waiting.append((topic, self._pool.submit(self._compressed, topic, data) if topic in self._topics else data))
        for topic, item in waiting:
            to, data = item.result() if isinstance(item, Future) else (topic, item)
            yield to, data, topic

    def _compressed(self, topic: str, data: bytes) -> Message:
        try:
            message: Any = self._store.deserialize_cdr(data, IMAGE)
            suffix = _SUFFIX.get(message.encoding, "")
            if not suffix:
                return topic, data
            image_format, pixels = _encoded(message.encoding, image_to_array(message))
        except GibsonSimError:
            return topic, data
        types = self._store.types
        compressed = types[COMPRESSED](header=message.header, format=image_format, data=pixels)
        return topic + suffix, bytes(self._store.serialize_cdr(compressed, COMPRESSED))

    def close(self) -> None:
        """Stops the threads; a second call does nothing."""
        self._pool.shutdown()

    def __enter__(self) -> ImageCompressor:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


def _encoded(encoding: str, pixels: NDArray[Any]) -> tuple[str, NDArray[np.uint8]]:
    """Returns format and data of the compressed image."""
    if encoding == "32FC1":
        data = encode_depth(pixels, depth_max=DEPTH_MAX_M, png_level=_PNG_LEVEL)
        return COMPRESSED_DEPTH_FORMAT, np.frombuffer(data, dtype=np.uint8)
    if pixels.dtype == np.uint16:
        return f"{encoding}; png compressed ", encode_png(pixels, _PNG_LEVEL)
    if encoding == "mono8":
        return "mono8; jpeg compressed ", encode_color(pixels, "jpeg", jpeg_quality=JPEG_QUALITY)
    rgb = pixels if encoding == "rgb8" else cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)
    return color_format("jpeg").replace("rgb8", encoding, 1), encode_color(np.asarray(rgb), "jpeg", jpeg_quality=JPEG_QUALITY)


@dataclass(frozen=True, slots=True)
class ImageStream:
    """The images of one output of a camera."""

    output: str
    width: int
    height: int
    rate_hz: float

    def bytes_per_s(self, form: ImageForm) -> float:
        """Returns the data rate, bytes per second of simulation time; an estimate for compressed images."""
        if form == "none":
            return 0.0
        raw = _PIXEL_BYTES.get(self.output, 4) * self.width * self.height * self.rate_hz
        return raw / _SMALLER.get(self.output, 1.0) if form == "compressed" else raw


def size_line(streams: Iterable[ImageStream], form: ImageForm, free_bytes: int, chunks: str = "none") -> str:
    """Returns a line with the data rate of the images of a recording, the time until the disk is full, and smaller alternatives.

    Args:
        streams: all recorded images, if each is rendered.
        form: form in which they are recorded.
        free_bytes: free space on the disk, bytes.
        chunks: compression of the bag's chunks, or ``none``.
    """
    streams = tuple(streams)
    now, compressed, raw = (sum(s.bytes_per_s(f) for s in streams) for f in (form, "compressed", "raw"))
    about = "up to" if form == "raw" else "about"
    stage = f" before --compression {chunks}" if chunks != "none" and form == "raw" else ""
    room_s = free_bytes / max(now, 1.0)
    room = "the disk has room for " + (duration_text(room_s) if room_s < 36_000.0 else "hours")
    other = (
        f"`--record-images compressed` takes about {_size(60.0 * compressed)}, `none` nothing"
        if form == "raw"
        else f"raw ones would be {_size(60.0 * raw)}"
    )
    return f"images are recorded {form}: {about} {_size(60.0 * now)} per minute{stage} ({room}); {other}"


def _size(count: float) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"

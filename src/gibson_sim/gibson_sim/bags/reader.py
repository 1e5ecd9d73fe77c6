"""Reads bags: topics, messages in the order of their log time, stamps, images as arrays.

A thin layer over `rosbags`, which does not need ROS: message types come from the definitions in the bag. Must not import rclpy.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from gibson_sim.bags.folders import check_bag
from gibson_sim.bags.metadata import TopicQos
from gibson_sim.errors import RecordError
from gibson_sim.quoting import clipped, quoted

_log = logging.getLogger(__name__)
COLOUR_ENCODINGS = ("rgb8", "bgr8", "mono8")
DEPTH_ENCODINGS = ("32FC1", "16UC1")
_LONGEST_REASON = 300
"""Maximum length of a quoted parser error, characters."""
_ENCODINGS: dict[str, tuple[str, int]] = {
    "rgb8": ("u1", 3),
    "bgr8": ("u1", 3),
    "rgba8": ("u1", 4),
    "bgra8": ("u1", 4),
    "mono8": ("u1", 1),
    "8UC1": ("u1", 1),
    "mono16": ("u2", 1),
    "32FC1": ("f4", 1),
    "32FC2": ("f4", 2),
    "32FC3": ("f4", 3),
    "16UC1": ("u2", 1),
}
"""NumPy type and number of channels of each supported encoding."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a bag."""

    name: str
    type_name: str
    """``<package>/msg/<Type>``."""
    count: int
    """Number of messages."""
    latched: bool
    """Whether late joiners receive the last message."""
    stamped: bool
    """Whether messages begin with a stamp, so that ``stamp_ns`` works on their bytes."""


class BagReader:
    """An open bag folder. Use it as a context manager, or call ``close``."""

    def __init__(self, folder: str | Path) -> None:
        """Opens a bag.

        Raises:
            RecordError: the folder is not a bag, or the recording was cut off.
        """
        self.folder = Path(folder)
        check_bag(self.folder)
        self._reader: AnyReader | None = None
        self._warned = False
        try:
            # Bags without definitions (sqlite3 before Jazzy) are read with the types of Jazzy.
            reader = AnyReader([self.folder], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            reader.open()
        # Damaged bytes can cause any exception in parsers, including MemoryError.
        except Exception as error:
            raise RecordError(
                f"bag {self.folder} cannot be read ({_reason(error)}); if its recording was cut off, "
                f"run `gibson-sim bag repair {self.folder}`"
            ) from error
        # rosbags does not check the types of the values in metadata.yaml.
        kinds = ((c.topic, c.msgtype, c.msgcount) for c in reader.connections)
        if not all(isinstance(topic, str) and isinstance(kind, str) and isinstance(count, int) for topic, kind, count in kinds):
            reader.close()
            raise RecordError(
                f"bag {self.folder}: metadata.yaml has topics whose names, types or counts are invalid; "
                f"run `gibson-sim bag repair {self.folder}`"
            )
        self._reader = reader

    def topics(self) -> dict[str, TopicInfo]:
        """Returns all topics by name, sorted."""
        infos: dict[str, TopicInfo] = {}
        for connection in sorted(self._open().connections, key=lambda c: c.topic):
            profiles = getattr(connection.ext, "offered_qos_profiles", [])
            latched = any(profile.durability.name == "TRANSIENT_LOCAL" for profile in profiles)
            count = connection.msgcount + (infos[connection.topic].count if connection.topic in infos else 0)
            infos[connection.topic] = TopicInfo(
                connection.topic, connection.msgtype, count, latched, self._begins_with_stamp(connection.msgtype)
            )
        return infos

    def offered_qos(self) -> dict[str, list[TopicQos]]:
        """Returns the QoS of the recorded publishers of each topic; an empty list if the bag does not have it."""
        profiles: dict[str, list[TopicQos]] = {}
        for connection in self._open().connections:
            recorded = getattr(connection.ext, "offered_qos_profiles", [])
            profiles.setdefault(connection.topic, []).extend(TopicQos.recorded(profile) for profile in recorded)
        return profiles

    def messages(
        self, topics: Collection[str] | None = None, *, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[tuple[str, int, Any]]:
        """Yields (topic, log time in nanoseconds, message) in the order of log time.

        Args:
            topics: topics to read; None = all.
            start_ns: log time to start at, nanoseconds.
            stop_ns: log time to stop before, nanoseconds.

        Raises:
            RecordError: a topic is not in the bag, or a message cannot be decoded.
        """
        types = {name: info.type_name for name, info in self.topics().items()}
        for topic, log_time, data in self.raw_messages(topics, start_ns=start_ns, stop_ns=stop_ns):
            yield topic, log_time, self.decode(types[topic], data)

    def raw_messages(
        self, topics: Collection[str] | None = None, *, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[tuple[str, int, bytes]]:
        """Yields (topic, log time in nanoseconds, CDR bytes), as ``messages`` without decoding."""
        reader = self._open()
        connections = self._connections(topics)
        if not connections:
            return
        counts: Counter[str] = Counter()
        try:
            for connection, log_time, data in reader.messages(connections, start=start_ns, stop=stop_ns):
                counts[connection.topic] += 1
                yield connection.topic, log_time, data
        except Exception as error:
            raise RecordError(
                f"bag {self.folder} is damaged ({_reason(error)}); run `gibson-sim bag repair {self.folder}`, which keeps the damaged file"
            ) from error
        if start_ns is None and stop_ns is None:
            self._warn_of_missing(connections, counts)

    def _warn_of_missing(self, connections: list[Connection], counts: Counter[str]) -> None:
        """Warns once where a bag does not have the messages that it lists: an index that is damaged hides them."""
        listed: Counter[str] = Counter()
        for connection in connections:
            listed[connection.topic] += connection.msgcount
        wrong = [f"{topic}: {counts[topic]} of {count}" for topic, count in sorted(listed.items()) if counts[topic] != count]
        if wrong and not self._warned:
            self._warned = True
            _log.warning(
                "bag %s does not have the messages that it lists (%s); run `gibson-sim bag repair %s`",
                self.folder,
                clipped(", ".join(wrong), _LONGEST_REASON),
                self.folder,
            )

    def first(self, topic: str) -> Any:
        """Returns the first message of a topic.

        Raises:
            RecordError: the topic has no message, even if the index of the bag lists one, or it cannot be decoded.
        """
        for _, _, message in self.messages([topic]):
            return message
        raise RecordError(
            f"bag {self.folder} is damaged (no message of {topic} is there); run `gibson-sim bag repair {self.folder}`, which keeps the damaged file"
        )

    def decode(self, type_name: str, data: bytes) -> Any:
        """Returns the message: an object with the fields of the ROS message, arrays as numpy arrays.

        Raises:
            RecordError: the bytes are not a message of this type.
        """
        try:
            return self._open().deserialize(data, type_name)
        except Exception as error:
            raise RecordError(
                f"bag {self.folder}: a message of type {quoted(type_name)} cannot be decoded: {_reason(error)}"
            ) from error

    def close(self) -> None:
        """Closes the bag; a second call does nothing."""
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    @property
    def connections(self) -> list[Connection]:
        """Connections of `rosbags`, one per topic, with the definition of its type and the offered quality of service."""
        return list(self._open().connections)

    @property
    def span_ns(self) -> tuple[int, int]:
        """Log times of the first and the last message, nanoseconds; (0, 0) for an empty bag."""
        reader = self._open()
        return (reader.start_time, reader.end_time) if reader.message_count else (0, 0)

    def _open(self) -> AnyReader:
        if self._reader is None:
            raise RecordError(f"bag {self.folder} is closed")
        return self._reader

    def _connections(self, topics: Collection[str] | None) -> list[Connection]:
        connections = self._open().connections
        if topics is None:
            return list(connections)
        known = {c.topic for c in connections}
        unknown = sorted(set(topics) - known)
        if unknown:
            raise RecordError(f"bag {self.folder} has no topic {', '.join(unknown)}; it has {', '.join(sorted(known)) or 'none'}")
        return [c for c in connections if c.topic in set(topics)]

    def _begins_with_stamp(self, type_name: str) -> bool:
        fields = self._open().typestore.fielddefs.get(type_name, ([], []))[1]
        return bool(fields) and fields[0][1][1] in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")


def _reason(error: Exception) -> str:
    """Returns the message of a parser error, which may quote the file, clipped to one line."""
    return clipped(str(error), _LONGEST_REASON) or type(error).__name__


def image_to_array(msg: Any) -> NDArray[Any]:
    """Returns the pixels of a ``sensor_msgs/Image``, row 0 at the top, unconverted.

    Args:
        msg: encoding rgb8, bgr8, rgba8, bgra8, mono8 (uint8), mono16 (uint16), 16UC1 (uint16, millimetres or labels), 32FC1 (float32,
            metres), 32FC2 or 32FC3 (float32).

    Returns:
        (height, width, channels), channels in the order of the encoding; (height, width) for one channel. A view if possible.

    Raises:
        RecordError: another encoding, too few bytes, or no pixels.
    """
    if msg.encoding not in _ENCODINGS:
        raise RecordError(f"image encoding {quoted(msg.encoding)} cannot be read, must be one of {', '.join(_ENCODINGS)}")
    code, channels = _ENCODINGS[msg.encoding]
    dtype = np.dtype((">" if msg.is_bigendian else "<") + code)
    data = np.frombuffer(msg.data, dtype=np.uint8)
    row = msg.width * channels * dtype.itemsize
    if not (msg.width and msg.height):
        raise RecordError(f"image {msg.width}x{msg.height} {msg.encoding} has no pixels")
    if msg.step < row or len(data) < msg.step * msg.height:
        raise RecordError(
            f"image {msg.width}x{msg.height} {msg.encoding} has step {msg.step} and {len(data)} bytes, "
            f"must have at least {row} and {msg.step * msg.height}"
        )
    pixels = data[: msg.step * msg.height].reshape(msg.height, msg.step)[:, :row]
    pixels = np.ascontiguousarray(pixels).view(dtype)
    if dtype.byteorder == ">":
        pixels = pixels.astype(dtype.newbyteorder("="))
    return pixels.reshape((msg.height, msg.width, channels) if channels > 1 else (msg.height, msg.width))

"""Finds the camera_info of an image, so that a node that republishes images can publish both with one stamp."""

from __future__ import annotations

import copy
from typing import Any

from gibson_path_following.nodes.conversions import stamp_ns


class CameraInfos:
    """The newest ``sensor_msgs/CameraInfo`` messages of a camera.

    Args:
        kept: number of messages that are kept.
    """

    def __init__(self, kept: int) -> None:
        self._kept = kept
        self._by_stamp: dict[int, Any] = {}
        """Stamp, ns -> message, in the order of arrival."""

    @property
    def newest(self) -> Any | None:
        """The message that came last; None = none has come."""
        return next(reversed(self._by_stamp.values()), None)

    def add(self, msg: Any) -> None:
        """Adds a message."""
        ns = stamp_ns(msg.header.stamp)
        self._by_stamp.pop(ns, None)
        self._by_stamp[ns] = msg
        if len(self._by_stamp) > self._kept:
            del self._by_stamp[next(iter(self._by_stamp))]

    def of_image(self, header: Any, width: int, height: int) -> Any | None:
        """Returns the camera_info of an image, with its stamp.

        It is the message with that stamp or, if that has not come, the newest one of the image's size, with the image's header.

        Args:
            header: header of the image.
            width: its width, pixels.
            height: its height, pixels.

        Returns:
            A ``sensor_msgs/CameraInfo``; None = none of the kept ones fits.
        """
        if (same := self._by_stamp.get(stamp_ns(header.stamp))) is not None:
            return same
        fitting = (msg for msg in reversed(self._by_stamp.values()) if (msg.width, msg.height) == (width, height))
        if (newest := next(fitting, None)) is None:
            return None
        info = copy.copy(newest)
        info.header = header
        return info
